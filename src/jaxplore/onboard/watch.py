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
from jaxplore.report.exploration.data import ExplorationFrame
from jaxplore.report.exploration.recording import ExplorationRecording
from jaxplore.report.recording import Recording, move_records
from jaxplore.simulation.monitor import (
    Monitor,
    ParameterRequests,
    Requests,
    Update,
    begin_all,
)
from jaxplore.simulation.scenario import blank_recording
from jaxplore.simulation.state import LoopState


class DriveWatch:
    """Shows a drive to live views and recorders.

    They may change parameters of the controller; a pause lets the robot stand, and a stop ends the
    drive. Speed and single steps have no meaning on a robot.
    """

    def __init__(self, pilot: Pilot, monitors: Sequence[Monitor]) -> None:
        self._pilot = pilot
        # Number of commands that each was shown, and when.
        self._shown: dict[Monitor, tuple[int, float, float]] = dict.fromkeys(
            monitors, (0, 0.0, -math.inf)
        )
        self._requested = ParameterRequests()
        self._is_paused = self._has_begun = False
        self._blank: ExplorationRecording | None = None
        self._offset = np.zeros(2)

    def prepare(self) -> None:
        """Make what `begin` shows, so that nothing is compiled when `show` calls it."""
        pilot = self._pilot
        if not self._shown or self._blank is not None:
            return
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
        self._blank = dataclasses.replace(recording, world=unknown)

    def begin(self) -> None:
        """Tell the monitors that the drive begins, see `begin_all`.

        Positions are in the frame of the odometry, as far as it is known: before the first pose
        they are relative to that. `show` begins with the first pose, unless this was called.
        """
        self.prepare()
        if self._blank is None:
            return
        self._offset = self._pilot.offset.copy()
        recording = self._blank.move(self._offset)
        recording = dataclasses.replace(recording, frames=(self._make_frame(),))
        begin_all(self._shown, recording, self._pilot.controller)
        self._has_begun = True

    def show(self, command: Command) -> None:
        """Show the newest command to the monitors that are due, and take their requests."""
        if not self._has_begun and self._pilot.pose is not None:
            self.begin()
        if not self._has_begun:
            return
        log, now, frame = self._pilot.log, time.monotonic(), None
        for each, (number, last, shown_at) in self._shown.items():
            simulated = log.num_steps * self._pilot.period
            if log.num_commands > number and each.is_due(simulated - last, now - shown_at):
                # One frame serves all monitors that are due.
                frame = self._make_frame() if frame is None else frame
                records, times = log.newest(number)
                names = self._pilot.robot.state_names
                records = move_records(records, self._offset, names)
                why = f", {command.reason}" if command.reason else ""
                area = log.num_known * self._pilot.scenario.cell_size**2
                text = f"{command.mode}{why}, explored {area:.1f} m\u00b2"
                each.show(Update(frame, records, times, text))
                self._shown[each] = (log.num_commands, simulated, now)
        self._take({each: each.requests() for each in self._shown})

    def end(self, recording: Recording | None) -> None:
        """Tell the monitors that the drive has ended; without a recording it failed."""
        for each in self._shown if self._has_begun else ():
            each.end(recording)

    def _make_frame(self) -> ExplorationFrame:
        """Make a frame of the present moment, as `begin` says."""
        pilot = self._pilot
        return pilot.make_frame().move(self._offset, pilot.robot.state_names)

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
