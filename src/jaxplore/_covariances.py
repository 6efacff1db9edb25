"""Check covariance matrices where objects are built, as `_checks` checks numbers and arrays."""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from jaxplore._checks import array, one_each
from jaxplore._kinds import is_traced
from jaxplore._types import Rows, Vector


def covariances(
    std: Vector | None, covariance: Rows | None, number: int, *, may_be_zero: bool = False
) -> Float[Array, "N 2 2"]:
    """Return the covariance of each of N positions, (N, 2, 2) [m^2].

    Exactly one of `std` and `covariance` must be given: a standard deviation along both axes, (N,)
    or one number [m], or matrices (N, 2, 2), or one (2, 2) for all positions [m^2]. With
    `may_be_zero` a position may be known exactly.
    """
    if (std is None) == (covariance is None):
        raise ValueError(f"std is {std!r} beside a covariance; accepted: one of them")
    if covariance is None:
        bound = {"at_least": 0.0} if may_be_zero else {"above": 0.0}
        return _isotropic(one_each("std", std, number, **bound))
    given = array("covariance", covariance, (number, 2, 2), (2, 2), may_be_empty=number == 0)
    _check_covariance(given, may_be_zero)
    return jnp.broadcast_to(given, (number, 2, 2))


def covariance(name: str, value: Rows, size: int) -> Float[Array, "n n"]:
    """Return `value` as a covariance matrix (size, size), which may be singular."""
    given = array(name, value, (size, size))
    _check_covariance(given, may_be_zero=True)
    return given


def _isotropic(std: Float[Array, " N"]) -> Float[Array, "N 2 2"]:
    """Return isotropic covariances (N, 2, 2), `std^2 I`, for standard deviations (N,)."""
    return (std * std)[:, None, None] * jnp.eye(2)


def _check_covariance(covariance: Array, may_be_zero: bool) -> None:
    if is_traced(covariance):
        return
    given = np.asarray(covariance, np.float64)
    # Tolerances are relative to the largest entry: float32 input is symmetric only up to rounding.
    size = np.abs(given).max(axis=(-2, -1), keepdims=True)
    is_symmetric = (np.abs(given - np.swapaxes(given, -1, -2)) <= 1e-5 * size).all()
    lowest = np.linalg.eigvalsh(given)
    is_bad = lowest < -1e-6 * size[..., 0] if may_be_zero else lowest <= 0.0
    if not is_symmetric or is_bad.any():
        kind = "positive semidefinite" if may_be_zero else "positive definite"
        raise ValueError(f"covariance is {given.tolist()}; accepted: symmetric and {kind}")
