"""Sizes and geometry that all pictures share."""

import numpy as np

SUPERSAMPLING = 2
"""Supersampling factor along each axis."""
MIN_WIDTH, MIN_MAP_SIDE = 320, 24
"""Smallest picture and smallest map [pixels of scale 1]."""
WIDTH = 720
"""Width of the picture of a run, or the longer side of its map [pixels of scale 1]."""


def pairs(points: np.ndarray) -> list[tuple[float, float]]:
    """Convert points (N, 2) to the tuples that Pillow takes."""
    return [(x, y) for x, y in points.tolist()]


def to_frame(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Transform world points (..., 2) [m] into the frame of a pose [m, m, rad]."""
    yaw = float(pose[2])
    shifted = np.asarray(points, np.float64) - np.asarray(pose[:2], np.float64)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return np.asarray(shifted @ turn)


def outline_at(corners: np.ndarray, position: np.ndarray, heading: float) -> np.ndarray:
    """Transform a robot's corners (..., 2) from its own frame to the world [m]."""
    cos, sin = np.cos(heading), np.sin(heading)
    turn = np.array([[cos, sin], [-sin, cos]])
    return np.asarray(np.asarray(corners, np.float64) @ turn + np.asarray(position, np.float64))


def round_length(most: float) -> float:
    """Return the greatest length of 1, 2 or 5 times a power of ten that is at most `most` [m]."""
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= most))
