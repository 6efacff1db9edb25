"""Poses from motions, as an oracle: one after the other, in plain Python."""

import math

import numpy as np


def add_motions(first: np.ndarray, motions: np.ndarray) -> np.ndarray:
    """Return the poses (N, 3) that motions (N, 3) lead to from the first; motion 0 is not read."""
    reached = [first]
    for dx, dy, turn in motions[1:]:
        x, y, yaw = reached[-1]
        cos, sin = math.cos(yaw), math.sin(yaw)
        reached.append(np.array([x + cos * dx - sin * dy, y + sin * dx + cos * dy, yaw + turn]))
    return np.array(reached)
