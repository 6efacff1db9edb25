"""Noise whose power falls with frequency."""

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import Key, Scalar
from jaxplore.control.noise import Noise, Shape, WhiteNoise
from jaxplore.control.parameterisations import Samples


class ColouredNoise(Noise):
    """Noise of power `1 / f^gamma` over the rows: 0 white, 1 pink, 2 red.

    Its autocovariance is that of a periodic sequence of 2 P rows with power `f^-gamma` at the
    frequencies `f = 1, 2, ..., P` and the power of the lowest one at 0, scaled to variance 1. Only
    P rows are drawn, through the Cholesky factor of their covariance, so that the last row does not
    know of the first one, as it does where P rows come out of a Fourier transform of P values.

    Source: Vlahov, Gibson, Fan, Spieler, Agha-mohammadi, Theodorou, "Low Frequency Sampling in
    Model Predictive Path Integral Control", RA-L 2024; Timmer and König, "On generating power law
    noise", A&A 1995.

    Args:
        exponent: gamma.
        noise: what is coloured.

    Raises:
        ValueError: an exponent that is not within 0 to 4.
    """

    exponent: Scalar
    noise: Noise

    def __init__(self, exponent: ArrayLike = 1.0, noise: Noise | None = None) -> None:
        self.exponent = _checks.scalar("exponent", exponent, at_least=0.0, at_most=4.0)
        self.noise = WhiteNoise() if noise is None else noise

    def draw(self, shape: Shape, *, key: Key) -> Samples:
        """Return noise of shape (P, nu, K)."""
        factor = jnp.linalg.cholesky(self.colour(shape[0]))
        return jnp.einsum("pq,quk->puk", factor, self.noise.draw(shape, key=key))

    def covariance(self, rows: int) -> Float[Array, "P P"]:
        """Return the covariance (P, P) of the rows."""
        colour, inner = self.colour(rows), self.noise.covariance(rows)
        if inner is None:
            return colour
        factor = jnp.linalg.cholesky(colour)
        covariance: Array = factor @ inner @ factor.T
        return covariance

    def colour(self, rows: int) -> Float[Array, "P P"]:
        """Return the covariance (P, P) that white noise gets, 1 on the diagonal."""
        frequency = jnp.maximum(jnp.arange(rows + 1, dtype=jnp.float32), 1.0)
        # Both ends of the spectrum stand for themselves, all between for themselves and their
        # mirror images.
        counts = jnp.full(rows + 1, 2.0).at[jnp.asarray([0, rows])].set(1.0)
        power = counts * frequency**-self.exponent
        turns = jnp.outer(jnp.arange(rows), jnp.arange(rows + 1)) % (2 * rows)
        phase = (jnp.pi / rows) * turns.astype(jnp.float32)
        autocovariance = jnp.cos(phase) @ (power / jnp.sum(power))
        lag = jnp.abs(jnp.arange(rows)[:, None] - jnp.arange(rows))
        # Steep spectra leave nothing at high frequencies; the factor needs more than the rounding,
        # which grows with the rows.
        return autocovariance[lag] + max(1e-5, 3e-7 * rows) * jnp.eye(rows)

    def check(self, shape: Shape) -> None:
        """Raise a `ValueError` if the white noise cannot be drawn."""
        self.noise.check(shape)
