"""Find in the data themselves whether a robot may move, and say why not."""

import math

import numpy as np

from jaxplore.control.guard import MotionGuard
from jaxplore.control.plausibility import JUMP_SECONDS, is_moving
from jaxplore.control.stops import (
    AGE_ROUNDING,
    BLIND,
    JUMPED,
    LOST,
    REASONS,
    REPEATED,
    Evidence,
    StopState,
)
from jaxplore.onboard import steps
from jaxplore.onboard.odometry import PoseHistory
from jaxplore.onboard.options import PilotOptions

_VANISHED = "the lidar meets nothing, although something must be in its range"
SEEN = 0.9
"""Share of the range of a lidar within which it meets what is there."""


class DataCheck:
    """Gathers what data say, and says why a robot must not move, by the rule of `next_stop`.

    Two empty scans in a row repeat each other, as those of a lidar that has failed, unless the
    robot may be in the open: if the distance of what the lidar met last, plus the way that the
    robot has moved since, is more than its `max_range` [m].
    """

    def __init__(
        self, guard: MotionGuard, options: PilotOptions, history: PoseHistory, max_range: float
    ) -> None:
        self._guard, self._options, self._history = guard, options, history
        self._max_range = max_range
        # The distance of what the lidar met last, and where the robot was then.
        self._met: tuple[float, np.ndarray] | None = None
        self._is_empty = False
        self._state = StopState.initial()
        self._jump = ""
        self._is_jump = False
        self._judged_at: float | None = None
        self._still_at = -math.inf
        self.forget()

    def forget(self) -> None:
        """Forget the scans, as the poses are forgotten: the clock has jumped."""
        self._scan_time: float | None = None
        self._is_scan_same, self._is_repeat, self._pose_changed_at = True, False, -math.inf

    def add_scan(self, time: float, points: np.ndarray, *, is_changed: bool) -> None:
        """Note the time of a scan [s], what it met, and whether it differs from the one before it.

        `points` (N, 2) are relative to the robot [m].
        """
        self._scan_time, self._is_empty = time, not len(points)
        here = None if self._history.last is None else self._history.at(time)[:2]
        if not self._is_empty and here is not None:
            self._met = float(np.hypot(*points.T).min()), here
        is_open = self._is_empty and self._may_be_open(here)
        self._is_repeat = not (is_changed or is_open)
        self._is_scan_same &= self._is_repeat

    def add_jump(self, problem: str) -> None:
        """Note a pose that is impossible, or a clock that jumped, and why."""
        self._jump, self._is_jump = problem, True

    def judge(self, now: float, twist: np.ndarray, *, is_misfit: bool) -> tuple[int, str]:
        """Return why the robot must not move, an index into `REASONS`, and in words.

        `now` is the present time [s] and `twist` (3,) the last command. `is_misfit` is whether the
        newest scan contradicts the map.
        """
        last, options = self._history.last, self._options
        elapsed = 0.0 if self._judged_at is None else max(0.0, now - self._judged_at)
        self._judged_at = now
        # A robot that stands may measure the same again and again, and a command has no effect
        # before the latency.
        if not is_moving(twist):
            self._still_at = now
        pose_age = math.inf if last is None else now - last.time
        scan_age = math.inf if self._scan_time is None else now - self._scan_time
        changed_at, most = self._history.changed_at, options.max_age + AGE_ROUNDING
        self._next(
            elapsed=elapsed,
            is_lost=pose_age > most,
            is_same=changed_at <= self._pose_changed_at,
            is_driven=options.is_obeyed and now - self._still_at > options.latency,
            is_jump=self._is_jump,
            is_blind=scan_age > most,
            is_scan_same=self._is_scan_same,
            is_repeat=self._is_repeat and last is not None and bool(is_moving(last.twist, 0.5)),
            misfit=float(is_misfit),
        )
        self._is_jump, self._is_scan_same, self._pose_changed_at = False, True, changed_at
        code = int(self._state.code)
        return code, self._describe(code, pose_age, scan_age)

    def prepare(self) -> None:
        """Compile the rule."""
        self._next(**dict.fromkeys(Evidence._fields, 0.0))

    def _next(self, **found: float) -> None:
        numbers = np.array([found[name] for name in Evidence._fields], np.float32)
        self._state = steps.judge(self._state, numbers, self._guard.max_frozen)

    def _may_be_open(self, here: np.ndarray | None) -> bool:
        """Check whether there may be nothing within the range of the lidar at a position (2,)."""
        if self._met is None or here is None:
            return False
        distance, there = self._met
        return distance + math.hypot(*(here - there)) > SEEN * self._max_range

    def _describe(self, code: int, pose_age: float, scan_age: float) -> str:
        """Return in words why a robot is stopped."""
        if code == REPEATED and self._is_empty:
            return "the lidar met nothing yet" if self._met is None else _VANISHED
        if code not in (LOST, BLIND):
            return self._jump if code == JUMPED else REASONS[code]
        name, age = ("odometry", pose_age) if code == LOST else ("scan", scan_age)
        if math.isfinite(age):
            return f"the {name} is {age:.2f} s old"
        # After a jump of the clock there are no data either.
        return self._jump if float(self._state.jump) < JUMP_SECONDS else f"no {name} yet"
