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

    Args:
        time: time of the scan [s].
        scan: readings of the beams of the sensor.
        points: (N, 2) all valid returns in the frame of the robot [m].
        sweep: when its directions were measured; all at one time when absent.
    """

    time: float
    scan: Scan
    points: np.ndarray
    sweep: Sweep | None = None

    def undistort(self, sensor: Beams, twist: np.ndarray, place: np.ndarray) -> "TakenScan":
        """Return the scan as one that was measured at its time at once.

        Args:
            sensor: sensor of the scan.
            twist: (3,) velocity (vx, vy, omega) of the robot in its frame.
            place: (2,) position of the lidar on the robot [m].
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
    """Return the nearest point of a scan in each direction from the robot.

    Scans of any number of readings give arrays of one shape, so nothing compiles again.

    Args:
        points: (N, 2) returns in the frame of the robot [m].
        pose: (3,) pose of the robot [m, m, rad].

    Returns:
        The points (NUM_POINTS, 2) in the frame of the pose [m], and which of them there are.
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

    Attributes:
        pose: (3,) pose of the robot at the newest scan, without corrections [m, m, rad].
    """

    def __init__(self) -> None:
        self.pose = np.zeros(3)
        self._scans: list[tuple[float, np.ndarray]] = []

    def forget(self) -> None:
        """Forget all points."""
        self._scans = []

    def add(self, time: float, points: np.ndarray, pose: np.ndarray) -> None:
        """Add the points of a scan.

        Args:
            time: time of the scan [s].
            points: (N, 2) returns in the frame of the robot [m].
            pose: (3,) pose of the robot at that time, without corrections [m, m, rad].
        """
        kept = [each for each in self._scans if time - each[0] <= CHECKED_SECONDS]
        nearest, is_point = nearest_points(points, pose)
        self._scans, self.pose = [*kept, (time, nearest[is_point])], pose

    def place(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what `nearest_points` does, of all scans.

        Args:
            pose: (3,) pose of the robot at the newest scan, with corrections [m, m, rad].
        """
        points = np.concatenate([np.zeros((0, 2)), *(each for _, each in self._scans)])
        cos, sin = math.cos(self.pose[2]), math.sin(self.pose[2])
        return nearest_points((points - self.pose[:2]) @ np.array([[cos, -sin], [sin, cos]]), pose)


def lidar_pose(pose: np.ndarray, x: float, y: float) -> np.ndarray:
    """Return the pose (3,) from which beams start; a turn of the lidar is in their angles.

    Args:
        pose: (3,) pose of the robot [m, m, rad].
        x: position of the lidar ahead of the robot's centre [m].
        y: position of the lidar to the left of it [m].
    """
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return np.asarray(pose + np.array([cos * x - sin * y, sin * x + cos * y, 0.0]))
