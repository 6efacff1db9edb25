"""Decide from the data themselves whether a robot may move."""

import math

import numpy as np

from jaxplore.onboard.odometry import PoseHistory
from jaxplore.onboard.options import PilotOptions

JUMP_SECONDS = 1.0
"""Time of poses that fit each other after which a robot goes on after a jump [s]."""
RETRY_SECONDS = 2.0
"""Time after which a robot whose pose did not change tries to move again [s]."""
_FROZEN = {
    "pose": "the pose does not change although the robot was told to move",
    "scan": "the scan does not change although the robot moves",
}


class DataCheck:
    """Says why a robot must not move: data that are missing, old, frozen or impossible.

    Args:
        options: limits.
        history: recent poses of the robot.
    """

    def __init__(self, options: PilotOptions, history: PoseHistory) -> None:
        self._options, self._history = options, history
        self._scan_time: float | None = None
        self._scan_changed_at = self._still_at = -math.inf
        self._jump: tuple[float, str] | None = None
        self._frozen: tuple[float, str] | None = None

    def add_scan(self, time: float, *, is_changed: bool) -> None:
        """Note a scan.

        Args:
            time: time of the scan [s].
            is_changed: whether it differs from the one before it.
        """
        self._scan_time = time
        if is_changed:
            self._scan_changed_at = time

    def add_jump(self, time: float, problem: str) -> None:
        """Note a pose that is impossible, and why."""
        self._jump = (time, problem)

    def problem(self, now: float, twist: np.ndarray) -> str | None:
        """Return why the robot must not move; None if it may.

        Args:
            now: present time [s].
            twist: (3,) last command.
        """
        last, options = self._history.last, self._options
        if last is None:
            return "no odometry yet"
        if self._scan_time is None:
            return "no scan yet"
        for name, time in (("odometry", last.time), ("scan", self._scan_time)):
            if now - time > options.max_age:
                return f"the {name} is {now - time:.2f} s old"
        if self._jump is not None:
            since, problem = self._jump
            if now - since < JUMP_SECONDS:
                return problem
            self._jump = None
        return self._frozen_problem(now, twist) if options.is_obeyed else None

    def _frozen_problem(self, now: float, twist: np.ndarray) -> str | None:
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
        if not (abs(twist[2]) > 0.2 or math.hypot(*twist[:2]) > 0.1):
            self._still_at = now
        # A command has no effect before the latency.
        moving_since = self._still_at + self._options.latency
        is_moving = abs(last.twist[2]) > 0.1 or math.hypot(*last.twist[:2]) > 0.05
        for name, is_suspect in (("pose", True), ("scan", is_moving)):
            if is_suspect and now - max(changed[name], moving_since) > limit:
                self._frozen = (now, name)
                return _FROZEN[name]
        return None
