"""Watch a run while it goes on, and change it: live views and recorders are monitors."""

import abc
import math
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxplore._types import ArrayLike
from jaxplore.control.base import Controller
from jaxplore.parameters import find_parameter, get_parameters, set_parameters
from jaxplore.report.recording import Frame, Recording
from jaxplore.simulation.chunks import Chunk

WATCHED_SECONDS = 0.1
"""Longest simulated time of a chunk of a run with monitors, unless they accept longer ones [s]."""
PAUSE_SECONDS = 0.02
"""Time between two looks at the requests of a run that waits [s]."""


class Update(NamedTuple):
    """What a monitor is shown of a run.

    Args:
        frame: belief, scan, plan and rollouts at this moment, as in the animation.
        records: records of the steps since the last update, in NumPy; a row for each step.
        time: time of each of these steps [s].
        text: progress of the task in words.
    """

    frame: Frame
    records: Any
    time: np.ndarray
    text: str


class Requests(NamedTuple):
    """What a monitor asks of a run.

    Args:
        parameters: new values of parameters of the controller, see `set_parameters`; those that
            were asked for before keep their values.
        is_paused: whether the run waits.
        single_steps: number of single steps that a paused run shall have done, since it began.
        speed: greatest number of simulated seconds per second.
        is_stopped: whether the run ends.
    """

    parameters: Mapping[str, ArrayLike] = {}
    is_paused: bool = False
    single_steps: int = 0
    speed: float = math.inf
    is_stopped: bool = False


class Monitor(abc.ABC):
    """Watches a run; abstract.

    `simulate` and a robot's pilot call the methods from their own thread, so each must return
    quickly: a slow consumer takes the newest update and skips others.
    """

    @abc.abstractmethod
    def begin(self, recording: Recording, controller: Controller) -> None:
        """Take note of a run that begins.

        `recording` has no step yet and one frame: the world, the robot, the goal.
        """

    @abc.abstractmethod
    def is_due(self, simulated: float, elapsed: float) -> bool:
        """Check whether the next update is due.

        Both times are since the last update [s]: simulated, and by the wall clock.
        """

    def longest_chunk(self, pace: float) -> float:
        """Return the longest simulated time for which the run may go on by itself [s].

        Longer chunks cost less. Parameters act, and updates come, between chunks. `pace` is in
        simulated seconds per second at present; infinite if nobody knows.
        """
        return WATCHED_SECONDS

    @abc.abstractmethod
    def show(self, update: Update) -> None:
        """Take an update."""

    def requests(self) -> Requests:
        """Return what is asked of the run now; nothing by default."""
        return Requests()

    def refuse(self, message: str) -> None:
        """Take note of a request that was not accepted; by default a warning of one line."""
        warnings.warn(message, stacklevel=2)

    @abc.abstractmethod
    def end(self, recording: Recording | None) -> None:
        """Take note of the end of the run; `recording` is the whole run, None if it failed."""


def begin_all(monitors: Iterable[Monitor], recording: Recording, controller: Controller) -> None:
    """Tell monitors that a run begins, see `Monitor.begin`.

    If one of them fails, those that have begun are told that the run failed.
    """
    with ExitStack() as stack:
        for each in monitors:
            each.begin(recording, controller)
            stack.callback(each.end, None)
        stack.pop_all()


class ParameterRequests:
    """Sets the parameters that monitors ask for, each value once."""

    def __init__(self) -> None:
        self._asked: dict[str, ArrayLike] = {}

    def take(
        self, controller: Controller, monitor: Monitor, requested: Mapping[str, ArrayLike]
    ) -> tuple[Controller, list[str]]:
        """Set the values that are new; return the new controller, and the names of what was set.

        The monitor is told of values that are not accepted.
        """
        changed = []
        for name, value in requested.items():
            # A value that was refused is not tried again. NaN differs from itself.
            if name in self._asked and np.array_equal(
                np.asarray(self._asked[name]), np.asarray(value), equal_nan=True
            ):
                continue
            self._asked[name] = value
            try:
                controller = set_parameters(controller, {name: value})
            except ValueError as error:
                monitor.refuse(str(error))
                continue
            changed.append(name)
        return controller, changed


class _Shown:
    """What a monitor has not been shown yet."""

    def __init__(self, monitor: Monitor, total: int) -> None:
        self.monitor = monitor
        self._rows: list[Any] = []
        self._total, self._at = total, -math.inf

    def add(self, rows: Any) -> None:
        self._rows.append(rows)

    def show_when_due(
        self, make_frame: Callable[[], Frame], total: int, period: float, text: str
    ) -> None:
        now = time.monotonic()
        if not self.monitor.is_due((total - self._total) * period, now - self._at):
            return
        records = jax.tree.map(lambda *parts: np.concatenate(parts), *self._rows)
        times = period * np.arange(self._total + 1, total + 1)
        self.monitor.show(Update(make_frame(), records, times, text))
        self._rows, self._total, self._at = [], total, now


class Watch[S]:
    """Shows a run to monitors, and does what they ask for.

    `adapt` adapts a controller to the control period of the task, `period` [s]. `make_frame` makes
    a frame of a state after a number of steps, with the plan of an adapted controller. `total`
    steps were done before.
    """

    def __init__(
        self,
        monitors: Sequence[Monitor],
        controller: Controller,
        adapt: Callable[[Controller], Controller],
        make_frame: Callable[[Controller, S, int], Frame],
        period: float,
        total: int,
    ) -> None:
        self.controller, self.planner = controller, adapt(controller)
        self.parameters: dict[str, float | list[float]] = {}
        """Parameters that monitors have set, by full path, with their last values."""
        self._adapt, self._make_frame, self._period = adapt, make_frame, period
        # Number of steps that were done, and the time, when the present chunk began.
        self._began = total, math.inf
        self._shown = [_Shown(each, total) for each in monitors]
        self._requested = ParameterRequests()
        self._single_steps = 0
        # Speed, and the step and the time from which it is held.
        self._pace: tuple[float, int, float] | None = None

    def begin(self, recording: Recording) -> None:
        """Tell the monitors that the run begins, see `begin_all`."""
        begin_all([each.monitor for each in self._shown], recording, self.controller)

    def end(self, recording: Recording | None) -> None:
        """Tell the monitors that the run has ended."""
        for each in self._shown:
            each.monitor.end(recording)

    def show_chunk(self, chunk: Chunk[S, Any], text: str) -> int:
        """Show a chunk, wait as the monitors ask for, and return the length of the next one.

        `text` is the progress of the task in words. The length is a greatest number of steps; with
        0 the run shall stop.
        """
        steps, seconds = chunk.total - self._began[0], time.monotonic() - self._began[1]
        pace = steps * self._period / seconds if seconds > 0.0 else math.inf
        frames: list[Frame] = []

        def make_frame() -> Frame:
            # One frame serves all monitors that are due.
            if not frames:
                frames.append(self._make_frame(self.planner, chunk.state, chunk.total))
            return frames[0]

        for each in self._shown:
            each.add(chunk.records)
            each.show_when_due(make_frame, chunk.total, self._period, text)
        length = self._wait(chunk, pace)
        self._began = chunk.total, time.monotonic()
        return length

    def _wait(self, chunk: Chunk[S, Any], pace: float) -> int:
        while not chunk.is_stop_requested():
            requests = [each.monitor.requests() for each in self._shown]
            self._take_parameters(requests)
            if any(each.is_stopped for each in requests):
                break
            if not any(each.is_paused for each in requests):
                speed = min(each.speed for each in requests)
                self._hold_speed(chunk.total, speed)
                pace = min(pace, speed)
                longest = min(each.monitor.longest_chunk(pace) for each in self._shown)
                # Frames of the recording end chunks as well; updates keep their own beat.
                beat = max(1, round(longest / self._period))
                return beat - chunk.total % beat
            # After a pause the speed is held from there on.
            self._pace = None
            if sum(each.single_steps for each in requests) > self._single_steps:
                self._single_steps += 1
                return 1
            time.sleep(PAUSE_SECONDS)
        return 0

    def _hold_speed(self, total: int, speed: float) -> None:
        """Wait until a number of steps is due at a speed [simulated seconds per second]."""
        now = time.monotonic()
        if self._pace is None or self._pace[0] != speed:
            self._pace = (speed, total, now)
        _, first, began = self._pace
        ahead = (total - first) * self._period / speed - (now - began)
        if ahead > 0.0:
            time.sleep(ahead)
        elif ahead < -WATCHED_SECONDS:
            # A run that was too slow does not catch up.
            self._pace = None

    def _take_parameters(self, requests: Sequence[Requests]) -> None:
        """Set the parameters that monitors ask for; those that are not accepted are refused."""
        for shown, each in zip(self._shown, requests, strict=True):
            self.controller, changed = self._requested.take(
                self.controller, shown.monitor, each.parameters
            )
            if not changed:
                continue
            self.planner = self._adapt(self.controller)
            known = get_parameters(self.controller)
            for name in changed:
                path = find_parameter(self.controller, name)
                self.parameters[path] = known[path].tolist()
