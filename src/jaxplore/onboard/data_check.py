"""Decide from the data themselves whether a robot may move."""

import math

import numpy as np

from jaxplore.control.guard import FROZEN, REASONS
from jaxplore.control.plausibility import JUMP_SECONDS, RETRY_SECONDS, is_moving
from jaxplore.onboard.odometry import PoseHistory
from jaxplore.onboard.options import PilotOptions

_FROZEN = {
    "pose": REASONS[FROZEN],
    "scan": "the scan does not change although the robot moves",
}


class DataCheck:
    """Says why a robot must not move: data that are missing, old, frozen or impossible."""

    def __init__(self, options: PilotOptions, history: PoseHistory) -> None:
        self._options, self._history = options, history
        self._jump: tuple[float, str] | None = None
        self.forget()

    def forget(self) -> None:
        """Forget the scans, as the poses are forgotten: the clock has jumped."""
        self._scan_time: float | None = None
        self._scan_changed_at = self._still_at = -math.inf
        self._frozen: tuple[float, str] | None = None

    def add_scan(self, time: float, *, is_changed: bool) -> None:
        """Note the time of a scan [s], and whether it differs from the one before it."""
        self._scan_time = time
        if is_changed:
            self._scan_changed_at = time

    def add_jump(self, time: float, problem: str) -> None:
        """Note a pose that is impossible, or a clock that jumped, and why."""
        self._jump = (time, problem)

    def problem(self, now: float, twist: np.ndarray) -> str | None:
        """Return why the robot must not move; None if it may. `twist` (3,) is the last command."""
        last, options = self._history.last, self._options
        if self._jump is not None and now - self._jump[0] >= JUMP_SECONDS:
            self._jump = None
        jump = None if self._jump is None else self._jump[1]
        if last is None:
            return jump or "no odometry yet"
        if self._scan_time is None:
            return jump or "no scan yet"
        for name, time in (("odometry", last.time), ("scan", self._scan_time)):
            if now - time > options.max_age:
                return f"the {name} is {now - time:.2f} s old"
        if jump is not None:
            return jump
        return self._find_frozen(now, twist) if options.is_obeyed else None

    def _find_frozen(self, now: float, twist: np.ndarray) -> str | None:
        """Return which measurement repeats itself although the robot should move; None if none."""
        last, limit = self._history.last, self._options.max_frozen
        assert last is not None
        changed = {"pose": self._history.changed_at, "scan": self._scan_changed_at}
        if self._frozen is not None:
            since, name = self._frozen
            # A robot that stands may have the same pose for ever, so it tries again.
            is_retried = name == "pose" and now - since > RETRY_SECONDS
            if changed[name] <= since and not is_retried:
                return _FROZEN[name]
            self._frozen, self._still_at = None, now
        # A robot that stands may measure the same again and again.
        if not is_moving(twist):
            self._still_at = now
        # A command has no effect before the latency.
        moving_since = self._still_at + self._options.latency
        has_moved = bool(is_moving(last.twist, 0.5))
        for name, is_suspect in (("pose", True), ("scan", has_moved)):
            if is_suspect and now - max(changed[name], moving_since) > limit:
                self._frozen = (now, name)
                return _FROZEN[name]
        return None
