"""Fusions that average plans by cost or uncertainty, or select the best one."""

from typing import Any

import jax.numpy as jnp

from jaxplore import _checks
from jaxplore._types import ArrayLike, Scalar
from jaxplore.planning.portfolio.fusion import (
    Candidates,
    Fused,
    Fusion,
    Situation,
    least_finite,
    select_member,
    weighted_mean,
)


class WeightedVote(Fusion):
    """Mean of the plans, weighted by `softmax(-cost / temperature)`.

    The costs are those of the common objective, which makes them comparable although each member
    minimises another one. A plan whose cost is not finite has no weight.

    Args:
        temperature: temperature of the softmax, in units of cost. A small one selects the best
            plan, a large one averages all.

    Raises:
        ValueError: a temperature that is not positive.
    """

    temperature: Scalar

    def __init__(self, temperature: ArrayLike = 0.1) -> None:
        self.temperature = _checks.scalar("temperature", temperature, above=0.0)

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Average the plans with weights by cost."""
        is_finite = jnp.isfinite(candidates.costs)
        # Differences to the best plan, so that the exponential does not underflow for all plans.
        least = jnp.min(jnp.where(is_finite, candidates.costs, jnp.inf))
        above = jnp.where(is_finite, candidates.costs - least, 0.0)
        votes = jnp.where(is_finite, jnp.exp(-above / self.temperature), 0.0)
        return weighted_mean(candidates, votes), memory


class BestOnly(Fusion):
    """Plan of least cost under the common objective."""

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Select the plan of least cost."""
        return select_member(candidates, least_finite(candidates.costs)), memory


class Average(Fusion):
    """Mean of all plans that are finite."""

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Average all plans."""
        return weighted_mean(candidates, jnp.ones_like(candidates.costs)), memory


class Median(Fusion):
    """Median over members of each control at each time, robust against a single outlier.

    With an even number of members it is the mean of the middle two. The reported shares are equal.
    Plans that are not finite are left out.
    """

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Take the median of the plans."""
        alike = weighted_mean(candidates, jnp.ones_like(candidates.costs)).shares
        # Plans without a share are NaN, which the median leaves out.
        counted = jnp.where((alike > 0.0)[:, None, None], candidates.controls, jnp.nan)
        return Fused(jnp.nanmedian(counted, axis=0), alike, jnp.array(False)), memory


class TrustWeighted(Fusion):
    """Mean of the plans, weighted by `1 / (uncertainty + least)`.

    The uncertainty of a member is the spread of its weighted samples: it is low where the good
    samples agree.

    Args:
        least: uncertainty that counts as none, in half ranges of the controls.

    Raises:
        ValueError: a value that is not positive.
    """

    least: Scalar

    def __init__(self, least: ArrayLike = 1e-6) -> None:
        self.least = _checks.scalar("least", least, above=0.0)

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Average the plans with weights by trust."""
        trust = 1.0 / (candidates.uncertainties + self.least)
        is_finite = jnp.isfinite(candidates.costs) & jnp.isfinite(trust)
        return weighted_mean(candidates, jnp.where(is_finite, trust, 0.0)), memory
