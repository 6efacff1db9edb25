"""What a guard needs of the scans of a period."""

from collections.abc import Sequence

import jax.numpy as jnp

from jaxplore._types import Pose, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.belief.perception import Perception
from jaxplore.belief.tracks import beam_ends
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
    perception: Perception,
) -> ScanPoints:
    """Return the end points of the scans, one of each sensor, and how badly they fit the map.

    `belief` is what the robot knows before the scans. They must fit the map at the pose `measured`,
    that of the odometry. The points are placed by the pose `expected`, also where the odometry
    cannot be true. `time` is the time of the scans and `interval` the time between two of them [s].
    Without a tracker of moving obstacles nothing moves. On hills beams end as they do at walls, so
    there the points say nothing of commands.
    """
    points, is_point = [], []
    for sensor, scan in zip(sensors, scans, strict=True):
        points.append(beam_ends(sensor, scan, expected))
        # A beam that ended at a moving obstacle may have no return, but is shorter than the others.
        # One without a measurement has the range 0.
        is_shorter = (scan.ranges > 0.0) & (scan.ranges < sensor.clear_range)
        is_point.append(scan.is_return | is_shorter)
    misfit = scan_misfit(belief, sensors[0], scans[0], measured)
    ends, is_end = jnp.concatenate(points), jnp.concatenate(is_point)
    speeds = None if perception.ground is not None else jnp.zeros(ends.shape[0])
    tracker = perception.tracker
    if tracker is not None and belief.tracks is not None:
        speeds = tracker.possible_speeds(belief.tracks, belief.clearance, ends, is_end)
    return ScanPoints(ends, is_end, misfit, time, interval, speeds)
