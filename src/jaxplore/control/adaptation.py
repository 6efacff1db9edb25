"""Noise that narrows where the good samples agree."""

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import Scalar
from jaxplore.control.parameterisations import Parameters, Samples, shifted


class CovarianceAdaptation(eqx.Module):
    """The noise's scale follows the spread of the weighted samples.

    For every parameter, with v its samples, c the nominal and sigma the given deviation,

        s^2 <- (1 - rate) s^2 + rate * sum_k w_k ((v_k - c) / sigma)^2,   floor <= s <= ceiling

    and the noise has the deviation `s sigma`. The spread is taken around the nominal, not around
    the new mean, so that it grows where the samples pull away (Stulp and Sigaud, "Path integral
    policy improvement with covariance matrix adaptation", ICML 2012). The floor keeps it from
    dying out. The correlation between controls stays as given.

    Args:
        rate: share of the new spread at each step.
        floor: least s.
        ceiling: greatest s.

    Raises:
        ValueError: a rate that is not within 0 to 1, a floor that is not positive, a ceiling below
            the floor.
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
        if not _checks.is_traced(floor, ceiling) and self.ceiling < self.floor:
            raise ValueError(f"ceiling is {ceiling!r}; accepted: at least the floor, {floor!r}")

    def adapted(self, scale: Parameters, weights: Float[Array, " K"], away: Samples) -> Parameters:
        """Return the scale (P, nu) after samples this far from the nominal, in deviations."""
        spread = jnp.einsum("k,puk->pu", weights, away * away)
        # Without a finite rollout all weights are 0, and nothing is known of the spread.
        rate = self.rate * jnp.sum(weights)
        square = (1.0 - rate) * scale * scale + self.rate * spread
        return jnp.clip(jnp.sqrt(square), self.floor, self.ceiling)

    def shifted(self, scale: Parameters, rows: Scalar) -> Parameters:
        """Return the scale moved on by so many rows; 1, as given, where it is new."""
        fresh = jnp.clip(jnp.ones(scale.shape[1]), self.floor, self.ceiling)
        return shifted(scale, rows, fresh)
