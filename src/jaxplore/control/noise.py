"""Where randomness comes from: draws of mean 0 and variance 1 for every parameter and sample."""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.scipy.linalg
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import Key, Scalar
from jaxplore.control.parameterisations import Parameters, Samples

Shape = tuple[int, int, int]


class Noise(eqx.Module):
    """A source of noise of mean 0 and variance 1, the same for every control.

    A proposal scales it. Sources nest: `AntitheticNoise(ColouredNoise(1.0))`.
    """

    @abc.abstractmethod
    def draw(self, shape: Shape, *, key: Key) -> Samples:
        """Return noise of shape (P, nu, K)."""

    @abc.abstractmethod
    def covariance(self, rows: int) -> Float[Array, "P P"] | None:
        """Return the covariance (P, P) over the rows, None if it is the unit matrix."""

    def precision(self, sequence: Parameters) -> Parameters:
        """Return `C^-1 sequence` (P, nu), C the covariance."""
        covariance = self.covariance(sequence.shape[0])
        if covariance is None:
            return sequence
        factor = jnp.linalg.cholesky(covariance)
        solved: Array = jax.scipy.linalg.cho_solve((factor, True), sequence)
        return solved

    def check(self, shape: Shape) -> None:
        """Raise a `ValueError` if noise of this shape cannot be drawn; all can, by default."""


LARGE = 2**20
"""Numbers beyond which noise is drawn row by row: what is written at once should fit a cache."""


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
    """Pairs of opposite draws: the second half of the samples mirrors the first.

    The mean of the samples is 0 exactly (K even), and half as much is drawn.

    Args:
        noise: what is mirrored.
    """

    noise: Noise

    def __init__(self, noise: Noise | None = None) -> None:
        self.noise = WhiteNoise() if noise is None else noise

    def draw(self, shape: Shape, *, key: Key) -> Samples:
        """Return noise of shape (P, nu, K)."""
        rows, size, samples = shape
        half = self.noise.draw((rows, size, (samples + 1) // 2), key=key)
        return jnp.concatenate([half, -half[:, :, : samples // 2]], axis=-1)

    def covariance(self, rows: int) -> Float[Array, "P P"] | None:
        """Return that of the mirrored noise."""
        return self.noise.covariance(rows)

    def check(self, shape: Shape) -> None:
        """Raise a `ValueError` if half of it cannot be drawn."""
        rows, size, samples = shape
        self.noise.check((rows, size, (samples + 1) // 2))


class LogNormalNoise(Noise):
    """Normal draws times log-normal ones: many small perturbations and some large ones.

        eps = z exp(s y - s^2),   z, y ~ N(0, 1) independent

    has variance 1 and kurtosis `3 exp(4 s^2)`. The larger reach finds ways around obstacles that
    normal noise of the same variance does not.

    Source: Mohamed, Yin, Liu, "Autonomous Navigation of AGVs in Unknown Cluttered Environments:
    log-MPPI Control Strategy", RA-L 2022, eq. 8.

    Args:
        spread: s, standard deviation of the logarithm.
        noise: z.

    Raises:
        ValueError: a negative spread.
    """

    spread: Scalar
    noise: Noise

    def __init__(self, spread: ArrayLike = 0.5, noise: Noise | None = None) -> None:
        self.spread = _checks.scalar("spread", spread, at_least=0.0)
        self.noise = WhiteNoise() if noise is None else noise

    def draw(self, shape: Shape, *, key: Key) -> Samples:
        """Return noise of shape (P, nu, K)."""
        normal_key, log_key = jax.random.split(key)
        scale = jnp.exp(self.spread * jax.random.normal(log_key, shape) - self.spread**2)
        return self.noise.draw(shape, key=normal_key) * scale

    def covariance(self, rows: int) -> Float[Array, "P P"] | None:
        """Return that of the normal factor; between rows `exp(-s^2)` of it is left."""
        inner = self.noise.covariance(rows)
        if inner is None:
            return None
        kept = jnp.exp(-self.spread * self.spread)
        return kept * inner + (1.0 - kept) * jnp.diag(jnp.diagonal(inner))

    def check(self, shape: Shape) -> None:
        """Raise a `ValueError` if the normal factor cannot be drawn."""
        self.noise.check(shape)


class NoiseBank(Noise):
    """Noise that is drawn once and used again and again.

    Each step takes one of `num_draws` stored draws at random and turns the sign of each control's
    noise at random. Within a step the samples are those of `noise`; from step to step they recur.
    Drawing is the larger part of a cheap rollout's time: this replaces it by a copy.

    Args:
        shape: (P, nu, K) parameters, controls, samples.
        key: randomness of the store.
        num_draws: how many are stored; 4 bytes x P x nu x K each.
        noise: what is stored; must be symmetric.

    Raises:
        ValueError: a size < 1, or, from `check`, another shape.
    """

    stored: Float[Array, "D P nu K"]
    noise: Noise

    def __init__(
        self, shape: Shape, *, key: Key, num_draws: int = 16, noise: Noise | None = None
    ) -> None:
        for name, size in zip(("P", "nu", "K"), shape, strict=True):
            _checks.positive_int(f"{name} of shape", size)
        self.noise = WhiteNoise() if noise is None else noise
        keys = jax.random.split(key, _checks.positive_int("num_draws", num_draws))
        self.stored = jnp.stack([self.noise.draw(shape, key=one) for one in keys])

    def draw(self, shape: Shape, *, key: Key) -> Samples:
        """Return stored noise (P, nu, K)."""
        self.check(shape)
        which_key, sign_key = jax.random.split(key)
        which = jax.random.randint(which_key, (), 0, self.stored.shape[0])
        signs = jax.random.rademacher(sign_key, (shape[1], 1), jnp.float32)
        return self.stored[which] * signs

    def covariance(self, rows: int) -> Float[Array, "P P"] | None:
        """Return that of the stored noise."""
        return self.noise.covariance(rows)

    def check(self, shape: Shape) -> None:
        """Raise a `ValueError` if the store has another shape."""
        if self.stored.shape[1:] != shape:
            raise ValueError(
                f"a NoiseBank holds draws of shape {self.stored.shape[1:]}; accepted: {shape}, "
                "parameters x controls x samples of the controller"
            )
