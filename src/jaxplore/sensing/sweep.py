"""Motion of the robot during a scan: each beam is measured from where the robot is by then."""

import math
from typing import NamedTuple

import numpy as np

from jaxplore._xla import on_device
from jaxplore.sensing.beams import Beams, Scan


class Sweep(NamedTuple):
    """When each direction of a scan is measured: that of the first reading in the frame of the
    robot, and the rate at which it turns [rad/s], negative if clockwise."""

    begin: float
    rate: float

    def times(self, angles: np.ndarray) -> np.ndarray:
        """Return the times of directions in the robot's frame, after the first reading [s]."""
        # A first reading that rounding puts before the beginning is not the last one.
        turned = math.copysign(1.0, self.rate) * (angles - self.begin) + 1e-6
        return np.asarray(np.mod(turned, math.tau) / abs(self.rate))


def undistort_points(points: np.ndarray, times: np.ndarray, twist: np.ndarray) -> np.ndarray:
    """Return points (N, 2) in the frame of the robot at the time of the first reading [m].

    Each point is given in the frame of the robot at its own time. `times` are those after the first
    reading [s]. The twist is (vx, vy, omega) in the frame of the robot.
    """
    turn = twist[2] * times
    # The direction of motion is that in the middle of the time, as everywhere else.
    cos, sin = np.cos(0.5 * turn), np.sin(0.5 * turn)
    vx, vy = twist[0] * times, twist[1] * times
    place = np.stack([cos * vx - sin * vy, sin * vx + cos * vy], axis=-1)
    cos, sin = np.cos(turn), np.sin(turn)
    x, y = points[:, 0], points[:, 1]
    return np.asarray(place + np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1))


def undistort_scan(
    scan: Scan, sensor: Beams, sweep: Sweep, twist: np.ndarray, place: np.ndarray
) -> Scan:
    """Return a scan as one from the pose of the lidar at the time of the first reading.

    Each end goes to the beam whose direction is nearest by then; of several the nearest one counts,
    and a beam without any is no measurement. Twist (vx, vy, omega) and `place` of the lidar are in
    the robot's frame.
    """
    ranges, is_return = np.asarray(scan.ranges, np.float64), np.asarray(scan.is_return)
    angles = sensor.beam_angles.astype(np.float64)
    ends = place + ranges[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    moved = undistort_points(ends, sweep.times(angles), twist) - place
    distance, bearing = np.hypot(*moved.T), np.arctan2(moved[:, 1], moved[:, 0])
    spacing = sensor.beam_spacing
    turned = np.mod(bearing - angles[0] + 0.5 * spacing, math.tau)
    beam = np.floor(turned / spacing).astype(int)
    if sensor.is_full_circle:
        beam %= len(angles)
    is_kept = (ranges > 0.0) & (beam < len(angles))
    found, returned = np.zeros(len(angles), np.float32), np.zeros(len(angles), bool)
    # What is written last counts: the nearest.
    for each in np.argsort(-distance, kind="stable"):
        if is_kept[each]:
            found[beam[each]] = min(distance[each], sensor.max_range)
            returned[beam[each]] = is_return[each] and distance[each] <= sensor.max_range
    return Scan(on_device(found), on_device(returned))
