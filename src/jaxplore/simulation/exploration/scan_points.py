"""What a guard needs of the scans of a period."""

from collections.abc import Sequence

import jax.numpy as jnp

from jaxplore._types import Pose, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.control.guard import ScanPoints
from jaxplore.control.plausibility import scan_misfit
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.beams import Scan


def scan_points(
    belief: Belief,
    sensors: Sequence[Sensor],
    scans: Sequence[Scan],
    measured: Pose,
    expected: Pose,
    time: Scalar,
    interval: Scalar,
) -> ScanPoints:
    """Return the end points of the scans, and how badly they fit the map.

    Args:
        belief: what the robot knows, before the scans.
        sensors: the sensors.
        scans: a scan of each.
        measured: pose (x, y, yaw) by the odometry, at which the scans must fit [m, m, rad].
        expected: pose by which the points are placed, also where the odometry cannot be true.
        time: time of the scans [s].
        interval: time between two of them [s].
    """
    points, is_point = [], []
    for sensor, scan in zip(sensors, scans, strict=True):
        angles = expected[2] + jnp.asarray(sensor.beam_angles)
        directions = jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1)
        points.append(expected[:2] + scan.ranges[:, None] * directions)
        # A beam that ended at a moving obstacle has no return, but is shorter than the others.
        is_point.append(scan.is_return | (scan.ranges < sensor.max_range - 1e-3))
    misfit = scan_misfit(belief, sensors[0], scans[0], measured)
    return ScanPoints(jnp.concatenate(points), jnp.concatenate(is_point), misfit, time, interval)
