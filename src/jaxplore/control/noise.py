"""Noise for sampling: white, coloured, of a Sobol sequence, and from a bank of numbers."""

import abc
import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Key, Scalar
from jaxplore.control.parameterisations import Parameters, Samples

Shape = tuple[int, int, int]
BITS = 24
"""Number of binary digits of a point, as many as a float32 in [0, 1) has."""


class Noise(eqx.Module):
    """Distribution of noise with mean 0 and variance 1, equal for all controls; abstract.

    A proposal scales the noise. Distributions nest: `AntitheticNoise(ColouredNoise(1.0))`.
    """

    @abc.abstractmethod
    def draw(self, shape: Shape, *, key: Key) -> Samples:
        """Draw noise of shape (P, nu, K).

        Args:
            shape: numbers of parameters, controls and samples.
            key: random key.
        """

    @abc.abstractmethod
    def covariance(self, rows: int) -> Float[Array, "P P"] | None:
        """Return the covariance (P, P) over the parameters; None stands for the identity."""

    def precision(self, sequence: Parameters) -> Parameters:
        """Return `C^-1 sequence` (P, nu) with the covariance C."""
        covariance = self.covariance(sequence.shape[0])
        if covariance is None:
            return sequence
        # Solve with the Cholesky factor, which is more accurate than inverting the covariance.
        factor = jnp.linalg.cholesky(covariance)
        solved: Array = jax.scipy.linalg.cho_solve((factor, True), sequence)
        return solved

    def check(self, shape: Shape) -> None:
        """Raise a `ValueError` if noise of this shape cannot be drawn; by default any can."""


LEAST_STORED = 2**16
"""Numbers of a bank for up to 4096 samples."""
MOST_STORED = 2**28
"""Most numbers of a bank: 1 GiB."""
LARGE = 2**20
"""Number of values above which noise is drawn row by row, so that a row fits the CPU's cache."""


class WhiteNoise(Noise):
    """Independent standard normal draws."""

    def draw(self, shape: Shape, *, key: Key) -> Samples:
        """Return noise of shape (P, nu, K)."""
        if math.prod(shape) <= LARGE:
            return jax.random.normal(key, shape)
        rows: Samples = jax.lax.map(
            lambda row: jax.random.normal(row, shape[1:]), jax.random.split(key, shape[0])
        )
        return rows

    def covariance(self, rows: int) -> None:
        """Return None: all draws are independent."""


class AntitheticNoise(Noise):
    """Pairs of opposite draws: the second half of the samples mirrors the first half.

    For an even K the mean of the samples is exactly 0. Only half as many values are drawn.

    Args:
        noise: noise that is mirrored; `WhiteNoise()` by default.
    """

    noise: Noise

    @_kinds.check_arguments
    def __init__(self, noise: Noise | None = None) -> None:
        self.noise = WhiteNoise() if noise is None else noise

    def draw(self, shape: Shape, *, key: Key) -> Samples:
        """Return noise of shape (P, nu, K)."""
        rows, size, samples = shape
        half = self.noise.draw((rows, size, (samples + 1) // 2), key=key)
        return jnp.concatenate([half, -half[:, :, : samples // 2]], axis=-1)

    def covariance(self, rows: int) -> Float[Array, "P P"] | None:
        """Return the covariance of the mirrored noise."""
        return self.noise.covariance(rows)

    def check(self, shape: Shape) -> None:
        """Raise a `ValueError` if half of the samples cannot be drawn."""
        rows, size, samples = shape
        self.noise.check((rows, size, (samples + 1) // 2))


class LogNormalNoise(Noise):
    """Products of normal and log-normal draws: many small and a few large perturbations.

        eps = z exp(s y - s^2),   z, y ~ N(0, 1) independent

    has variance 1 and kurtosis `3 exp(4 s^2)`. The heavy tails find ways around obstacles that
    normal noise of the same variance misses.

    Source: Mohamed, Yin, Liu, "Autonomous Navigation of AGVs in Unknown Cluttered Environments:
    log-MPPI Control Strategy", RA-L 2022, eq. 8.

    Args:
        spread: standard deviation s of the logarithm.
        noise: distribution of z; `WhiteNoise()` by default.

    Raises:
        ValueError: a negative spread.
    """

    spread: Scalar
    noise: Noise

    @_kinds.check_arguments
    def __init__(self, spread: ArrayLike = 0.5, noise: Noise | None = None) -> None:
        self.spread = _checks.scalar("spread", spread, at_least=0.0)
        self.noise = WhiteNoise() if noise is None else noise

    def draw(self, shape: Shape, *, key: Key) -> Samples:
        """Return noise of shape (P, nu, K)."""
        # E[exp(s y - s^2)^2] = 1, so the product with z keeps variance 1.
        normal_key, log_key = jax.random.split(key)
        scale = jnp.exp(self.spread * jax.random.normal(log_key, shape) - self.spread**2)
        return self.noise.draw(shape, key=normal_key) * scale

    def covariance(self, rows: int) -> Float[Array, "P P"] | None:
        """Return the covariance of z, with the entries off the diagonal scaled by `exp(-s^2)`."""
        inner = self.noise.covariance(rows)
        if inner is None:
            return None
        # The factors of two rows are independent, so their product has the mean exp(-s^2 / 2)^2.
        kept = jnp.exp(-self.spread * self.spread)
        return kept * inner + (1.0 - kept) * jnp.diag(jnp.diagonal(inner))

    def check(self, shape: Shape) -> None:
        """Raise a `ValueError` if the normal factor cannot be drawn."""
        self.noise.check(shape)


class NoiseBank(Noise):
    """A ring of standard normal numbers, drawn once, from which each step copies.

        eps[p, u, k] = s[p, u] ring[(o[p, u] + k) mod size]

    The offset `o` and the sign `s` of each parameter and control are drawn anew in every step. So
    the rows of a step come from other places of the ring each time, and what a sample is in one
    row has nothing to do with what it is in another. With cheap models, drawing noise takes more
    time than the rollouts; the bank replaces it by a copy. Commands are as good as with new
    numbers: whole draws that recur would favour some plans for ever.

    Structured noise is made of it: `ColouredNoise(1.0, NoiseBank(key=key))`.

    Args:
        size: numbers in the ring; each takes 4 bytes. Sixteen times the samples are enough.
        key: random key of the numbers.

    Raises:
        ValueError: a size < 1; from `check`, more rows or samples than numbers.
    """

    ring: Float[Array, " N"]

    def __init__(self, size: int = LEAST_STORED, *, key: Key) -> None:
        _kinds.key("key", key)
        count = _checks.positive_int("size", size, at_most=MOST_STORED)
        numbers = jax.random.normal(key, (count,))
        # The variance is exactly 1; the random signs see to the mean.
        self.ring = numbers / jnp.sqrt(jnp.mean(numbers * numbers))

    def draw(self, shape: Shape, *, key: Key) -> Samples:
        """Return noise of shape (P, nu, K)."""
        self.check(shape)
        rows, size, samples = shape
        place_key, order_key, sign_key = jax.random.split(key, 3)
        # A stretch of the ring for each row, in random order, so that no two rows are the same.
        stretch = self.ring.size // (rows * size)
        order = jax.random.permutation(order_key, rows * size)
        offsets = order * stretch + jax.random.randint(place_key, (rows * size,), 0, stretch)
        around = jnp.concatenate([self.ring, self.ring[:samples]])
        drawn = jax.vmap(lambda at: jax.lax.dynamic_slice(around, (at,), (samples,)))(offsets)
        signs = jax.random.rademacher(sign_key, (rows, size, 1), jnp.float32)
        return drawn.reshape(shape) * signs

    def covariance(self, rows: int) -> None:
        """Return None: all numbers are independent."""

    def check(self, shape: Shape) -> None:
        """Raise a `ValueError` if the ring is too small."""
        rows, size, samples = shape
        needed = max(rows * size, samples)
        if self.ring.size < needed:
            raise ValueError(
                f"a NoiseBank holds {self.ring.size} numbers; accepted: at least {needed}, "
                f"for {rows} x {size} parameters and controls and {samples} samples"
            )


class ColouredNoise(Noise):
    """Noise with power `1 / f^gamma` over time: gamma 0 is white, 1 pink, 2 red.

    The autocovariance is that of a periodic sequence of 2 P values with power `f^-gamma` at the
    frequencies `f = 1, 2, ..., P` and the power of f = 1 at 0, scaled to variance 1. P values are
    drawn from it with the Cholesky factor of their covariance. So the last value is not correlated
    with the first, as it would be in P values from a Fourier transform of length P.

    Source: Vlahov, Gibson, Fan, Spieler, Agha-mohammadi, Theodorou, "Low Frequency Sampling in
    Model Predictive Path Integral Control", RA-L 2024; Timmer and König, "On generating power law
    noise", A&A 1995.

    Args:
        exponent: exponent gamma, in [0, 4].
        noise: noise that is coloured; `WhiteNoise()` by default.

    Raises:
        ValueError: an exponent that is not within 0 to 4.
    """

    exponent: Scalar
    noise: Noise

    @_kinds.check_arguments
    def __init__(self, exponent: ArrayLike = 1.0, noise: Noise | None = None) -> None:
        self.exponent = _checks.scalar("exponent", exponent, at_least=0.0, at_most=4.0)
        self.noise = WhiteNoise() if noise is None else noise

    def draw(self, shape: Shape, *, key: Key) -> Samples:
        """Return noise of shape (P, nu, K)."""
        factor = jnp.linalg.cholesky(self.colour(shape[0]))
        return jnp.einsum("pq,quk->puk", factor, self.noise.draw(shape, key=key))

    def covariance(self, rows: int) -> Float[Array, "P P"]:
        """Return the covariance (P, P) over the parameters."""
        colour, inner = self.colour(rows), self.noise.covariance(rows)
        if inner is None:
            return colour
        factor = jnp.linalg.cholesky(colour)
        covariance: Array = factor @ inner @ factor.T
        return covariance

    def colour(self, rows: int) -> Float[Array, "P P"]:
        """Return the covariance (P, P) of coloured white noise, with 1 on the diagonal."""
        # The autocovariance is the inverse Fourier transform of the power spectrum.
        frequency = jnp.maximum(jnp.arange(rows + 1, dtype=jnp.float32), 1.0)
        # A real sequence has a symmetric spectrum: all frequencies but the two ends count twice.
        counts = jnp.full(rows + 1, 2.0).at[jnp.asarray([0, rows])].set(1.0)
        power = counts * frequency**-self.exponent
        # Whole turns are removed in integers: the cosine of a large angle in float32 loses digits.
        turns = jnp.outer(jnp.arange(rows), jnp.arange(rows + 1)) % (2 * rows)
        phase = (jnp.pi / rows) * turns.astype(jnp.float32)
        autocovariance = jnp.cos(phase) @ (power / jnp.sum(power))
        lag = jnp.abs(jnp.arange(rows)[:, None] - jnp.arange(rows))
        # A steep spectrum has almost no power at high frequencies. The Cholesky factor needs more
        # than the rounding error, which grows with the number of rows.
        return autocovariance[lag] + max(1e-5, 3e-7 * rows) * jnp.eye(rows)

    def check(self, shape: Shape) -> None:
        """Raise a `ValueError` if the white noise cannot be drawn."""
        self.noise.check(shape)


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
