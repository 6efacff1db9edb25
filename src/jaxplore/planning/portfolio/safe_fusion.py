"""A fusion whose plan is checked before it is followed, and all fusions by name."""

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import Count, Scalar
from jaxplore.planning.portfolio.contextual import Contextual
from jaxplore.planning.portfolio.fusion import (
    Candidates,
    Fused,
    Fusion,
    Situation,
    cheapest,
    one_of,
)
from jaxplore.planning.portfolio.voting import (
    Average,
    BestOnly,
    Median,
    TrustWeighted,
    WeightedVote,
)


class SafeFusion(Fusion):
    """Another fusion, whose plan is rolled out itself, and replaced if it is worse than a member's.

    A mixture of plans that are good may be bad: the average of passing a pillar on the left and on
    the right runs into the pillar. So the fused sequence is evaluated beside the members'. The best
    member takes its place if

    - it collides and that member collides less, or
    - it costs `regret` more than that member.

    The best member is that of least cost among those that do not collide; if all do, the one that
    collides least.

    Args:
        fusion: makes the mixture.
        regret: cost by which the mixture may exceed the best member's [units of the common
            objective]; None to look at collisions only.
        tolerated: hazard that counts as no collision.

    Raises:
        ValueError: a negative value.
    """

    fusion: Fusion
    regret: Scalar | None
    tolerated: Scalar

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
        """Return what the inner fusion remembers."""
        return self.fusion.init()

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Return the mixture, or the best member's plan."""
        mixed, memory = self.fusion(memory, candidates, situation)
        costs, hazards = situation.evaluate(mixed.controls[None])
        best = self.best(candidates)
        alternative = one_of(candidates, best)
        is_unsafe = ~(hazards[0] <= self.tolerated)
        is_safer = candidates.hazards[best] < jnp.where(jnp.isnan(hazards[0]), jnp.inf, hazards[0])
        is_replaced = is_unsafe & is_safer
        if self.regret is not None:
            is_dear = ~(costs[0] <= candidates.costs[best] + self.regret)
            # A dear mixture that is safe is better than a cheap member that collides.
            worst = jnp.maximum(hazards[0], self.tolerated)
            is_replaced |= is_dear & (candidates.hazards[best] <= worst)
        pick = jnp.where(is_replaced, 1.0, 0.0)
        return Fused(
            jnp.where(is_replaced, alternative.controls, mixed.controls),
            pick * alternative.shares + (1.0 - pick) * mixed.shares,
            is_replaced,
        ), memory

    def best(self, candidates: Candidates) -> Count:
        """Return the index of the best member."""
        hazards = jnp.where(jnp.isfinite(candidates.hazards), candidates.hazards, jnp.inf)
        is_safe = hazards <= self.tolerated
        is_priced = is_safe & jnp.isfinite(candidates.costs)
        among = jnp.where(is_priced, candidates.costs, jnp.inf)
        return jnp.where(jnp.isfinite(jnp.min(among)), jnp.argmin(among), cheapest(hazards)).astype(
            jnp.int32
        )

    def check(self, names: tuple[str, ...]) -> None:
        """Raise a `ValueError` if the inner fusion does not fit the members."""
        self.fusion.check(names)


FUSIONS: Mapping[str, Callable[[], Fusion]] = {
    "weighted-vote": WeightedVote,
    "best-only": BestOnly,
    "average": Average,
    "median": Median,
    "trust-weighted": TrustWeighted,
    "contextual": Contextual,
    "safe": SafeFusion,
}
"""By name, with their default numbers."""


def fusion_by_name(name: str) -> Fusion:
    """Return a fusion with its default numbers.

    Raises:
        ValueError: a name that is none of `FUSIONS`.
    """
    if name not in FUSIONS:
        raise ValueError(f"fusion is {name!r}; accepted: {', '.join(FUSIONS)}")
    return FUSIONS[name]()
