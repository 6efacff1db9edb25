"""Draw noise from Sobol and Halton points, which fill space more evenly than random draws."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore._types import Key
from jaxplore.control.noise import Noise, Shape
from jaxplore.control.parameterisations import Samples

BITS = 24
"""Number of binary digits of a point, as many as a float32 in [0, 1) has."""


class SobolNoise(Noise):
    """Normal quantiles of the first K points of a scrambled Sobol sequence in P x nu dimensions.

    Each step applies one random digital shift (XOR) to all points. Each point is then uniformly
    distributed, the points stay evenly spread, and steps differ. K should be a power of two. Only
    the shift needs random numbers, so this is faster than random draws.

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
        # SciPy orders the points by the Gray code of their index.
        index = index ^ (index >> 1)
        points = jax.random.bits(key, (dimensions, 1)) >> (32 - BITS)
        for digit in range(digits):
            chosen = ((index >> digit) & 1) * jnp.uint32(2**BITS - 1)
            points = points ^ (directions[:, digit, None] & chosen)
        return _normal(points).reshape(shape)

    def covariance(self, rows: int) -> None:
        """Return None: the rows are uncorrelated."""

    def check(self, shape: Shape) -> None:
        """Raise a `ValueError` for more dimensions than SciPy has direction numbers."""
        import scipy.stats  # slow to import, and few need it

        _check_dimensions(shape, scipy.stats.qmc.Sobol.MAXDIM)


class HaltonNoise(Noise):
    """Normal quantiles of the first K points of a scrambled Halton sequence in P x nu dimensions.

    Each step shifts all points by one random vector, modulo 1 (Cranley and Patterson, 1976). K is
    arbitrary. In many dimensions the points are less even than Sobol points: use them with a few
    knots.

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
    """Return the normal quantiles of integers below 2^BITS, taken at the middle of their cells."""
    uniform = (points.astype(jnp.float32) + 0.5) * (2.0 / 2**BITS) - 1.0
    # Above 2^23 a float32 cannot represent the added half: the last cell would round to 1, whose
    # quantile is infinite.
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

    Point i of the sequence is the XOR of the directions of the bits set in i's Gray code. So point
    2^d and point 2^d - 1 differ by direction d alone, from which it is read.
    """
    import scipy.stats  # slow to import, and few need it

    found = []
    for digit in range(digits):
        # The seed is fixed, so the directions are constants. Only the shift of a step is random.
        sequence = scipy.stats.qmc.Sobol(dimensions, scramble=True, rng=np.random.default_rng(0))
        if digit:
            sequence.fast_forward(2**digit - 1)
        before, after = _whole(sequence.random(2))
        found.append(before ^ after)
    return np.stack(found, axis=-1)


@functools.lru_cache(maxsize=8)
def _halton_points(dimensions: int, samples: int) -> np.ndarray:
    """Return the first points of the sequence (dimensions, samples) as uint32 of BITS bits."""
    import scipy.stats  # slow to import, and few need it

    # The seed is fixed, so the points are constants. Only the shift of a step is random.
    sequence = scipy.stats.qmc.Halton(dimensions, scramble=True, rng=np.random.default_rng(0))
    return np.ascontiguousarray(_whole(sequence.random(samples)).T)


def _whole(points: np.ndarray) -> np.ndarray:
    return np.asarray(np.minimum(points * 2**BITS, 2**BITS - 1), np.uint32)
