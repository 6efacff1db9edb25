"""What every odometry has: how it measures a motion, and how an estimator reckons with it."""

import abc
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Key, Pose, Scalar
from jaxplore.geometry.motion import Matrix, wrap_angle

Velocity = Float[Array, "2"]


class ErrorEstimate(NamedTuple):
    """What an estimator knows of the errors of an odometry that change the motions to come.

    Args:
        mean: (E,) most likely errors.
        covariance: (E, E) their covariance.
        cross: (3, E) covariance of the pose with them, the pose in the world.
    """

    mean: Float[Array, " E"]
    covariance: Float[Array, "E E"]
    cross: Float[Array, "3 E"]

    def correct(
        self, prior: Pose, spread: Matrix, pose: Pose, covariance: Matrix
    ) -> "ErrorEstimate":
        """Return the estimate after something has corrected the pose, and no errors directly.

            K = P_ep P_pp^-1,   e += K (pose - prior),   P_ee += K (C - P_pp) K',   P_pe = C K'

        with the covariance P_pp of the pose before and C after. This is the update of a Kalman
        filter of pose and errors by any measurement of the pose. Without a finite result only the
        covariance with the pose is lost.

        Args:
            prior: pose before [m, m, rad].
            spread: covariance P_pp (3, 3) of it.
            pose: pose after.
            covariance: covariance C (3, 3) of it.
        """
        # Position and yaw differ in scale, and single precision has few digits to invert with.
        scale = 1.0 / jnp.sqrt(jnp.diagonal(spread))
        inverse = jnp.linalg.inv(scale[:, None] * spread * scale)
        gain = self.cross.T @ (scale[:, None] * inverse * scale)
        away = pose - prior
        away = away.at[2].set(wrap_angle(away[2]))
        known = self.covariance + gain @ (covariance - spread) @ gain.T
        found = ErrorEstimate(self.mean + gain @ away, 0.5 * (known + known.T), covariance @ gain.T)
        is_finite = jnp.stack([jnp.isfinite(each).all() for each in found]).all()
        alone = self.uncouple()
        return ErrorEstimate(
            *(jnp.where(is_finite, new, old) for new, old in zip(found, alone, strict=True))
        )

    def uncouple(self) -> "ErrorEstimate":
        """Return the estimate with a pose that is counted from where the robot is: independent."""
        return self._replace(cross=jnp.zeros_like(self.cross))


class Reckoning(NamedTuple):
    """A pose that follows the odometry.

    Args:
        pose: pose (x, y, yaw) [m, m, rad].
        covariance: (3, 3) its covariance, in the world.
        errors: what is known of the odometry's errors; None where nothing is estimated of them.
        way: length of the way [m].
    """

    pose: Pose
    covariance: Matrix
    errors: ErrorEstimate | None
    way: Scalar


class OdometryModel(eqx.Module):
    """The errors of an odometry: how it measures a motion, and what an estimator knows of them."""

    @property
    @abc.abstractmethod
    def variance_per_metre(self) -> Scalar:
        """Variance of the position, along x and y, after a metre [m^2/m]."""

    @abc.abstractmethod
    def draw(self, key: Key | None) -> Any:
        """Draw the errors at the start of a run.

        Args:
            key: random key of the run; no errors when absent.
        """

    @abc.abstractmethod
    def measure(self, increment: Pose, elapsed: Scalar, errors: Any, key: Key) -> tuple[Pose, Any]:
        """Return a motion (dx, dy, dyaw) as it is measured, and the errors of the run after it.

        Args:
            increment: true motion in the frame of the robot [m, m, rad].
            elapsed: time that it took [s].
            errors: errors of the run.
            key: random key of the noise.
        """

    @abc.abstractmethod
    def velocity_error(self, errors: Any, known: ErrorEstimate | None) -> Velocity | None:
        """Return by how much the robot is wrong about its velocity in its own frame [m/s].

        Args:
            errors: errors of the run.
            known: what the robot knows of them.

        Returns:
            The error (2,), ahead and to the side; None if the robot measures its speed otherwise.
        """

    @abc.abstractmethod
    def covariance(self, increment: Pose, elapsed: Scalar) -> Matrix:
        """Return the covariance (3, 3) of a measured motion, in the frame of the robot.

        Args:
            increment: measured motion (dx, dy, dyaw) [m, m, rad].
            elapsed: time that it took [s].
        """

    @abc.abstractmethod
    def estimate(self) -> ErrorEstimate | None:
        """Return what is known of the errors at the start; None if nothing is estimated of them."""

    @abc.abstractmethod
    def predict(self, known: Reckoning, motion: Pose, elapsed: Scalar) -> Reckoning:
        """Return what is known after a motion.

        Args:
            known: what is known before it.
            motion: measured motion (dx, dy, dyaw) in the frame of the robot [m, m, rad].
            elapsed: time that it took [s].
        """
