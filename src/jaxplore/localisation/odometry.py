"""Odometry with errors: noise of wheels, errors of scale, and the bias of a gyroscope."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from jaxplore import _checks
from jaxplore._types import ArrayLike, Key, Pose, Scalar
from jaxplore.geometry.motion import Matrix, compose, propagate_covariance
from jaxplore.localisation.odometry_model import ErrorEstimate, OdometryModel, Reckoning


class OdometryBias(NamedTuple):
    """The errors of an odometry that stay the same during a run.

    Args:
        scale: error of the distance, as a share of it.
        turn_scale: error of the turn, as a share of it.
        turn_per_metre: error of the turn by the distance, as by wheels of two sizes [rad/m].
        gyro: error of the turn rate [rad/s].
    """

    scale: Scalar
    turn_scale: Scalar
    turn_per_metre: Scalar
    gyro: Scalar

    @classmethod
    def none(cls) -> "OdometryBias":
        """Return no errors."""
        return cls(*(jnp.zeros(()) for _ in cls._fields))


class Odometry(OdometryModel):
    """The model of an odometry of wheels that measures how a robot moves, with errors.

    A motion (dx, dy, dyaw) in the frame of the robot, of the length s and within the time t, is
    measured as

        (1 + scale) (dx, dy) + n_xy
        (1 + turn_scale) dyaw + turn_per_metre s + gyro t + n_yaw

        n_xy ~ N(0, (distance_noise^2 s + slip_in_turns^2 |dyaw|) I)
        n_yaw ~ N(0, turn_per_distance^2 s + turn_noise^2 |dyaw|)

    The variances grow with the motion, so that the error of a drive does not depend on the rate at
    which it is measured. The errors of the first line and the second, `scale` to `gyro`, are drawn
    once for a run, from normal distributions with the standard deviations that are given here.

    Source: Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, section 5.4 (alpha model), there
    with standard deviations that grow with the motion.

    Args:
        distance_noise: standard deviation of the position after a metre [m].
        turn_per_distance: standard deviation of the yaw after a metre [rad].
        turn_noise: standard deviation of the yaw after a turn by a radian [rad].
        slip_in_turns: standard deviation of the position after a turn by a radian [m].
        scale: standard deviation of the error of the distance, as a share of it.
        turn_scale: standard deviation of the error of turns, as a share of them.
        turn_per_metre: standard deviation of the turn that wheels of two sizes add [rad/m].
        gyro: standard deviation of the bias of the turn rate [rad/s].

    Raises:
        ValueError: a standard deviation that is negative or not finite.
    """

    distance_noise: Scalar
    turn_per_distance: Scalar
    turn_noise: Scalar
    slip_in_turns: Scalar
    scale: Scalar
    turn_scale: Scalar
    turn_per_metre: Scalar
    gyro: Scalar

    def __init__(
        self,
        distance_noise: ArrayLike = 0.02,
        turn_per_distance: ArrayLike = 0.0175,
        turn_noise: ArrayLike = 0.02,
        slip_in_turns: ArrayLike = 0.005,
        scale: ArrayLike = 0.0,
        turn_scale: ArrayLike = 0.0,
        turn_per_metre: ArrayLike = 0.0,
        gyro: ArrayLike = 0.0,
    ) -> None:
        self.distance_noise = _checks.scalar("distance_noise", distance_noise, at_least=0.0)
        self.turn_per_distance = _checks.scalar(
            "turn_per_distance", turn_per_distance, at_least=0.0
        )
        self.turn_noise = _checks.scalar("turn_noise", turn_noise, at_least=0.0)
        self.slip_in_turns = _checks.scalar("slip_in_turns", slip_in_turns, at_least=0.0)
        self.scale = _checks.scalar("scale", scale, at_least=0.0)
        self.turn_scale = _checks.scalar("turn_scale", turn_scale, at_least=0.0)
        self.turn_per_metre = _checks.scalar("turn_per_metre", turn_per_metre, at_least=0.0)
        self.gyro = _checks.scalar("gyro", gyro, at_least=0.0)

    @property
    def variance_per_metre(self) -> Scalar:
        """Variance of the position after a metre [m^2/m], without that of the scale."""
        return self.distance_noise**2

    def draw(self, key: Key | None) -> OdometryBias:
        """Draw the errors that stay the same during a run.

        Args:
            key: random key of the run; no errors when absent.
        """
        if key is None:
            return OdometryBias.none()
        normal = jax.random.normal(key, (4,))
        stds = jnp.stack([self.scale, self.turn_scale, self.turn_per_metre, self.gyro])
        return OdometryBias(*jnp.unstack(stds * normal))

    def measure(
        self, increment: Pose, elapsed: Scalar, errors: OdometryBias, key: Key
    ) -> tuple[Pose, OdometryBias]:
        """Return a motion (dx, dy, dyaw) as it is measured, and the errors of the run, the same.

        Args:
            increment: true motion in the frame of the robot [m, m, rad].
            elapsed: time that it took [s].
            errors: errors of the run.
            key: random key of the noise.
        """
        length, turn = _sizes(increment)
        normal = jax.random.normal(key, (3,))
        stds = jnp.sqrt(jnp.stack([*self._variances(length, turn)]))
        along = (1.0 + errors.scale) * increment[:2] + stds[0] * normal[:2]
        yaw = (1.0 + errors.turn_scale) * increment[2] + stds[1] * normal[2]
        yaw = yaw + errors.turn_per_metre * length + errors.gyro * elapsed
        return jnp.append(along, yaw), errors

    def velocity_error(self, errors: OdometryBias, known: ErrorEstimate | None) -> None:
        """Return None: the robot measures its speed by its wheels; see `OdometryModel`."""

    def covariance(self, increment: Pose, elapsed: Scalar) -> Matrix:
        """Return the covariance (3, 3) of a measured motion, in the frame of the robot.

        A filter knows nothing of the errors of the run but their distribution. They enter as noise
        that has the same variance after a metre, a radian or a second, and grows with the motion.

        Args:
            increment: measured motion (dx, dy, dyaw) [m, m, rad].
            elapsed: time that it took [s].
        """
        length, turn = _sizes(increment)
        position, yaw = self._variances(length, turn)
        position = position + self.scale**2 * length
        yaw = yaw + self.turn_scale**2 * turn + self.turn_per_metre**2 * length
        yaw = yaw + self.gyro**2 * elapsed
        return jnp.diag(jnp.stack([position, position, yaw]))

    def estimate(self) -> None:
        """Return None: nothing is estimated of the errors; see `OdometryModel`."""

    def predict(self, known: Reckoning, motion: Pose, elapsed: Scalar) -> Reckoning:
        """Return what is known after a motion; see `OdometryModel`.

        Args:
            known: what is known before it.
            motion: measured motion (dx, dy, dyaw) in the frame of the robot [m, m, rad].
            elapsed: time that it took [s].
        """
        added = self.covariance(motion, elapsed)
        return Reckoning(
            compose(known.pose, motion),
            propagate_covariance(known.pose, motion, known.covariance, added),
            None,
            known.way + jnp.hypot(motion[0], motion[1]),
        )

    def _variances(self, length: Scalar, turn: Scalar) -> tuple[Scalar, Scalar]:
        """Return the variances of the noise of each coordinate [m^2] and of the yaw [rad^2]."""
        position = self.distance_noise**2 * length + self.slip_in_turns**2 * turn
        return position, self.turn_per_distance**2 * length + self.turn_noise**2 * turn


def _sizes(increment: Pose) -> tuple[Scalar, Scalar]:
    """Return the length [m] and the turn [rad] of a motion."""
    return jnp.hypot(increment[0], increment[1]), jnp.abs(increment[2])
