"""The commands of a robot that are on their way."""

from typing import NamedTuple

import numpy as np

from jaxplore.dynamics.base import Dynamics

NUM_SENT = 16
"""Greatest number of commands on their way that a prediction takes into account."""


class _Sent(NamedTuple):
    """A command: the control, and the time from which it has effect [s]."""

    control: np.ndarray
    effect: float


class SentCommands:
    """Commands that were sent, and when each has effect, a latency later [s]."""

    def __init__(self, robot: Dynamics, latency: float) -> None:
        self._idle = np.asarray(robot.default_control, np.float32)
        self._latency = latency
        self._sent: list[_Sent] = []

    def add(self, control: np.ndarray, now: float, measured: float) -> None:
        """Add a control (nu,) sent now; forget those that no longer acted at `measured` [s]."""
        self._sent.append(_Sent(control, now + self._latency))
        # The last one that has effect before the measurement is still in effect.
        while len(self._sent) > NUM_SENT or (
            len(self._sent) > 1 and self._sent[1].effect <= measured
        ):
            self._sent.pop(0)

    def clear(self) -> None:
        """Forget all commands: the robot brakes."""
        self._sent = []

    def find_pending(self, measured: float, now: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the controls (D, nu) on their way, and for how long each of them (D,) acts [s].

        The time runs from `measured`, that of the newest measured state, until a command that is
        sent now has effect.
        """
        controls = np.tile(self._idle, (NUM_SENT, 1))
        durations, end = np.zeros(NUM_SENT, np.float32), now + self._latency
        for index, each in enumerate(self._sent):
            until = self._sent[index + 1].effect if index + 1 < len(self._sent) else end
            controls[index] = each.control
            durations[index] = max(0.0, min(until, end) - max(each.effect, measured))
        return controls, durations
