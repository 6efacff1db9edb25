"""The odometry of a robot that does not know its pose, with the errors of a run."""

from typing import Any, NamedTuple

import jax
from jax import Array

from jaxplore._types import Count, Key, Pose, Scalar
from jaxplore.geometry.motion import between
from jaxplore.localisation.odometry_model import OdometryModel
from jaxplore.localisation.volume_odometry import VolumeOdometry

_ODOMETRY = 2**31 + 4
"""What is folded into the key of a run for its odometry; no step has such a number."""


class Odometer(NamedTuple):
    """The errors of the odometry in a run, and the random key of its noise."""

    errors: Any
    key: Key

    @classmethod
    def at_start(cls, odometry: OdometryModel | VolumeOdometry, key: Key | None) -> "Odometer":
        """Draw the errors of a run; without its key, the odometry has no constant errors."""
        drawn = None if key is None else jax.random.fold_in(key, _ODOMETRY)
        own = jax.random.key(0) if drawn is None else jax.random.fold_in(drawn, 1)
        return cls(odometry.draw(drawn), own)

    def measure(
        self, odometry: OdometryModel, before: Pose, after: Pose, step: Count, period: Scalar
    ) -> tuple[Pose, "Odometer"]:
        """Measure the motion between true poses of a period, in the robot's frame [m, m, rad]."""
        return self.measure_motion(odometry, between(before, after), step, period)

    def measure_motion(
        self, odometry: Any, motion: Array, step: Count, period: Scalar
    ) -> tuple[Array, "Odometer"]:
        """Measure a true motion of a period, in the robot's frame."""
        key = jax.random.fold_in(self.key, step)
        measured, errors = odometry.measure(motion, period, self.errors, key)
        return measured, self._replace(errors=errors)


def estimator_key(key: Key | None) -> Key | None:
    """Return the random key of a robot's estimator in a run; None without a key of the run."""
    return None if key is None else jax.random.fold_in(jax.random.fold_in(key, _ODOMETRY), 2)
