"""Poses along a way and the motions between them, on the host in double precision."""

import numpy as np
from numpy.typing import NDArray

Rows = NDArray[np.float64]


def motions_between(poses: Rows, others: Rows) -> Rows:
    """Return the motions (N, 3) from poses (x, y, yaw) to others, in the frames of the first ones.

    The turns are in [-pi, pi].
    """
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    dx, dy, turn = (others - poses).T
    turn = turn - 2.0 * np.pi * np.round(turn / (2.0 * np.pi))
    return np.stack([cos * dx + sin * dy, cos * dy - sin * dx, turn], axis=1)


def steps_along(poses: Rows) -> Rows:
    """Return the motion to each pose from the one before it, (N, 3), zero for the first one."""
    return motions_between(np.concatenate([poses[:1], poses[:-1]]), poses)


def accumulate_motions(first: Rows, motions: Rows) -> Rows:
    """Return the poses (N, 3) after motions (N, 3), the first of which is not made.

    The way begins at the pose `first`. Each motion is in the frame of the pose before it.
    """
    yaw = first[2] + np.concatenate([[0.0], np.cumsum(motions[1:, 2])])
    cos, sin = np.cos(yaw[:-1]), np.sin(yaw[:-1])
    dx, dy = motions[1:, 0], motions[1:, 1]
    steps = np.stack([cos * dx - sin * dy, sin * dx + cos * dy], axis=1)
    places = first[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.column_stack([places, yaw])
