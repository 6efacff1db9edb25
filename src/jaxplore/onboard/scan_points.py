"""Where the beams of a scan start, and the points that a command is checked against."""

import math
from typing import NamedTuple

import numpy as np

from jaxplore.sensing.beams import Beams, Scan
from jaxplore.sensing.sweep import Sweep, undistort_points, undistort_scan

NUM_POINTS = 720
"""Number of directions for each of which the nearest point of a scan is kept."""
CHECKED_SECONDS = 0.3
"""Time for which the points of a scan count beside those of a newer one [s]. A scan that somebody
else sends between two of the lidar then takes no point away."""


class TakenScan(NamedTuple):
    """A scan as a pilot takes it.

    `points` (N, 2) are all valid returns in the frame of the robot [m]. `sweep` is when its
    directions were measured; all at one time when absent.
    """

    time: float
    scan: Scan
    points: np.ndarray
    sweep: Sweep | None = None

    def undistort(self, sensor: Beams, twist: np.ndarray, place: np.ndarray) -> "TakenScan":
        """Return the scan as one that was measured at its time at once.

        `place` (2,) is the lidar's position on the robot [m], and `twist` (3,) the velocity in its
        frame.
        """
        if self.sweep is None or not np.any(twist):
            return self
        away = self.points - place
        times = self.sweep.times(np.arctan2(away[:, 1], away[:, 0]))
        return self._replace(
            scan=undistort_scan(self.scan, sensor, self.sweep, twist, place),
            points=undistort_points(self.points, times, twist),
            sweep=None,
        )


def no_points() -> tuple[np.ndarray, np.ndarray]:
    """Return the arrays of `nearest_points` for a scan without a return."""
    return np.zeros((NUM_POINTS, 2), np.float32), np.zeros(NUM_POINTS, bool)


def nearest_points(points: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the nearest point of a scan in each direction from the robot, and where there is one.

    Points (N, 2) are in the frame of the robot [m]. Those that are returned (NUM_POINTS, 2) are in
    the frame of its pose (3,). Scans of any number of readings give arrays of one shape, so nothing
    compiles again.
    """
    nearest, is_point = no_points()
    distance = np.hypot(*points.T)
    bearing = np.arctan2(points[:, 1], points[:, 0])
    sector = np.floor((bearing / math.tau + 0.5) * NUM_POINTS).astype(int) % NUM_POINTS
    # Of several points in a direction the nearest is written last.
    order = np.argsort(-distance, kind="stable")
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    turned = points @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
    nearest[sector[order]] = turned[order]
    is_point[sector] = True
    return nearest, is_point


class RecentPoints:
    """The points of the newest scan, and of those that are at most `CHECKED_SECONDS` older.

    `pose` (3,) is that of the robot at the newest scan, without corrections [m, m, rad].
    """

    def __init__(self) -> None:
        self.pose = np.zeros(3)
        self._scans: list[tuple[float, np.ndarray]] = []

    def forget(self) -> None:
        """Forget all points."""
        self._scans = []

    def add(self, time: float, points: np.ndarray, pose: np.ndarray) -> None:
        """Add points (N, 2) in the robot's frame [m], and its pose (3,) without corrections."""
        kept = [each for each in self._scans if time - each[0] <= CHECKED_SECONDS]
        nearest, is_point = nearest_points(points, pose)
        self._scans, self.pose = [*kept, (time, nearest[is_point])], pose

    def place(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return `nearest_points` of all scans, for the corrected pose (3,) at the newest scan."""
        points = np.concatenate([np.zeros((0, 2)), *(each for _, each in self._scans)])
        cos, sin = math.cos(self.pose[2]), math.sin(self.pose[2])
        return nearest_points((points - self.pose[:2]) @ np.array([[cos, -sin], [sin, cos]]), pose)


def lidar_pose(pose: np.ndarray, x: float, y: float) -> np.ndarray:
    """Return the pose (3,) of a lidar, `x` ahead of the robot's centre and `y` to the left [m].

    Its beams start there; a turn of the lidar is in their angles.
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return np.asarray(pose + np.array([cos * x - sin * y, sin * x + cos * y, 0.0]))
