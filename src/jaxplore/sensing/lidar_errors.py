"""What lidars get wrong beside the noise of their ranges: least range, missing and false returns,
and the floor that a tilted lidar sees."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, Key, Scalar
from jaxplore.sensing.beams import Scan

NEAR_FLOOR = 0.9
"""Share of the distance of the floor from which on a reading may be of the floor."""
STEEPEST = 0.5
"""Greatest tilt of a planar lidar [rad]."""
ERRORS = 1
"""Number that is folded into the key of a scan for its errors."""


class LidarErrors(eqx.Module):
    """Errors of a lidar; all are data, so other numbers do not compile again.

    A reading that is missing or too near is no measurement: its range is 0, and it changes no cell.
    A false return ends somewhere on the way of its beam. A tilted lidar also sees the level floor;
    the robot knows the tilt, and takes no reading from 90 % of the distance of the floor on.

    Args:
        least_range: range below which nothing is measured [m].
        missing: share of the beams without a measurement, such as on dark or shining surfaces.
        false_returns: share of the beams that end where nothing is, such as in dust.
        pitch: tilt of the lidar, forwards downwards [rad].
        roll: tilt of the lidar, to the right downwards [rad].

    Raises:
        ValueError: a negative range, a share outside [0, 1], a tilt of more than 0.5 rad.
    """

    least_range: Scalar
    missing: Scalar
    false_returns: Scalar
    pitch: Scalar
    roll: Scalar

    def __init__(
        self,
        least_range: ArrayLike = 0.0,
        missing: ArrayLike = 0.0,
        false_returns: ArrayLike = 0.0,
        pitch: ArrayLike = 0.0,
        roll: ArrayLike = 0.0,
    ) -> None:
        self.least_range = _checks.scalar("least_range", least_range, at_least=0.0)
        share: dict[str, Any] = {"at_least": 0.0, "at_most": 1.0}
        self.missing = _checks.scalar("missing", missing, **share)
        self.false_returns = _checks.scalar("false_returns", false_returns, **share)
        tilt: dict[str, Any] = {"at_least": -STEEPEST, "at_most": STEEPEST}
        self.pitch = _checks.scalar("pitch", pitch, **tilt)
        self.roll = _checks.scalar("roll", roll, **tilt)

    def apply(
        self, scan: Scan, angles: Float[Array, " B"], height: Scalar, max_range: float, key: Key
    ) -> Scan:
        """Return a scan with the errors.

        Args:
            scan: the scan without them.
            angles: (B,) directions of the beams relative to the heading [rad].
            height: height of the lidar above the floor [m].
            max_range: greatest range [m].
            key: random key of the scan.
        """
        keys = jax.random.split(jax.random.fold_in(key, ERRORS), 3)
        number = scan.ranges.shape
        drawn = [jax.random.uniform(each, number) for each in keys]
        is_false = drawn[0] < self.false_returns
        ranges = jnp.where(is_false, drawn[1] * scan.ranges, scan.ranges)
        floor = floor_distance(angles, height, self.pitch, self.roll)
        is_floor = floor < ranges
        ranges = jnp.where(is_floor, floor, ranges)
        is_return = scan.is_return | is_false | is_floor
        is_none = (drawn[2] < self.missing) | (is_return & (ranges < self.least_range))
        is_none |= ranges >= NEAR_FLOOR * floor
        return Scan(jnp.where(is_none, 0.0, ranges), is_return & ~is_none)


def floor_distance(angles: Any, height: Any, pitch: Any, roll: Any) -> Any:
    """Return the distance (B,) at which the beams of a tilted lidar meet a level floor [m].

    With the angle a of a beam from the heading, it falls by sin(pitch) cos(a) - cos(pitch)
    sin(roll) sin(a) per metre. Beams that do not fall never meet it. `height` is that of the lidar
    above the floor [m]. A positive pitch tilts the front down, a positive roll the right side
    [rad]. In NumPy or JAX, like the angles.
    """
    xp: Any = jnp if isinstance(angles, jax.Array) else np
    # The right is at negative angles.
    fall = xp.sin(pitch) * xp.cos(angles) - xp.cos(pitch) * xp.sin(roll) * xp.sin(angles)
    does_fall = fall > 1e-6
    return xp.where(does_fall, height / xp.where(does_fall, fall, 1.0), xp.inf)
