"""Draw coloured noise, whose power falls with frequency."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Key, Scalar
from jaxplore.control.noise import Noise, Shape, WhiteNoise
from jaxplore.control.parameterisations import Samples


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
