"""A fusion that checks its plan against those of the members, and all fusions by name."""

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._spelling import match_spelling
from jaxplore._types import ArrayLike, Count, Scalar
from jaxplore.planning.portfolio.contextual import Contextual
from jaxplore.planning.portfolio.fusion import (
    Candidates,
    Fused,
    Fusion,
    Situation,
    least_finite,
    select_member,
)
from jaxplore.planning.portfolio.information_density import InformationDensity
from jaxplore.planning.portfolio.voting import (
    Average,
    BestOnly,
    Median,
    TrustWeighted,
    WeightedVote,
)


class SafeFusion(Fusion):
    """Evaluates the plan of another fusion, and replaces it if the best member's plan is better.

    A mixture of good plans may be bad: the average of passing a pillar on the left and on the right
    runs into the pillar. The fused sequence is therefore rolled out too. The plan of the best
    member replaces it if

    - the fused plan collides and the member's plan collides less, or
    - the fused plan costs more than the member's plan plus `regret`.

    The best member is the one of least cost among those that do not collide. If all collide, it is
    the one of least hazard.

    Args:
        fusion: fusion that makes the mixture; `WeightedVote()` when absent.
        regret: excess cost of the mixture that is accepted [units of the common objective]; with
            None only collisions are compared.
        tolerated: hazard that counts as no collision.

    Raises:
        ValueError: a negative value.
    """

    fusion: Fusion
    regret: Scalar | None
    tolerated: Scalar

    @_kinds.check_arguments
    def __init__(
        self,
        fusion: Fusion | None = None,
        *,
        regret: ArrayLike | None = None,
        tolerated: ArrayLike = 1e-6,
    ) -> None:
        self.fusion = WeightedVote() if fusion is None else fusion
        self.regret = None if regret is None else _checks.scalar("regret", regret, at_least=0.0)
        self.tolerated = _checks.scalar("tolerated", tolerated, at_least=0.0)

    def init(self) -> Any:
        """Return the initial memory of the inner fusion."""
        return self.fusion.init()

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Fuse the plans, and replace the mixture if the best member's plan is better."""
        mixed, memory = self.fusion(memory, candidates, situation)
        costs, hazards = situation.evaluate(mixed.controls[None])
        best = self.best(candidates)
        alternative = select_member(candidates, best)
        # Negated comparisons, so that a hazard or a cost that is NaN counts as worse.
        is_unsafe = ~(hazards[0] <= self.tolerated)
        is_safer = candidates.hazards[best] < jnp.where(jnp.isnan(hazards[0]), jnp.inf, hazards[0])
        is_replaced = is_unsafe & is_safer
        if self.regret is not None:
            is_costly = ~(costs[0] <= candidates.costs[best] + self.regret)
            # A safe mixture is never replaced by a member that costs less but collides.
            worst = jnp.maximum(hazards[0], self.tolerated)
            is_replaced |= is_costly & (candidates.hazards[best] <= worst)
        pick = jnp.where(is_replaced, 1.0, 0.0)
        return Fused(
            jnp.where(is_replaced, alternative.controls, mixed.controls),
            pick * alternative.shares + (1.0 - pick) * mixed.shares,
            is_replaced,
        ), memory

    def best(self, candidates: Candidates) -> Count:
        """Return the index of the best member: safe first, then of least cost."""
        hazards = jnp.where(jnp.isfinite(candidates.hazards), candidates.hazards, jnp.inf)
        is_safe = hazards <= self.tolerated
        is_choice = is_safe & jnp.isfinite(candidates.costs)
        costs = jnp.where(is_choice, candidates.costs, jnp.inf)
        is_any_safe = jnp.isfinite(jnp.min(costs))
        index = jnp.where(is_any_safe, jnp.argmin(costs), least_finite(hazards))
        return index.astype(jnp.int32)

    def check(self, names: tuple[str, ...]) -> None:
        """Raise a `ValueError` if the inner fusion does not fit the members."""
        self.fusion.check(names)


FUSIONS: Mapping[str, Callable[[], Fusion]] = {
    "weighted-vote": WeightedVote,
    "best-only": BestOnly,
    "average": Average,
    "median": Median,
    "trust-weighted": TrustWeighted,
    "information-density": InformationDensity,
    "contextual": Contextual,
    "safe": SafeFusion,
}
"""Fusions by name."""


def fusion_by_name(name: str) -> Fusion:
    """Return the fusion of a name, with its default parameters.

    Args:
        name: name in `FUSIONS`, with hyphens or with underscores.

    Raises:
        ValueError: a name that is not in `FUSIONS`.
    """
    known = match_spelling(name, FUSIONS)
    if not isinstance(known, str) or known not in FUSIONS:
        given = _kinds.describe(name)
        raise ValueError(f"name of the fusion is {given}; accepted: {', '.join(FUSIONS)}")
    return FUSIONS[known]()
