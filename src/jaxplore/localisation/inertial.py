"""Odometry of an inertial measurement unit, whose error grows with time and not with the way."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, Key, Pose, Scalar
from jaxplore.geometry.motion import Matrix, compose
from jaxplore.localisation.odometry_model import (
    ErrorEstimate,
    OdometryModel,
    Reckoning,
    Velocity,
)


class InertialErrors(NamedTuple):
    """The errors of an inertial odometry at a moment of a run.

    Args:
        velocity: (2,) error of the integrated velocity, in the frame of the robot [m/s].
        acceleration: (2,) bias of the accelerometers, in that frame [m/s^2].
        gyro: bias of the turn rate [rad/s].
    """

    velocity: Velocity
    acceleration: Float[Array, "2"]
    gyro: Scalar


class InertialOdometry(OdometryModel):
    """An odometry that integrates accelerations and turn rates in the plane: strapdown navigation.

    Roll and pitch are taken as known, up to an error that belongs to the bias of the accelerometers
    because gravity leaks through it. In the frame of the robot, with the velocity v, its error e,
    the biases b of the accelerometers and c of the gyroscope, a motion within the time t turns by
    dyaw and is measured as

        (dx, dy) + (e + u / 2) t,   dyaw + c t + n_yaw,    u = b t + n_u
        e' = R(-measured dyaw) (v + e + u) - R(-dyaw) v

        n_u ~ N(0, acceleration_noise^2 t I),   n_yaw ~ N(0, gyro_noise^2 t)

    The velocity keeps its direction in the world: flying straight on, an error of the yaw alone
    does not bend the way. Both biases are Gauss-Markov processes with standard deviations that do
    not change and the time constant `bias_time`. From a known velocity the variance of the position
    after t is `acceleration_noise^2 t^3 / 3`, and a bias adds `b t^2 / 2` to it.

    An estimator learns e, b and c from what corrects its pose, by an extended Kalman filter with
    the errors (e, b, c) in this order.

    Source: Woodman, "An introduction to inertial navigation", 2007 (strapdown, growth of errors);
    Groves, "Principles of GNSS, inertial, and multisensor integrated navigation systems", 2013,
    chapter 14 (errors in the state, Gauss-Markov biases). Defaults: ten times the noise densities
    of the ADIS16448 of the EuRoC data sets (Burri et al., IJRR 2016: 0.002 m/s^2 and 0.00017 rad/s
    per root of a hertz), for the vibration of propellers and a cheaper sensor; gravity through 0.3
    degrees of roll or pitch, 0.05 m/s^2; a gyroscope whose bias was measured at rest.

    Args:
        acceleration_noise: standard deviation of the velocity after a second [m/s^1.5].
        acceleration_bias: standard deviation of the bias of each accelerometer [m/s^2].
        gyro_noise: standard deviation of the yaw after a second [rad/s^0.5].
        gyro_bias: standard deviation of the bias of the turn rate [rad/s].
        bias_time: time within which biases become others [s].

    Raises:
        ValueError: a standard deviation that is negative, a time that is not positive.
    """

    acceleration_noise: Scalar
    acceleration_bias: Scalar
    gyro_noise: Scalar
    gyro_bias: Scalar
    bias_time: Scalar

    def __init__(
        self,
        acceleration_noise: ArrayLike = 0.02,
        acceleration_bias: ArrayLike = 0.05,
        gyro_noise: ArrayLike = 0.0017,
        gyro_bias: ArrayLike = 0.001,
        bias_time: ArrayLike = 100.0,
    ) -> None:
        self.acceleration_noise = _checks.scalar(
            "acceleration_noise", acceleration_noise, at_least=0.0
        )
        self.acceleration_bias = _checks.scalar(
            "acceleration_bias", acceleration_bias, at_least=0.0
        )
        self.gyro_noise = _checks.scalar("gyro_noise", gyro_noise, at_least=0.0)
        self.gyro_bias = _checks.scalar("gyro_bias", gyro_bias, at_least=0.0)
        self.bias_time = _checks.scalar("bias_time", bias_time, above=0.0)

    @property
    def variance_per_metre(self) -> Scalar:
        """Variance of the position after a metre [m^2/m]: at 1 m/s, from a known velocity."""
        second = jnp.ones(())
        return self.covariance(jnp.zeros(3), second)[0, 0]

    def draw(self, key: Key | None) -> InertialErrors:
        """Draw the biases at the start of a run; the velocity is known there.

        Args:
            key: random key of the run; no errors when absent.
        """
        normal = jnp.zeros(3) if key is None else jax.random.normal(key, (3,))
        return InertialErrors(
            jnp.zeros(2), self.acceleration_bias * normal[:2], self.gyro_bias * normal[2]
        )

    def measure(
        self, increment: Pose, elapsed: Scalar, errors: InertialErrors, key: Key
    ) -> tuple[Pose, InertialErrors]:
        """Return a motion as it is measured, and the errors after it; see `OdometryModel`.

        Args:
            increment: true motion in the frame of the robot [m, m, rad].
            elapsed: time that it took [s].
            errors: errors of the run.
            key: random key of the noise.
        """
        normal = jax.random.normal(key, (6,))
        noise = self._noise(elapsed) * normal[:3]
        gained = errors.acceleration * elapsed + noise[:2]
        along = increment[:2] + (errors.velocity + 0.5 * gained) * elapsed
        turn = increment[2] + errors.gyro * elapsed + noise[2]
        velocity = _velocity(increment, elapsed)
        kept, added = self._decay_bias(elapsed)
        after = InertialErrors(
            _rotate_error(velocity, errors.velocity + gained, increment[2], turn),
            kept * errors.acceleration + self.acceleration_bias * added * normal[3:5],
            kept * errors.gyro + self.gyro_bias * added * normal[5],
        )
        return jnp.append(along, turn), after

    def velocity_error(self, errors: InertialErrors, known: ErrorEstimate | None) -> Velocity:
        """Return what is left of the error of the velocity (2,) [m/s]; see `OdometryModel`.

        Args:
            errors: errors of the run.
            known: what the robot knows of them.
        """
        return errors.velocity if known is None else errors.velocity - known.mean[:2]

    def covariance(self, increment: Pose, elapsed: Scalar) -> Matrix:
        """Return the covariance (3, 3) of a motion that begins with a known velocity.

        Args:
            increment: measured motion (dx, dy, dyaw), which does not matter [m, m, rad].
            elapsed: time that it took [s].
        """
        position = self.acceleration_noise**2 * elapsed**3 / 3.0
        position = position + 0.25 * self.acceleration_bias**2 * elapsed**4
        yaw = self.gyro_noise**2 * elapsed + self.gyro_bias**2 * elapsed**2
        return jnp.diag(jnp.stack([position, position, yaw]))

    def estimate(self) -> ErrorEstimate:
        """Return what is known of the errors (5,) at the start: a robot at rest, unknown biases."""
        return ErrorEstimate(jnp.zeros(5), jnp.diag(self._bias_variances()), jnp.zeros((3, 5)))

    def predict(self, known: Reckoning, motion: Pose, elapsed: Scalar) -> Reckoning:
        """Return what is known after a motion, by an extended Kalman filter; see `OdometryModel`.

        Args:
            known: what is known before it.
            motion: measured motion (dx, dy, dyaw) in the frame of the robot [m, m, rad].
            elapsed: time that it took [s].
        """
        errors = self.estimate() if known.errors is None else known.errors
        kept, added = self._decay_bias(elapsed)

        def propagate(values: Float[Array, "8"], noise: Float[Array, "3"]) -> Float[Array, "8"]:
            """Return the true pose and errors after the measured motion, by those before it."""
            pose, error, bias = values[:3], values[3:5], values[5:]
            gained = bias[:2] * elapsed + noise[:2]
            along = motion[:2] - (error + 0.5 * gained) * elapsed
            turn = motion[2] - bias[2] * elapsed - noise[2]
            moved = jnp.append(along, turn)
            carried = _rotate_error(_velocity(moved, elapsed), error + gained, turn, motion[2])
            return jnp.concatenate([compose(pose, moved), carried, kept * bias])

        mean, still = jnp.concatenate([known.pose, errors.mean]), jnp.zeros(3)
        by_values, by_noise = jax.jacfwd(propagate, (0, 1))(mean, still)
        spread = jnp.block([[known.covariance, errors.cross], [errors.cross.T, errors.covariance]])
        noisy = by_noise * self._noise(elapsed)
        wandered = jnp.concatenate([jnp.zeros(3), added**2 * self._bias_variances()])
        spread = by_values @ spread @ by_values.T + noisy @ noisy.T + jnp.diag(wandered)
        spread = 0.5 * (spread + spread.T)
        mean = propagate(mean, still)
        moved = mean[:2] - known.pose[:2]
        return Reckoning(
            mean[:3],
            spread[:3, :3],
            ErrorEstimate(mean[3:], spread[3:, 3:], spread[:3, 3:]),
            known.way + jnp.hypot(moved[0], moved[1]),
        )

    def _noise(self, elapsed: Scalar) -> Float[Array, "3"]:
        """Return the standard deviations of the velocities [m/s] and the yaw [rad] gained."""
        stds = jnp.stack([self.acceleration_noise, self.acceleration_noise, self.gyro_noise])
        return stds * jnp.sqrt(elapsed)

    def _bias_variances(self) -> Float[Array, "5"]:
        """Return the variances of the errors (velocity, biases) with a known velocity."""
        nothing = jnp.zeros(())
        bias = self.acceleration_bias
        return jnp.stack([nothing, nothing, bias, bias, self.gyro_bias]) ** 2

    def _decay_bias(self, elapsed: Scalar) -> tuple[Scalar, Scalar]:
        """Return which share of a bias is left, and the share of its spread that is new."""
        share = elapsed / self.bias_time
        return jnp.exp(-share), jnp.sqrt(-jnp.expm1(-2.0 * share))


def _velocity(motion: Pose, elapsed: Scalar) -> Velocity:
    """Return the velocity (2,) of a motion in the frame of its begin [m/s]; 0 if it took none."""
    is_timed = elapsed > 0.0
    return jnp.where(is_timed, motion[:2] / jnp.where(is_timed, elapsed, 1.0), 0.0)


def _rotate_error(velocity: Velocity, error: Velocity, turn: Scalar, measured: Scalar) -> Velocity:
    """Return the error of a velocity in the frame after a turn.

    The true velocity and its error are in the frame before the turn [m/s]. `turn` is the true turn,
    and `measured` the turn as it is measured [rad].
    """
    return _rotate(velocity + error, -measured) - _rotate(velocity, -turn)


def _rotate(vector: Velocity, angle: Scalar) -> Velocity:
    """Return a vector (2,) turned by an angle [rad]."""
    sin, cos = jnp.sin(angle), jnp.cos(angle)
    x, y = jnp.unstack(vector)
    return jnp.stack([cos * x - sin * y, sin * x + cos * y])
