"""The recent poses and velocities of a robot, and what is wrong with them."""

import collections
import math

import numpy as np

from jaxplore.control.plausibility import MAX_JUMP, MAX_TURN, is_jump, pose_error
from jaxplore.dynamics.base import Dynamics

KEPT_SECONDS = 2.0
"""Time for which poses are kept [s]."""
DIFFERENCE_SECONDS = 0.1
"""Time over which a velocity is estimated where the odometry has none [s]."""


class Placed:
    """Pose (x, y, yaw) at a time, in double precision [m, m, rad], and velocity.

    The velocity (vx, vy, omega) is in the frame of the robot.
    """

    __slots__ = ("pose", "time", "twist")

    def __init__(self, time: float, pose: np.ndarray, twist: np.ndarray) -> None:
        self.time, self.pose, self.twist = time, pose, twist


class PoseHistory:
    """Recent poses of a robot; poses between them are interpolated.

    A pose jumps that is more than `max_jump` [m] or `max_turn` [rad] away from where the robot's
    velocity leads.
    """

    def __init__(self, max_jump: float = MAX_JUMP, max_turn: float = MAX_TURN) -> None:
        self._max_jump, self._max_turn = max_jump, max_turn
        self._places: collections.deque[Placed] = collections.deque()
        self._moved_at = -math.inf

    @property
    def last(self) -> Placed | None:
        """The newest pose; None before the first."""
        return self._places[-1] if self._places else None

    @property
    def changed_at(self) -> float:
        """Time of the last pose that differed from the one before it [s]."""
        return self._moved_at

    def forget(self, after: float = -math.inf) -> None:
        """Forget the poses after a time [s]; all of them when absent."""
        while self._places and self._places[-1].time > after:
            self._places.pop()

    def add(self, time: float, pose: np.ndarray, twist: np.ndarray | None) -> str | None:
        """Add a pose (3,) at a time [s]; return what is impossible about it, or None.

        After an impossible pose the history begins anew with it. A pose that is not newer than the
        newest one is left out. The velocity (3,) is in the frame of the robot; without one it is
        estimated from the poses.
        """
        last = self.last
        if last is not None and time <= last.time:
            return None
        problem = None
        if last is not None:
            seconds = min(time - last.time, KEPT_SECONDS)
            problem = self.jump(extrapolate_pose(last.pose, last.twist, seconds), pose)
        if problem is not None:
            self._places.clear()
        if last is None or not np.array_equal(last.pose, pose):
            self._moved_at = time
        velocity = (
            self._estimate_velocity(time, pose) if twist is None else np.asarray(twist, np.float64)
        )
        self._places.append(Placed(time, np.asarray(pose, np.float64), velocity))
        while time - self._places[0].time > KEPT_SECONDS:
            self._places.popleft()
        return problem

    def at(self, time: float) -> np.ndarray:
        """Return the pose (3,) at a time [s]; before the first pose it raises an `IndexError`.

        Between two poses it is interpolated, and beyond the ends it moves on at the velocity of the
        nearest one.
        """
        # Another thread may add a pose meanwhile.
        places = tuple(self._places)
        before, after = places[0], places[-1]
        for place in places:
            if place.time <= time:
                before = place
            else:
                after = place
                break
        span = after.time - before.time
        if before is after or time <= before.time or time >= after.time or span <= 0.0:
            nearest = after if time >= after.time else before
            return extrapolate_pose(nearest.pose, nearest.twist, time - nearest.time)
        share = (time - before.time) / span
        turn = wrap_angle(after.pose[2] - before.pose[2])
        position = before.pose[:2] + share * (after.pose[:2] - before.pose[:2])
        return np.append(position, before.pose[2] + share * turn)

    def jump(self, expected: np.ndarray, pose: np.ndarray) -> str | None:
        """Return by how much a pose (3,) jumped from an expected one; None if it did not."""
        if not is_jump(expected, np.asarray(pose), self._max_jump, self._max_turn):
            return None
        away, turn = pose_error(expected, np.asarray(pose))
        return f"the pose jumped by {away:.2f} m and {turn:.2f} rad"

    def _estimate_velocity(self, time: float, pose: np.ndarray) -> np.ndarray:
        """Estimate a velocity from the poses of the last tenth of a second."""
        for place in reversed(self._places):
            if time - place.time >= DIFFERENCE_SECONDS or place is self._places[0]:
                span = max(time - place.time, 1e-3)
                x, y = pose[:2] - place.pose[:2]
                turn = wrap_angle(pose[2] - place.pose[2])
                middle = place.pose[2] + 0.5 * turn
                cos, sin = math.cos(middle), math.sin(middle)
                return np.array([cos * x + sin * y, cos * y - sin * x, turn]) / span
        return np.zeros(3)


def extrapolate_pose(pose: np.ndarray, twist: np.ndarray, seconds: float) -> np.ndarray:
    """Return a pose (3,) after some time at a constant velocity in the frame of the robot.

    The direction of motion is that in the middle of the time, exact to second order.
    """
    vx, vy, omega = twist * seconds
    middle = pose[2] + 0.5 * omega
    cos, sin = math.cos(middle), math.sin(middle)
    return np.asarray(pose + np.array([cos * vx - sin * vy, sin * vx + cos * vy, omega]))


def wrap_angle(angle: float) -> float:
    """Return an angle in [-pi, pi] [rad]."""
    return math.remainder(angle, math.tau)


def robot_state(
    robot: Dynamics, pose: np.ndarray, twist: np.ndarray, expected: np.ndarray
) -> np.ndarray:
    """Return the state (nx,) of a robot from its pose (3,) and its velocity (3,) in its frame.

    Components that neither gives, such as a steering angle, keep the expected value.
    """
    vx, vy, omega = twist
    # A model without a heading has its velocities along the axes of the map.
    if "yaw" not in robot.state_names:
        cos, sin = math.cos(pose[2]), math.sin(pose[2])
        vx, vy = cos * vx - sin * vy, sin * vx + cos * vy
    known = {
        "x": pose[0],
        "y": pose[1],
        "yaw": pose[2],
        "v": vx,
        "vx": vx,
        "vy": vy,
        "omega": omega,
    }
    values = [
        known.get(name, before) for name, before in zip(robot.state_names, expected, strict=True)
    ]
    return np.array(values, np.float32)
