"""Where a lidar is on its robot and when its beams are measured, and its scan as one around the
robot's centre at one time."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Pose, Scalar, Twist
from jaxplore.geometry.motion import compose
from jaxplore.sensing.beams import Beams, Scan

MOST_MOUNT = 10.0
"""Greatest distance of a lidar from the centre of its robot, in each direction [m]."""
FLATTEST = math.radians(5.0)
"""Least angle between a beam and the surface from which its neighbour returned as well [rad]."""
MOST_GAP, SLACK = 0.5, 0.06
"""Greatest distance of the ends of neighbouring beams on a surface, and the noise that is added to
what follows from the angle [m]."""
ROUNDING = 1e-4
"""By how much rounding may move an end beside a beam [m]."""


class ScanMotion(NamedTuple):
    """Motion of a robot while a lidar turns: its true velocity (vx, vy, omega) in its frame, the
    same as it knows it (where that is not finite, it takes itself to stand), and the time of a turn
    [s]."""

    true: Twist
    known: Twist
    duration: Scalar


class LidarMount(eqx.Module):
    """Pose of a lidar on its robot, and whether it turns while the robot drives.

    The robot knows the pose exactly. Of B beams of a lidar that turns, beam k is measured
    `(B - 1 - k) / B` of a turn before the time of the scan.

    Args:
        x: position ahead of the robot's centre [m].
        y: position to the left of it [m].
        yaw: heading of the lidar relative to that of the robot [rad].
        is_turning: whether the lidar turns once between two scans; static. Otherwise it measures at
            once.

    Raises:
        ValueError: a position more than 10 m away, a yaw that is not finite.
    """

    x: Scalar
    y: Scalar
    yaw: Scalar
    is_turning: bool = eqx.field(static=True)

    def __init__(
        self,
        x: ArrayLike = 0.0,
        y: ArrayLike = 0.0,
        yaw: ArrayLike = 0.0,
        *,
        is_turning: bool = False,
    ) -> None:
        near: dict[str, Any] = {"at_least": -MOST_MOUNT, "at_most": MOST_MOUNT}
        self.x = _checks.scalar("x", x, **near)
        self.y = _checks.scalar("y", y, **near)
        self.yaw = _checks.scalar("yaw", yaw)
        self.is_turning = _kinds.flag("is_turning", is_turning)

    def times(self, num_beams: int, duration: Scalar) -> Float[Array, " B"]:
        """Return the time (B,) of each beam relative to that of the scan, at most 0 [s].

        Args:
            num_beams: number of beams, B.
            duration: time of a turn [s].
        """
        if not self.is_turning:
            return jnp.zeros(num_beams)
        return duration * (jnp.arange(1.0 - num_beams, 1.0) / num_beams)

    def poses(self, twist: Twist, times: Float[Array, " B"]) -> Float[Array, "B 3"]:
        """Return the poses (B, 3) of the lidar in the frame of the robot at the time of the scan.

        At the time t the robot is at `R(omega t / 2) (vx t, vy t)` with the heading `omega t`.

        Args:
            twist: velocity (vx, vy, omega) of the robot in its frame [m/s, m/s, rad/s].
            times: (B,) times relative to that of the scan [s].
        """
        here = jnp.stack([self.x, self.y, self.yaw])

        def at(time: Scalar) -> Pose:
            x, y, turn = jnp.unstack(time * twist)
            # The direction of motion is that in the middle of the time, as everywhere else.
            half = jnp.stack([jnp.zeros(()), jnp.zeros(()), 0.5 * turn])
            return compose(compose(half, jnp.stack([x, y, 0.5 * turn])), here)

        return jax.vmap(at)(times)


def project_scan(scan: Scan, sensor: Beams, poses: Float[Array, "B 3"]) -> Scan:
    """Return a scan around the robot's centre at the time of the scan.

    The ends of the beams in their order are the outline of what the lidar has seen to be free. A
    beam around the centre ends where it leaves the outline. If that is between the ends of two
    neighbouring beams that returned from one surface, it has a return there; between two that met
    nothing it has none, and is free up to there, which may be nearer than the greatest range.
    Anywhere else is what is hidden from the lidar or was not measured. The beam is then no
    measurement: its range is 0, and no free space is invented. A return without a neighbour on its
    surface goes to the beam whose direction is nearest.

    Neighbours are on one surface if it is not nearer than 5 degrees to the direction of the beams,
    and if they are at most 0.5 m apart (the adaptive breakpoint detector of Borges and Aldon, Line
    Extraction in 2D Range Images for Mobile Robotics, 2004). A notch of one or two beams in the
    outline, such as a missing or a false return, hides nothing behind it.

    `sensor` has the beams of the lidar; those around the centre are the same. Each beam was
    measured from its pose in `poses`, in the frame of the robot at the time of the scan
    [m, m, rad].
    """
    number, spacing = sensor.num_beams, sensor.beam_spacing
    closed = _close_notches(scan.ranges)
    is_notch = closed > scan.ranges + MOST_GAP
    outline, is_own = jnp.where(is_notch, closed, scan.ranges), ~is_notch & (scan.ranges > 0.0)
    angles = poses[:, 2] + jnp.asarray(sensor.beam_angles)
    ways = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=1)
    ends, near = (poses[:, :2] + each[:, None] * ways for each in (outline, scan.ranges))
    nexts, least = jnp.roll(ends, -1, axis=0), jnp.minimum(outline, jnp.roll(outline, -1))
    gap = jnp.hypot(*jnp.unstack(nexts - ends, axis=1))
    widest = jnp.minimum(spacing / math.sin(FLATTEST) * least + SLACK, MOST_GAP)
    is_joined = is_own & jnp.roll(is_own, -1) & (gap <= widest)
    is_joined &= scan.is_return == jnp.roll(scan.is_return, -1)
    is_edge = jnp.ones(number, bool).at[-1].set(sensor.is_full_circle)
    is_joined &= is_edge
    # With c = u x e and f = u . e, the beam u leaves through the edge from e to e' if c <= 0 < c',
    # at the distance (f c' - f' c) / (c' - c). Edges on surfaces are longer by the rounding.
    around = jnp.asarray(sensor.beam_angles)
    x, y = jnp.cos(around)[:, None], jnp.sin(around)[:, None]
    (c, f), (next_c, next_f) = (
        (x * each[:, 1] - y * each[:, 0], x * each[:, 0] + y * each[:, 1]) for each in (ends, nexts)
    )
    over = jnp.where(is_joined, ROUNDING, 0.0)
    is_left = (c <= over) & (next_c > -over) & (next_c > c)
    distance = (f * next_c - next_f * c) / jnp.where(is_left, next_c - c, 1.0)
    distance = jnp.where(is_left & (distance > 0.0) & is_edge, distance, jnp.inf)

    def first(is_meant: Array) -> Float[Array, " B"]:
        return jnp.where(is_meant, distance, jnp.inf).min(axis=1)

    met, free = first(is_joined & scan.is_return), first(is_joined & ~scan.is_return)
    hidden = first(~is_joined)
    alone = _nearest(near, scan.is_return & ~is_joined & ~jnp.roll(is_joined, 1), sensor)
    # It is a corner of the outline, which the beam may leave just before.
    alone = jnp.where(alone <= jnp.minimum(hidden, free) + MOST_GAP, alone, jnp.inf)
    is_met = jnp.minimum(met, free) <= hidden + ROUNDING
    met, free = (jnp.where(is_met, each, jnp.inf) for each in (met, free))
    met = jnp.minimum(met, alone)
    # What is farther than the greatest range is no return.
    ranges = jnp.minimum(jnp.minimum(met, free), sensor.max_range)
    is_return = (met <= free) & (met <= sensor.max_range)
    is_measured = jnp.isfinite(met) | jnp.isfinite(free)
    return Scan(jnp.where(is_measured, ranges, 0.0), is_return)


def _nearest(
    points: Float[Array, "B 2"], is_meant: Bool[Array, " B"], sensor: Beams
) -> Float[Array, " B"]:
    """Return the distance (B,) of the nearest of the points in the direction of each beam [m]."""
    number, spacing = sensor.num_beams, sensor.beam_spacing
    bearing = jnp.arctan2(points[:, 1], points[:, 0])
    turned = bearing - float(sensor.beam_angles[0]) + 0.5 * spacing
    beam = jnp.floor((turned % (2.0 * jnp.pi)) / spacing).astype(jnp.int32)
    if sensor.is_full_circle:
        beam = beam % number
    # What does not count is scattered to an index out of bounds, which is dropped.
    beam = jnp.where(is_meant, beam, number)
    distance = jnp.hypot(points[:, 0], points[:, 1])
    return jnp.full(number, jnp.inf).at[beam].min(distance, mode="drop")


def _close_notches(ranges: Float[Array, " B"]) -> Float[Array, " B"]:
    """Return ranges (B,) without notches of one or two beams: the closing of morphology."""

    def around(values: Array, reduce: Callable[[Array, Array], Array]) -> Array:
        return reduce(reduce(jnp.roll(values, 1), values), jnp.roll(values, -1))

    return around(around(ranges, jnp.maximum), jnp.minimum)
