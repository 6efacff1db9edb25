"""Compose and compare poses of a robot in a volume whose roll and pitch are known."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Scalar
from jaxplore.geometry.motion import wrap_angle

LevelPose = Float[Array, "4"]
"""Pose (x, y, z, yaw) with z up [m, m, m, rad]."""
LevelMatrix = Float[Array, "4 4"]
"""Covariance or information of such a pose."""


def turn(yaw: Scalar) -> Float[Array, "3 3"]:
    """Return the rotation by an angle about the vertical."""
    sin, cos = jnp.sin(yaw), jnp.cos(yaw)
    nothing, one = jnp.zeros_like(sin), jnp.ones_like(sin)
    rows = ([cos, -sin, nothing], [sin, cos, nothing], [nothing, nothing, one])
    return jnp.stack([jnp.stack(row) for row in rows])


def compose(pose: LevelPose, motion: LevelPose) -> LevelPose:
    """Return the pose after a motion (dx, dy, dz, dyaw) in the frame of the pose before it.

    (x, y, z) + R(yaw) (dx, dy, dz),   yaw + dyaw
    """
    return pose + jnp.append(turn(pose[3]) @ motion[:3], motion[3])


def between(pose: LevelPose, other: LevelPose) -> LevelPose:
    """Return the motion (dx, dy, dz, dyaw) from a pose to another one, in the frame of the first.

    `compose(pose, between(pose, other))` is the other pose; the turn is in [-pi, pi].
    """
    away = other - pose
    return jnp.append(turn(pose[3]).T @ away[:3], wrap_angle(away[3]))


def propagate_covariance(
    pose: LevelPose, motion: LevelPose, covariance: LevelMatrix, added: LevelMatrix
) -> LevelMatrix:
    """Return the covariance of a pose after an uncertain motion (`added`, Q, in its frame), to
    first order:

        F P F' + G Q G',   F = d compose / d pose,   G = d compose / d motion
    """
    ahead, left, _ = jnp.unstack(turn(pose[3]) @ motion[:3])
    by_pose = jnp.eye(4).at[0, 3].set(-left).at[1, 3].set(ahead)
    by_motion = jnp.eye(4).at[:3, :3].set(turn(pose[3]))
    return by_pose @ covariance @ by_pose.T + by_motion @ added @ by_motion.T
