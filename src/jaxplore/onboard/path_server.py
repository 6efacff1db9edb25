"""The rules of a server of paths: when a goal is taken, replaced, reached and given up.

They are those of nav2's controller server, whose action `FollowPath` they serve: its error codes,
its `SimpleProgressChecker`, and the tolerances of its `SimpleGoalChecker`. Source: nav2_controller
and nav2_msgs of ros-navigation/navigation2, Jazzy and Kilted. One thing differs: a goal ends when
the robot stands, so that nothing else drives it before.
"""

import dataclasses
import enum
import math
from typing import Any, NamedTuple

import numpy as np

from jaxplore import _checks
from jaxplore._text import short_repr
from jaxplore.control.stops import BLIND, LOST
from jaxplore.dynamics.goal import GOAL_SPEED, Motion
from jaxplore.onboard.following import LEAST_LENGTH, Following
from jaxplore.onboard.options import Command, Mode

MOST_BRAKING = 5.0
"""Longest time between the decision that a goal ends and the message that it did [s]; without
odometry nobody sees that the robot stands."""


class ErrorCode(enum.IntEnum):
    """Error codes of the result of `nav2_msgs/action/FollowPath`."""

    NONE = 0
    UNKNOWN = 100
    INVALID_CONTROLLER = 101
    TF_ERROR = 102
    INVALID_PATH = 103
    PATIENCE_EXCEEDED = 104
    FAILED_TO_MAKE_PROGRESS = 105
    NO_VALID_CONTROL = 106
    CONTROLLER_TIMED_OUT = 107


class Status(enum.StrEnum):
    """How a goal ends."""

    SUCCEEDED = "succeeded"
    ABORTED = "aborted"
    CANCELED = "canceled"


class Ending(NamedTuple):
    """The end of a goal: its status, the error code and a message for people."""

    status: Status
    code: ErrorCode
    message: str


class PathRequest(NamedTuple):
    """A goal: the poses (N, 3) of a path in a frame [m, m, rad], and who shall drive and check.

    `problem` is why it has no poses; empty if they were read.
    """

    frame: str
    poses: np.ndarray
    controller: str = ""
    goal_checker: str = ""
    progress_checker: str = ""
    problem: str = ""


@dataclasses.dataclass(frozen=True)
class ServerOptions:
    """Numbers and names of a server of paths.

    Args:
        controller_id: name of the controller that goals may ask for; an empty one means it too.
        goal_checker_id: name of the goal checker, likewise.
        progress_checker_id: name of the progress checker, likewise.
        xy_goal_tolerance: distance from the end of a path within which it is reached, by a robot
            at rest [m].
        yaw_goal_tolerance: greatest error of the heading there [rad].
        required_movement_radius: distance that the robot must have moved [m] in each
            `movement_time_allowance`.
        movement_time_allowance: time in which it must have moved that far [s].
        failure_tolerance: time without a valid command after which a goal is given up [s]; at 0 at
            the first one, and at -1 never.

    Raises:
        ValueError: a number that is not positive, a `failure_tolerance` that is negative and not
            -1, a name that is too long.
    """

    controller_id: str = "FollowPath"
    goal_checker_id: str = "general_goal_checker"
    progress_checker_id: str = "progress_checker"
    xy_goal_tolerance: float = 0.25
    yaw_goal_tolerance: float = 0.25
    required_movement_radius: float = 0.5
    movement_time_allowance: float = 10.0
    failure_tolerance: float = 1.0

    def __post_init__(self) -> None:
        for name in CHANGEABLE:
            check_option(name, getattr(self, name))


CHANGEABLE = {
    "xy_goal_tolerance": "goal_checker_id",
    "yaw_goal_tolerance": "goal_checker_id",
    "required_movement_radius": "progress_checker_id",
    "movement_time_allowance": "progress_checker_id",
    "failure_tolerance": "",
}
"""Numbers that may change while the robot drives, and whose name comes before theirs in nav2."""


def check_option(name: str, value: object) -> float:
    """Return a number of `ServerOptions`, checked."""
    if name == "failure_tolerance":
        given = _checks.number(name, value)
        if given < 0.0 and given != -1.0:
            raise ValueError(f"{name} is {given:g}; accepted: a number >= 0, or -1 for no end")
        return given
    return _checks.number(name, value, above=0.0)


class PathServer:
    """Follows one path at a time for whoever asks, and says how each request ends.

    A newer goal replaces an older one without a stop; the older one is aborted with the code
    `NONE`, as in nav2. A goal whose path is none ends with its error code. Goals are whatever the
    caller tells them by. Times do not go back (`DriveClock`). Methods are called from one thread.

    Args:
        task: task of the pilot that drives.
        options: numbers and names.
        deceleration: with which a new limit of the speed comes into force [m/s^2].
    """

    def __init__(self, task: Following, options: ServerOptions, deceleration: float) -> None:
        self.task, self.options = task, options
        self._deceleration = deceleration
        self._goal: Any = None
        self._ending: Ending | None = None
        self._decided = self._valid_at = -math.inf
        self._base: tuple[float, np.ndarray] | None = None
        self._points = np.zeros((0, 2))
        self._limit = math.inf
        self._judged = -math.inf
        self.set_options()

    def set_options(self, **changed: float) -> None:
        """Change numbers of the options; what is wrong is a `ValueError`, and nothing changes."""
        self.options = dataclasses.replace(self.options, **changed)  # type: ignore[arg-type]
        self.task.radius = self.options.xy_goal_tolerance
        self.task.tolerance = min(self.options.yaw_goal_tolerance, math.pi)

    @property
    def goal(self) -> Any:
        """The present goal; None without one."""
        return self._goal

    @property
    def is_commanding(self) -> bool:
        """Whether the robot is driven by this server, or is being brought to rest by it."""
        return self._goal is not None

    def begin(
        self, now: float, goal: object, request: PathRequest, place: np.ndarray | None
    ) -> list[tuple[object, Ending]]:
        """Take a goal, in place of the present one; return the goals that have ended by that.

        Args:
            now: present time [s].
            goal: what tells it from others.
            request: what it asks for.
            place: (3,) pose of its frame in that of the robot's pose [m, m, rad]; None if unknown.
        """
        ended = []
        is_replacing = self._goal is not None and self._ending is None
        if self._goal is not None:
            replaced = Ending(Status.ABORTED, ErrorCode.NONE, "replaced by a newer goal")
            ended.append((self._goal, self._ending or replaced))
        self._goal, self._ending = goal, None
        refusal = self._refusal(request, place)
        if refusal is None:
            assert place is not None
            refusal = self._follow(request.poses, place)
        if refusal is not None:
            self._end(now, Status.ABORTED, *refusal)
        elif not is_replacing:
            self._base, self._valid_at = None, now
        return ended

    def cancel(self, now: float, goal: object) -> None:
        """Cancel a goal; it ends when the robot stands."""
        if goal is self._goal:
            self._end(now, Status.CANCELED, ErrorCode.NONE, "cancelled")

    def stop(self, now: float, why: str) -> None:
        """Abort the present goal, if there is one, because the server stops."""
        if self._goal is not None:
            self._end(now, Status.ABORTED, ErrorCode.NONE, why)

    def limit_speed(self, limit: float, max_speed: float, *, is_percentage: bool) -> None:
        """Limit the speed: 0 is no limit, as in `nav2_msgs/msg/SpeedLimit`.

        Args:
            limit: greatest speed [m/s], or a percentage of `max_speed`.
            max_speed: greatest speed of the robot [m/s].
            is_percentage: whether it is one.

        Raises:
            ValueError: a negative limit, one that is not finite, a percentage above 100.
        """
        most = 100.0 if is_percentage else None
        given = _checks.number("speed_limit", limit, at_least=0.0, at_most=most)
        value = 0.01 * given * max_speed if is_percentage else given
        self._limit = value if value > 0.0 else math.inf

    def update(
        self,
        now: float,
        pose: np.ndarray | None,
        motion: Motion,
        command: Command,
        stop_code: int = 0,
        problem: str = "",
    ) -> list[tuple[object, Ending]]:
        """Judge the present goal after a command; return it with its end if it has ended.

        Args:
            now: present time [s].
            pose: (3,) pose of the robot [m, m, rad]; None without one.
            motion: how fast it moves.
            command: newest command of the pilot.
            stop_code: why the data let the robot stand, an index into `control.stops.REASONS`.
            problem: why other data do, such as a costmap that is old; empty if they do not.
        """
        self._slow_down(now, command)
        if self._goal is None:
            return []
        if self._ending is None:
            self._judge(now, pose, command, stop_code, problem)
        ending = self._ending
        if ending is None:
            return []
        is_standing = not command.twist.any() and motion.is_within(GOAL_SPEED)
        if not is_standing and now - self._decided < MOST_BRAKING:
            return []
        return self.end_now()

    def end_now(self) -> list[tuple[object, Ending]]:
        """End what shall end, whether the robot stands or not; return it with its end."""
        goal, ending, self._goal, self._ending = self._goal, self._ending, None, None
        self.task.leave()
        return [] if ending is None else [(goal, ending)]

    def distance_to_goal(self, pose: np.ndarray) -> float:
        """Return the length of the path from its pose nearest to the robot on [m]."""
        if not len(self._points):
            return 0.0
        near = int(np.hypot(*(self._points - pose[:2]).T).argmin())
        return float(np.hypot(*np.diff(self._points[near:], axis=0).T).sum())

    def _refusal(
        self, request: PathRequest, place: np.ndarray | None
    ) -> tuple[ErrorCode, str] | None:
        """Return why a goal is not taken, or None."""
        options = self.options
        codes = ErrorCode.INVALID_CONTROLLER, ErrorCode.UNKNOWN, ErrorCode.UNKNOWN
        names = ("controller", "goal_checker", "progress_checker")
        for name, code in zip(names, codes, strict=True):
            given, known = getattr(request, name), getattr(options, f"{name}_id")
            if given not in ("", known):
                return code, f"{name}_id is {short_repr(given)}; accepted: {known!r}, or none"
        if request.problem:
            return ErrorCode.INVALID_PATH, request.problem
        if not len(request.poses):
            return ErrorCode.INVALID_PATH, "path has no poses; accepted: at least one"
        if place is None:
            frame = short_repr(request.frame)
            return ErrorCode.TF_ERROR, f"no transform from the frame {frame} of the path is known"
        return None

    def _follow(self, poses: np.ndarray, place: np.ndarray) -> tuple[ErrorCode, str] | None:
        """Let the task follow the path; return why it cannot, or None."""
        cos, sin = math.cos(place[2]), math.sin(place[2])
        points = poses[:, :2] @ np.array([[cos, sin], [-sin, cos]]) + place[:2]
        heading = float(poses[-1, 2] + place[2])
        length = np.hypot(*np.diff(points, axis=0).T).sum()
        if np.isfinite(poses).all() and length < LEAST_LENGTH:
            # The end alone is a place to be, with a heading.
            back = 2.0 * LEAST_LENGTH * np.array([math.cos(heading), math.sin(heading)])
            points = np.stack([points[-1] - back, points[-1]])
        try:
            self.task.take(points, heading)
        except ValueError as error:
            return ErrorCode.INVALID_PATH, str(error)
        self._points = points
        return None

    def _judge(
        self,
        now: float,
        pose: np.ndarray | None,
        command: Command,
        stop_code: int,
        problem: str,
    ) -> None:
        if command.mode is Mode.PAUSED:
            # Who pauses the robot does not want its goal to fail.
            self._base, self._valid_at = None, now
            return
        if self.task.is_done:
            self._end(now, Status.SUCCEEDED, ErrorCode.NONE, "")
            return
        is_valid = command.mode is Mode.DRIVING and not command.reason and not problem
        if is_valid:
            self._valid_at = now
        tolerance = self.options.failure_tolerance
        waited = now - self._valid_at
        if not is_valid and tolerance >= 0.0 and (waited > tolerance or tolerance == 0.0):
            reason = problem or command.reason
            self._end(now, Status.ABORTED, self._code_of(stop_code, problem), reason)
        elif pose is not None and not self._makes_progress(now, pose):
            radius = self.options.required_movement_radius
            allowed = self.options.movement_time_allowance
            said = f"the robot moved less than {radius:g} m in {allowed:g} s"
            self._end(now, Status.ABORTED, ErrorCode.FAILED_TO_MAKE_PROGRESS, said)

    def _code_of(self, stop_code: int, problem: str) -> ErrorCode:
        if problem or stop_code == BLIND:
            return ErrorCode.CONTROLLER_TIMED_OUT
        if stop_code == LOST:
            return ErrorCode.TF_ERROR
        if self.options.failure_tolerance == 0.0:
            return ErrorCode.NO_VALID_CONTROL
        return ErrorCode.PATIENCE_EXCEEDED

    def _makes_progress(self, now: float, pose: np.ndarray) -> bool:
        base = self._base
        if base is None or math.dist(pose[:2], base[1]) > self.options.required_movement_radius:
            self._base = now, pose[:2].copy()
            return True
        return now - base[0] <= self.options.movement_time_allowance

    def _end(self, now: float, status: Status, code: ErrorCode, message: str) -> None:
        # What was decided first stays, but for the wish of the client.
        if self._ending is None or status is Status.CANCELED:
            self._ending, self._decided = Ending(status, code, message), now
            if status is not Status.SUCCEEDED:
                self.task.leave()

    def _slow_down(self, now: float, command: Command) -> None:
        """Let a limit of the speed come into force as fast as the robot brakes."""
        elapsed = now - self._judged if math.isfinite(self._judged) else 0.0
        self._judged = now
        fastest = min(self.task.max_speed, math.hypot(*command.twist[:2]))
        slower = fastest - self._deceleration * max(0.0, elapsed)
        # Of a higher limit a robot needs no ramp: it accelerates as fast as it can.
        self.task.max_speed = max(self._limit, slower)
