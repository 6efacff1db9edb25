"""Noise that fills space more evenly than random draws: Sobol and Halton points."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Array, Float

from jaxplore._types import Key
from jaxplore.control.noise import Noise, Shape
from jaxplore.control.parameterisations import Samples

BITS = 24
"""Binary digits of a point: those of a float32 between 0 and 1."""


class SobolNoise(Noise):
    """Normal quantiles of the first K points of a scrambled Sobol sequence in P x nu dimensions.

    Each step shifts all points by one random digital shift (XOR): every point is uniform, the
    points stay as even as they were, and steps differ. K should be a power of two. It needs random
    numbers for a shift only, so it is faster than random draws.

    Source: Joe and Kuo, "Constructing Sobol sequences with better two-dimensional projections",
    SISC 2008 (directions from SciPy); Matousek, "On the L2-discrepancy for anchored boxes", 1998
    (scrambling).
    """

    def draw(self, shape: Shape, *, key: Key) -> Samples:
        """Return noise of shape (P, nu, K)."""
        rows, size, samples = shape
        dimensions = rows * size
        digits = max(1, (samples - 1).bit_length())
        directions = jnp.asarray(_sobol_directions(dimensions, digits))
        index = jnp.arange(samples, dtype=jnp.uint32)
        # The Gray code of the index, as SciPy orders the points.
        index = index ^ (index >> 1)
        points = jax.random.bits(key, (dimensions, 1)) >> (32 - BITS)
        for digit in range(digits):
            chosen = ((index >> digit) & 1) * jnp.uint32(2**BITS - 1)
            points = points ^ (directions[:, digit, None] & chosen)
        return _normal(points).reshape(shape)

    def covariance(self, rows: int) -> None:
        """Return None: the rows are uncorrelated."""

    def check(self, shape: Shape) -> None:
        """Raise a `ValueError` for more dimensions than there are directions."""
        _check_dimensions(shape, scipy.stats.qmc.Sobol.MAXDIM)


class HaltonNoise(Noise):
    """Normal quantiles of the first K points of a scrambled Halton sequence in P x nu dimensions.

    Each step shifts all points by one random vector, modulo 1 (Cranley and Patterson, 1976). Any K
    does. In many dimensions its projections are worse than those of Sobol points: use it with a
    few knots.

    Source: Owen, "A randomized Halton algorithm in R", 2017 (points from SciPy).
    """

    def draw(self, shape: Shape, *, key: Key) -> Samples:
        """Return noise of shape (P, nu, K)."""
        rows, size, samples = shape
        points = jnp.asarray(_halton_points(rows * size, samples))
        shift = jax.random.bits(key, (rows * size, 1)) >> (32 - BITS)
        return _normal((points + shift) & jnp.uint32(2**BITS - 1)).reshape(shape)

    def covariance(self, rows: int) -> None:
        """Return None: the rows are uncorrelated."""


def _normal(points: Array) -> Float[Array, "D K"]:
    """Return normal quantiles of whole numbers below 2^BITS, each for the middle of its cell."""
    uniform = (points.astype(jnp.float32) + 0.5) * (2.0 / 2**BITS) - 1.0
    # Beyond 2^24 a float32 has no halves: the last cell would round to 1, which has no quantile.
    largest = 1.0 - 2.0**-BITS
    return jnp.sqrt(2.0) * jax.lax.erf_inv(jnp.clip(uniform, -largest, largest))


def _check_dimensions(shape: Shape, limit: int) -> None:
    if shape[0] * shape[1] > limit:
        raise ValueError(
            f"parameters x controls is {shape[0]} x {shape[1]}; accepted: at most {limit} numbers "
            "for points of a Sobol sequence"
        )


@functools.lru_cache(maxsize=8)
def _sobol_directions(dimensions: int, digits: int) -> np.ndarray:
    """Return the direction numbers (dimensions, digits) as uint32 of BITS bits.

    Point i of the sequence is the XOR of the directions at the ones of i's Gray code, so point 2^d
    differs from point 2^d - 1 by direction d alone.
    """
    found = []
    for digit in range(digits):
        sequence = scipy.stats.qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(0))
        if digit:
            sequence.fast_forward(2**digit - 1)
        before, after = _whole(sequence.random(2))
        found.append(before ^ after)
    return np.stack(found, axis=-1)


@functools.lru_cache(maxsize=8)
def _halton_points(dimensions: int, samples: int) -> np.ndarray:
    """Return the first points of the sequence (dimensions, samples) as uint32 of BITS bits."""
    sequence = scipy.stats.qmc.Halton(dimensions, scramble=True, rng=np.random.default_rng(0))
    return np.ascontiguousarray(_whole(sequence.random(samples)).T)


def _whole(points: np.ndarray) -> np.ndarray:
    return np.asarray(np.minimum(points * 2**BITS, 2**BITS - 1), np.uint32)
