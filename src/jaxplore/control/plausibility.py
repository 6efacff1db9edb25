"""Decide whether poses and scans can be true: a pose that stands still or jumps, a scan that does
not fit the map.

The functions are pure. The closed loop compiles them. The pilot of a robot calls those of poses on
the host, with NumPy in double precision, because its positions may be far from the origin.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore._types import ArrayLike, Pose, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.sensing.beams import Beams, Scan

MIN_SPEED, MIN_TURN_RATE = 0.1, 0.2
"""Speed [m/s] and turn rate [rad/s] above which a pose must change."""
MAX_JUMP, MAX_TURN = 0.5, 0.8
"""Greatest distance [m] and angle [rad] of a pose from the expected one."""
MAX_AGE = 0.3
"""Greatest age of a pose or a scan by which a robot drives [s]."""
MAX_MISFIT = 0.5
"""Share of the returns of a scan that may contradict the map."""
MIN_RETURNS = 8
"""Number of returns below which a scan says nothing about the pose."""
MISFIT_DISTANCE = 0.3
"""Distance from all cells that are not known to be free beyond which a return contradicts the map
[m]."""
JUMP_SECONDS = 1.0
"""Time of poses that fit each other after which a robot goes on after a jump [s]."""
RETRY_SECONDS = 2.0
"""Time after which a robot at rest tries to move again though its pose did not change, or takes the
world to have changed where scans do not fit the map [s]."""


type Triple = Float[jax.Array, "3"] | Float[np.ndarray, "3"]
"""A pose (x, y, yaw) or a velocity, on the device or on the host."""


def is_moving(twist: Triple, share: float = 1.0) -> Any:
    """Check whether a velocity (vx, vy, omega) must change the pose [m/s, m/s, rad/s].

    It must if it exceeds `share` times `MIN_SPEED`, or its turn rate `share` times `MIN_TURN_RATE`.
    """
    xp = _module(twist)
    is_fast = xp.hypot(twist[0], twist[1]) > share * MIN_SPEED
    return is_fast | (xp.abs(twist[2]) > share * MIN_TURN_RATE)


def pose_error(expected: Triple, pose: Triple) -> tuple[Any, Any]:
    """Return the distance [m] and the angle [rad] between two poses (x, y, yaw)."""
    xp = _module(expected, pose)
    turn = pose[2] - expected[2]
    wrapped = xp.arctan2(xp.sin(turn), xp.cos(turn))
    return xp.hypot(pose[0] - expected[0], pose[1] - expected[1]), xp.abs(wrapped)


def is_jump(
    expected: Triple, pose: Triple, max_jump: ArrayLike = MAX_JUMP, max_turn: ArrayLike = MAX_TURN
) -> Any:
    """Check whether a pose is too far from the expected one; true where either is not finite."""
    distance, turn = pose_error(expected, pose)
    # NaN fails both comparisons.
    return ~((distance <= max_jump) & (turn <= max_turn))


def scan_misfit(belief: Belief, sensor: Beams, scan: Scan, pose: Pose) -> Scalar:
    """Return the share of the returns of a scan that contradict the map, as it was before the scan.

    A return does if it is farther than `MISFIT_DISTANCE` from every cell that is occupied or
    unknown. So a scan of unknown space contradicts nothing. The share is 0 with fewer than
    `MIN_RETURNS` returns, at a pose of the sensor that is not finite, and on a known ground, whose
    hills return beams.
    """
    if belief.ground is not None:
        return jnp.zeros(())
    angles = pose[2] + jnp.asarray(sensor.beam_angles)
    ends = pose[:2] + scan.ranges[:, None] * jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1)
    return share_of_misfits(belief.clearance, ends, scan.is_return)


def share_of_misfits(
    clearance: Callable[[Array], Scalar],
    ends: Float[Array, "P D"],
    is_return: Bool[Array, " P"],
) -> Scalar:
    """Return the share of returns (P,) whose ends contradict a map, see `scan_misfit`.

    `clearance` is the distance to what the map does not know to be free, in the plane or in a
    volume [m].
    """
    # At a pose that is not finite, the ends are off the map, where the clearance is 0.
    is_contrary = is_return & (jax.vmap(clearance)(ends) > MISFIT_DISTANCE)
    number = jnp.sum(is_return, dtype=jnp.float32)
    share = jnp.sum(is_contrary, dtype=jnp.float32) / jnp.maximum(number, 1.0)
    return jnp.where((number >= MIN_RETURNS) & jnp.isfinite(share), share, 0.0)


def _module(*values: Triple) -> Any:
    """Return the array module of the values: `jax.numpy` for arrays on the device, else `numpy`."""
    return jnp if any(isinstance(value, jax.Array) for value in values) else np
