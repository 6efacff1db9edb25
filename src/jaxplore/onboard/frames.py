"""Frames of a drive, and at which times they are kept."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxplore._types import Key, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.control.base import Controller
from jaxplore.onboard import steps
from jaxplore.report.exploration.data import ExplorationFrame
from jaxplore.sensing.beams import Scan
from jaxplore.simulation.chunks import are_too_many
from jaxplore.simulation.exploration.scenario import ExplorationScenario

NUM_TRAJECTORIES = 30
"""Number of rollouts in a frame."""

FRAME_SECONDS = 0.5
"""Time between two frames at the start [s]."""


class EvenFrames:
    """Frames for an animation of a drive whose length nobody knows.

    The time between them doubles with the frames that are dropped, so they stay evenly spaced.
    """

    def __init__(self) -> None:
        self._frames: list[Any] = []
        self._last: Any = None
        self._period, self._next = FRAME_SECONDS, 0.0

    @property
    def all(self) -> tuple[Any, ...]:
        """All frames, the last one at the end."""
        return (*self._frames, *(() if self._last is None else (self._last,)))

    def add_when_due(self, time: float, make: Callable[[], Any]) -> None:
        """Make a frame if one is due at a time since the start [s]."""
        if time < self._next:
            return
        self._frames.append(make())
        if are_too_many(self._frames):
            self._frames, self._period = self._frames[::2], 2.0 * self._period
        self._next = time + self._period

    def add_last(self, frame: Any) -> None:
        """Add the frame of the end."""
        self._last = frame


def drive_frame(
    scenario: ExplorationScenario,
    controller: Controller,
    memory: Any,
    state: StateVector,
    belief: Belief,
    scan: Scan | None,
    key: Key,
    *,
    number: int,
    reference: np.ndarray,
) -> ExplorationFrame:
    """Make a frame of a drive with its plan, as in the animation.

    The scan is None before the first one. `number` is how many control periods came before.
    `reference` has points (N, 2) that are shown as the reference [m]; without any, those of the
    scenario are.
    """
    if scan is None:
        beams = scenario.sensors[0].num_beams
        scan = Scan(jnp.zeros(beams), jnp.zeros(beams, bool))
    arrays = steps.frame(scenario, controller, memory, state, belief, scan, key, NUM_TRAJECTORIES)
    made = scenario.make_frame(number, arrays)
    assert isinstance(made, ExplorationFrame)
    return dataclasses.replace(made, reference=reference) if reference.size else made
