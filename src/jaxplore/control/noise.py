"""Draw sampling noise of mean 0 and variance 1 for every parameter and sample."""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Key, Scalar
from jaxplore.control.parameterisations import Parameters, Samples

Shape = tuple[int, int, int]


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
