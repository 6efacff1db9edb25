"""A costmap of another program, such as nav2's local one, as what a lidar would see of it."""

import math
from typing import NamedTuple

import numpy as np

from jaxplore._xla import on_device
from jaxplore.sensing.beams import Beams, Scan

LETHAL = 100
"""Value of a cell with an obstacle in the `OccupancyGrid` of a nav2 costmap; 99 is inflation."""
MOST_POINTS = 4000
"""Greatest number of cells that are taken, the nearest ones."""


class Costmap(NamedTuple):
    """Cells with obstacles.

    Args:
        time: time of the map [s].
        frame: name of its frame.
        centres: (N, 2) centres of the cells with obstacles in that frame [m].
        cell_size: side of a cell [m].
        corner: (3,) pose of the outer corner of cell (0, 0) [m, m, rad].
        size: (2,) width and height of the map [m].
    """

    time: float
    frame: str
    centres: np.ndarray
    cell_size: float
    corner: np.ndarray
    size: np.ndarray

    @classmethod
    def of_cells(
        cls, values: np.ndarray, cell_size: float, corner: np.ndarray, time: float, frame: str
    ) -> "Costmap":
        """Make a costmap of the values (H, W) of an `OccupancyGrid`."""
        rows, columns = np.nonzero(values >= LETHAL)
        local = (np.stack([columns, rows], axis=-1) + 0.5) * cell_size
        size = np.array(values.shape[::-1]) * cell_size
        return cls(time, frame, _moved(local, corner), cell_size, corner, size)

    def points(self, pose: np.ndarray, max_range: float) -> np.ndarray:
        """Return the near edges (M, 2) of the cells within a range of a pose (3,), in its frame.

        They are those of discs with the area of a cell [m].
        """
        local = _seen_from(self.centres, pose)
        away = np.hypot(*local.T)
        near = np.argsort(away)[: min(MOST_POINTS, int((away <= max_range).sum()))]
        radius = self.cell_size / math.sqrt(math.pi)
        share = 1.0 - radius / np.maximum(away[near], 1.5 * radius)
        edges: np.ndarray = local[near] * share[:, None]
        return edges

    def ranges(self, sensor: Beams, pose: np.ndarray) -> np.ndarray:
        """Return the ranges (B,) of the beams of a lidar at a pose (3,) [m]; infinite without one.

        A cell is met by the beams that pass the disc with its area, where that begins.
        """
        points = self.points(pose, sensor.max_range)
        radius = self.cell_size / math.sqrt(math.pi)
        away = np.maximum(np.hypot(*points.T), 1e-6)
        bearing = np.arctan2(points[:, 1], points[:, 0])
        half = np.arcsin(np.minimum(1.0, radius / away)) + 0.5 * sensor.beam_spacing
        turn = sensor.beam_angles.astype(np.float64)[:, None] - bearing
        is_met = np.abs(turn - math.tau * np.round(turn / math.tau)) <= half
        met = np.where(is_met, away, np.inf)
        return np.min(met, axis=1, initial=np.inf)

    def edge(self, sensor: Beams, pose: np.ndarray) -> np.ndarray:
        """Return how far the beams (B,) of a lidar at a pose (3,) go in the map [m]."""
        place = _seen_from(pose[None, :2], self.corner)[0]
        angles = sensor.beam_angles.astype(np.float64) + pose[2] - self.corner[2]
        directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        ahead = np.where(directions > 0.0, self.size - place, place)
        with np.errstate(divide="ignore", invalid="ignore"):
            lengths = np.where(np.abs(directions) > 1e-9, ahead / np.abs(directions), np.inf)
        reach: np.ndarray = np.maximum(lengths.min(axis=1), 0.0)
        return reach

    def scan(self, sensor: Beams, lidar: np.ndarray, scan: Scan | None = None) -> Scan:
        """Return what a lidar would measure, or the nearer one of that and a scan.

        A beam of the lidar alone that meets nothing ends at the edge of the map, or at its range.

        Args:
            sensor: the lidar.
            lidar: (3,) its pose in the frame of the costmap [m, m, rad].
            scan: what a real lidar has measured there.
        """
        met = self.ranges(sensor, lidar)
        if scan is None:
            ranges = np.minimum(self.edge(sensor, lidar), sensor.max_range)
            is_return = np.zeros(len(ranges), bool)
        else:
            ranges, is_return = np.asarray(scan.ranges), np.asarray(scan.is_return)
        # A range of 0 is no measurement.
        is_nearer = (met < ranges) | ((ranges <= 0.0) & np.isfinite(met))
        nearer = np.where(is_nearer, met, ranges).astype(np.float32)
        return Scan(on_device(nearer), on_device(is_return | is_nearer))


def _moved(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return points (N, 2) of a frame whose pose (3,) is given, outside of it."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    outside: np.ndarray = points @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]
    return outside


def _seen_from(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return points (N, 2) in the frame of a pose (3,)."""
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    inside: np.ndarray = (points - pose[:2]) @ np.array([[cos, -sin], [sin, cos]])
    return inside
