"""The odometry of a log: its motions, made-up drift on them, and the size of its errors."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from numpy.typing import NDArray

from jaxplore._types import Key
from jaxplore.geometry.motion import motions_between, steps_along
from jaxplore.localisation.odometry import Odometry
from jaxplore.sensing.laser_log import LaserLog

LEAST = (0.01, 0.003, 0.01, 0.005)
"""Least errors that are fitted: position and yaw after a metre, yaw and position after a radian."""
_PASSES = 20
"""Number of times that the weights of a fit follow from the fit before."""
_Floats = NDArray[np.float64]


def default_drift() -> Odometry:
    """Return an odometry that is wrong by 2 % of the distance and by a degree in each metre."""
    return Odometry(distance_noise=0.02, turn_per_distance=math.radians(1.0))


def wide_odometry() -> Odometry:
    """Return an odometry with errors as large as any robot's whose log is mapped."""
    return Odometry(
        distance_noise=0.08, turn_per_distance=0.05, turn_noise=0.15, slip_in_turns=0.08
    )


def measure_motions(
    log: LaserLog, odometry: Odometry, key: Key
) -> tuple[Float[Array, "N 3"], Float[Array, " N"]]:
    """Return the motions between the poses of a log as an odometry measures them, and their times.

    The poses are taken for the truth. Each motion (N, 3) leads to a scan from the one before it, in
    the frame of that one [m, m, rad]; the first is zero. Each time (N,) is how long a motion took
    [s].
    """
    true = steps_along(log.poses)
    taken = jnp.asarray(np.diff(log.times, prepend=log.times[:1]), jnp.float32)
    of_run, of_noise = jax.random.split(key)
    keys = jax.random.split(of_noise, len(true))
    bias = odometry.draw(of_run)
    measured, _ = jax.vmap(odometry.measure, (0, 0, None, 0))(
        jnp.asarray(true, jnp.float32), taken, bias, keys
    )
    return measured.at[0].set(0.0), taken


def fit_odometry(measured: _Floats, matched: _Floats) -> Odometry:
    """Return the errors of an odometry by what scans say of the motions.

    With e the difference of a measured motion from that between the matched poses, which has the
    length s and the turn t, the variances

        E e_x^2 = E e_y^2 = a s + b |t|,   E e_yaw^2 = c s + d |t|

    are fitted by least squares that are weighted by the inverse of the variance so far, none of the
    coefficients negative. Where scans measure nothing, as along a corridor, matched poses follow
    the odometry, and the errors of others count less. Each of the N measured motions is in the
    frame of its beginning. There are N + 1 matched poses.
    """
    moved = motions_between(matched[:-1], matched[1:])
    error = measured - moved
    error[:, 2] -= math.tau * np.round(error[:, 2] / math.tau)
    # A turn that was measured small by its error would say that small turns err much.
    sizes = np.stack([np.hypot(*moved[:, :2].T), np.abs(moved[:, 2])], axis=1)
    by_metre, slip = _fit(sizes, 0.5 * (error[:, :2] ** 2).sum(axis=1))
    turn_by_metre, turn_noise = _fit(sizes, error[:, 2] ** 2)
    found = (by_metre, turn_by_metre, turn_noise, slip)
    return Odometry(*(max(least, each) for least, each in zip(LEAST, found, strict=True)))


def _fit(sizes: _Floats, squares: _Floats) -> tuple[float, float]:
    """Return the standard deviations after a metre and after a radian."""
    from scipy.optimize import nnls  # slow to import, and few need it

    weights = np.ones(len(squares))
    found = np.zeros(2)
    for _ in range(_PASSES):
        found, _ = nnls(sizes * weights[:, None], squares * weights)
        weights = 1.0 / np.maximum(sizes @ found, 1e-8)
    return math.sqrt(found[0]), math.sqrt(found[1])
