"""Adaptation of the noise to the spread of the weighted samples."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Scalar
from jaxplore.control.parameterisations import Parameters, Samples, shift_sequence


class CovarianceAdaptation(eqx.Module):
    """Scales the noise of each parameter to the spread of the weighted samples.

    With v the samples of a parameter, c the nominal and sigma the given standard deviation,

        s^2 <- (1 - rate) s^2 + rate * sum_k w_k ((v_k - c) / sigma)^2,   floor <= s <= ceiling

    and the noise has the standard deviation `s sigma`. The spread is taken around the nominal, not
    around the new mean, so it grows while the good samples lie to one side of the nominal. The
    floor keeps exploration from dying out. Correlations between controls do not change.

    Source: Stulp and Sigaud, "Path integral policy improvement with covariance matrix adaptation",
    ICML 2012.

    Args:
        rate: weight of the new spread in each step, 0 to 1.
        floor: lower bound of s.
        ceiling: upper bound of s.

    Raises:
        ValueError: a rate outside [0, 1], a floor that is not positive, a ceiling below the floor.
    """

    rate: Scalar
    floor: Scalar
    ceiling: Scalar

    def __init__(
        self, rate: ArrayLike = 0.2, floor: ArrayLike = 0.2, ceiling: ArrayLike = 1.0
    ) -> None:
        self.rate = _checks.scalar("rate", rate, at_least=0.0, at_most=1.0)
        self.floor = _checks.scalar("floor", floor, above=0.0)
        self.ceiling = _checks.scalar("ceiling", ceiling, above=0.0)
        if not _kinds.is_traced(floor, ceiling) and self.ceiling < self.floor:
            raise ValueError(f"ceiling is {ceiling!r}; accepted: at least the floor, {floor!r}")

    def adapt(self, scale: Parameters, weights: Float[Array, " K"], away: Samples) -> Parameters:
        """Compute the new scale (P, nu).

        Args:
            scale: (P, nu) scale before.
            weights: (K,) weights of the samples.
            away: (P, nu, K) samples minus nominal, in given standard deviations.
        """
        spread = jnp.einsum("k,puk->pu", weights, away * away)
        # If no rollout is finite, all weights are 0 and the scale must stay, not shrink.
        rate = self.rate * jnp.sum(weights)
        square = (1.0 - rate) * scale * scale + self.rate * spread
        return jnp.clip(jnp.sqrt(square), self.floor, self.ceiling)

    def shift(self, scale: Parameters, rows: Scalar) -> Parameters:
        """Move the scale on by a number of rows; new rows have the given spread, s = 1."""
        fresh = jnp.clip(jnp.ones(scale.shape[1]), self.floor, self.ceiling)
        return shift_sequence(scale, rows, fresh)
