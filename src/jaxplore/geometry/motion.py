"""Compose and compare poses in the plane, with the derivatives that covariances need."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jaxplore._types import Pose, Scalar

Points = Float[Array, "N 2"]
Matrix = Float[Array, "3 3"]
Rows = NDArray[np.float64]


def wrap_angle(angle: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """Return angles in [-pi, pi] [rad]."""
    return jnp.arctan2(jnp.sin(angle), jnp.cos(angle))


def compose(pose: Pose, increment: Pose) -> Pose:
    """Return the pose (x, y, yaw) after a motion (dx, dy, dyaw) in the frame of the pose before it.

    (x, y) + R(yaw) (dx, dy),   yaw + dyaw
    """
    sin, cos = jnp.sin(pose[2]), jnp.cos(pose[2])
    dx, dy, turn = jnp.unstack(increment)
    return pose + jnp.stack([cos * dx - sin * dy, sin * dx + cos * dy, turn])


def between(pose: Pose, other: Pose) -> Pose:
    """Return the motion (dx, dy, dyaw) from a pose to another one, in the frame of the first.

    `compose(pose, between(pose, other))` is the other pose; the turn is in [-pi, pi].
    """
    sin, cos = jnp.sin(pose[2]), jnp.cos(pose[2])
    dx, dy, turn = jnp.unstack(other - pose)
    return jnp.stack([cos * dx + sin * dy, cos * dy - sin * dx, wrap_angle(turn)])


def propagate_covariance(pose: Pose, increment: Pose, covariance: Matrix, added: Matrix) -> Matrix:
    """Return the covariance of a pose after an uncertain motion (`added`, Q, in its frame), to
    first order:

        F P F' + G Q G',   F = d compose / d pose,   G = d compose / d increment
    """
    sin, cos = jnp.sin(pose[2]), jnp.cos(pose[2])
    dx, dy, _ = jnp.unstack(increment)
    one, nothing = jnp.ones(()), jnp.zeros(())
    by_pose = jnp.stack(
        [
            jnp.stack([one, nothing, -sin * dx - cos * dy]),
            jnp.stack([nothing, one, cos * dx - sin * dy]),
            jnp.stack([nothing, nothing, one]),
        ]
    )
    turned = rotation(pose[2])
    return by_pose @ covariance @ by_pose.T + turned @ added @ turned.T


def rotation(yaw: Scalar) -> Matrix:
    """Return the matrix (3, 3) that turns the position of a pose by an angle [rad]."""
    sin, cos = jnp.sin(yaw), jnp.cos(yaw)
    one, nothing = jnp.ones(()), jnp.zeros(())
    return jnp.stack(
        [
            jnp.stack([cos, -sin, nothing]),
            jnp.stack([sin, cos, nothing]),
            jnp.stack([nothing, nothing, one]),
        ]
    )


def transform_points(pose: Pose, points: Points) -> Points:
    """Return points (N, 2) of the frame of a pose in the world [m]."""
    sin, cos = jnp.sin(pose[2]), jnp.cos(pose[2])
    x = cos * points[:, 0] - sin * points[:, 1] + pose[0]
    y = sin * points[:, 0] + cos * points[:, 1] + pose[1]
    return jnp.stack([x, y], axis=1)


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
