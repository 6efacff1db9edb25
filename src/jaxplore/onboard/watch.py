"""Show a drive to monitors, and do what they ask for."""

import dataclasses
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxplore.onboard import steps
from jaxplore.onboard.options import Command
from jaxplore.onboard.pilot import Pilot
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.report.recording import Recording
from jaxplore.simulation.monitor import (
    Monitor,
    ParameterRequests,
    Requests,
    Update,
    begin_all,
)
from jaxplore.simulation.scenario import LoopState, blank_recording


class DriveWatch:
    """Shows a drive to live views and recorders.

    They may change parameters of the controller; a pause lets the robot stand, and a stop ends the
    drive. Speed and single steps have no meaning on a robot.

    Args:
        pilot: the pilot.
        monitors: the monitors.
    """

    def __init__(self, pilot: Pilot, monitors: Sequence[Monitor]) -> None:
        self._pilot = pilot
        # Number of commands that each was shown, and when.
        self._shown: dict[Monitor, tuple[int, float, float]] = dict.fromkeys(
            monitors, (0, 0.0, -math.inf)
        )
        self._requested = ParameterRequests()
        self._is_paused = self._has_begun = False

    def begin(self) -> None:
        """Tell the monitors that the drive begins, see `begin_all`."""
        if not self._shown:
            return
        pilot = self._pilot
        scenario = pilot.scenario
        state: Any = LoopState(
            steps.initial(scenario),
            (),
            jnp.zeros((), jnp.int32),
            scenario.start,
            jnp.zeros((0, pilot.robot.control_size)),
        )
        recording = blank_recording(scenario, pilot.controller, state, pilot.make_frame())
        assert isinstance(recording, ExplorationRecording)
        # The scenario's world is free, for its checks; nobody knows the true one.
        unknown = np.full_like(recording.world, 0.5)
        recording = dataclasses.replace(recording, world=unknown)
        begin_all(self._shown, recording, pilot.controller)
        self._has_begun = True

    def after(self, command: Command) -> None:
        """Show a command to the monitors that are due, and take their requests.

        Args:
            command: the newest command.
        """
        log, now, frame = self._pilot.log, time.monotonic(), None
        for each, (number, last, shown_at) in self._shown.items():
            simulated = log.num_steps * self._pilot.period
            if log.num_commands > number and each.is_due(simulated - last, now - shown_at):
                # One frame serves all monitors that are due.
                frame = self._pilot.make_frame() if frame is None else frame
                records, times = log.newest(number)
                why = f", {command.reason}" if command.reason else ""
                area = log.num_known * self._pilot.scenario.cell_size**2
                text = f"{command.mode}{why}, explored {area:.1f} m\u00b2"
                each.show(Update(frame, records, times, text))
                self._shown[each] = (log.num_commands, simulated, now)
        self._take({each: each.requests() for each in self._shown})

    def end(self, recording: Recording | None) -> None:
        """Tell the monitors that the drive has ended.

        Args:
            recording: the whole drive; None if it failed.
        """
        for each in self._shown if self._has_begun else ():
            each.end(recording)

    def _take(self, requests: Mapping[Monitor, Requests]) -> None:
        pilot = self._pilot
        for monitor, asked in requests.items():
            pilot.controller, _ = self._requested.take(pilot.controller, monitor, asked.parameters)
            if asked.is_stopped:
                pilot.finish("stopped in the view")
        # One that asks for nothing must not end the pause of another.
        is_paused = any(asked.is_paused for asked in requests.values())
        if is_paused != self._is_paused:
            self._is_paused = is_paused
            pilot.is_started = not is_paused
