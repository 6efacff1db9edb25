"""Odometry of a robot in a volume with errors, as of a camera and an IMU."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxplore import _checks
from jaxplore._types import ArrayLike, Key, Scalar
from jaxplore.geometry.level_motion import LevelMatrix, LevelPose


class VolumeOdometryBias(NamedTuple):
    """The error of an odometry that stays the same during a run: `scale`, a share of the
    distance."""

    scale: Scalar


class VolumeOdometry(eqx.Module):
    """The model of a visual-inertial odometry: position and yaw drift, roll and pitch do not.

    Gravity tells roll and pitch, so that four numbers have errors. A motion (dx, dy, dz, dyaw) in
    the level frame of the robot, of the length s, is measured as

        (1 + scale) (dx, dy, dz) + n_xyz,   dyaw + n_yaw

        n_xyz ~ N(0, distance_noise^2 s I)
        n_yaw ~ N(0, turn_per_distance^2 s + turn_noise^2 |dyaw|)

    The variances grow with the motion, as those of `Odometry`, and `scale` is drawn once for a run.
    With the defaults the position is wrong by 2 % after 10 m and the yaw by 0.6 degrees, or by
    0.9 where the robot turns half a radian every metre.

    Source: Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, section 5.4; that roll and pitch
    do not drift: Qin, Li and Shen, "VINS-Mono", IEEE Transactions on Robotics 2018, section VIII.

    Args:
        distance_noise: standard deviation of each coordinate of the position after a metre [m].
        turn_per_distance: standard deviation of the yaw after a metre [rad].
        turn_noise: standard deviation of the yaw after a turn by a radian [rad].
        scale: standard deviation of the error of the distance, as a share of it.

    Raises:
        ValueError: a standard deviation that is negative or not finite.
    """

    distance_noise: Scalar
    turn_per_distance: Scalar
    turn_noise: Scalar
    scale: Scalar

    def __init__(
        self,
        distance_noise: ArrayLike = 0.03,
        turn_per_distance: ArrayLike = 0.0035,
        turn_noise: ArrayLike = 0.005,
        scale: ArrayLike = 0.01,
    ) -> None:
        self.distance_noise = _checks.scalar("distance_noise", distance_noise, at_least=0.0)
        self.turn_per_distance = _checks.scalar(
            "turn_per_distance", turn_per_distance, at_least=0.0
        )
        self.turn_noise = _checks.scalar("turn_noise", turn_noise, at_least=0.0)
        self.scale = _checks.scalar("scale", scale, at_least=0.0)

    def draw(self, key: Key | None) -> VolumeOdometryBias:
        """Draw the error that stays the same during a run.

        Args:
            key: random key of the run; no error when absent.
        """
        if key is None:
            return VolumeOdometryBias(jnp.zeros(()))
        return VolumeOdometryBias(self.scale * jax.random.normal(key))

    def measure(
        self, increment: LevelPose, elapsed: Scalar, errors: VolumeOdometryBias, key: Key
    ) -> tuple[LevelPose, VolumeOdometryBias]:
        """Return a motion (dx, dy, dz, dyaw) as it is measured, and the errors of the run, the
        same.

        Args:
            increment: true motion in the level frame of the robot [m, m, m, rad].
            elapsed: time that it took [s].
            errors: errors of the run.
            key: random key of the noise.
        """
        std = jnp.sqrt(self._variances(increment))
        share = jnp.append(jnp.full(3, 1.0 + errors.scale), 1.0)
        return share * increment + std * jax.random.normal(key, (4,)), errors

    def covariance(self, increment: LevelPose) -> LevelMatrix:
        """Return the covariance (4, 4) of a measured motion, in the level frame of the robot.

        The error of scale enters as noise with the same variance after a metre.

        Args:
            increment: measured motion (dx, dy, dz, dyaw) [m, m, m, rad].
        """
        length = jnp.linalg.norm(increment[:3])
        scale = self.scale**2 * length * jnp.array([1.0, 1.0, 1.0, 0.0])
        return jnp.diag(self._variances(increment) + scale)

    def _variances(self, increment: LevelPose) -> LevelPose:
        """Return the variances of the noise of a motion."""
        length, turn = jnp.linalg.norm(increment[:3]), jnp.abs(increment[3])
        yaw = self.turn_per_distance**2 * length + self.turn_noise**2 * turn
        return jnp.append(jnp.full(3, self.distance_noise**2 * length), yaw)
