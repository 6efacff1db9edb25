"""Fusions that mix plans by their costs or their uncertainty, or take one of them."""

from typing import Any

import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import Scalar
from jaxplore.planning.portfolio.fusion import (
    Candidates,
    Fused,
    Fusion,
    Situation,
    cheapest,
    mixture,
    one_of,
)


class WeightedVote(Fusion):
    """The mean of the plans, weighted by `softmax(-cost / temperature)`.

    Costs are those of the common objective, so they can be compared, whatever each member itself
    minimises. A plan whose cost is not finite has no vote.

    Args:
        temperature: in units of cost; small for the best plan alone, large for the average.

    Raises:
        ValueError: a temperature that is not positive.
    """

    temperature: Scalar

    def __init__(self, temperature: ArrayLike = 0.1) -> None:
        self.temperature = _checks.scalar("temperature", temperature, above=0.0)

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Return the weighted mean."""
        is_finite = jnp.isfinite(candidates.costs)
        least = jnp.min(jnp.where(is_finite, candidates.costs, jnp.inf))
        above = jnp.where(is_finite, candidates.costs - least, 0.0)
        votes = jnp.where(is_finite, jnp.exp(-above / self.temperature), 0.0)
        return mixture(candidates, votes), memory


class BestOnly(Fusion):
    """The plan of least cost under the common objective."""

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Return the best plan."""
        return one_of(candidates, cheapest(candidates.costs)), memory


class Average(Fusion):
    """The mean of all plans."""

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Return the mean."""
        return mixture(candidates, jnp.ones_like(candidates.costs)), memory


class Median(Fusion):
    """The median of each control at each time: one member that is far off does not move it.

    Of an even number of members it is the mean of the middle two. Shares are equal.
    """

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Return the median."""
        number = candidates.costs.shape[0]
        shares = jnp.full(number, 1.0 / number)
        return Fused(jnp.median(candidates.controls, axis=0), shares, jnp.array(False)), memory


class TrustWeighted(Fusion):
    """The mean of the plans, each weighted by `1 / (uncertainty + least)`.

    A member whose good samples agree is surer of what to do than one whose good samples differ.

    Args:
        least: uncertainty that is as good as none, in half ranges of the controls.

    Raises:
        ValueError: a value that is not positive.
    """

    least: Scalar

    def __init__(self, least: ArrayLike = 1e-6) -> None:
        self.least = _checks.scalar("least", least, above=0.0)

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Return the weighted mean."""
        trust = 1.0 / (candidates.uncertainties + self.least)
        is_finite = jnp.isfinite(candidates.costs) & jnp.isfinite(trust)
        return mixture(candidates, jnp.where(is_finite, trust, 0.0)), memory
