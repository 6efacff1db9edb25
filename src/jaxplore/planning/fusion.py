"""Fusion: one control sequence from those of several controllers."""

import abc
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxplore import _checks
from jaxplore._types import Count, Scalar, Vector
from jaxplore.dynamics.base import State

Sequences = Float[Array, "N T nu"]
Plan = Float[Array, "T nu"]
Evaluate = Callable[[Sequences], tuple[Float[Array, " N"], Float[Array, " N"]]]
"""Gives the cost of control sequences under the common objective, and how far they collide."""


class Candidates(NamedTuple):
    """What the members of a portfolio propose.

    Args:
        controls: (N, T, nu) on one time grid.
        costs: (N,) under the common objective, what collides included; not finite if a plan is not.
        hazards: (N,) the share of it that is paid for collisions; 0 for a plan without.
        uncertainties: (N,) spread of the weighted samples, in half ranges of the controls.
    """

    controls: Sequences
    costs: Float[Array, " N"]
    hazards: Float[Array, " N"]
    uncertainties: Float[Array, " N"]


class Situation(NamedTuple):
    """Where the robot is while it chooses.

    Args:
        state: of the robot.
        belief: what it knows.
        evaluate: rolls out other control sequences under the same objective.
    """

    state: State
    belief: Any
    evaluate: Evaluate


class Fused(NamedTuple):
    """What a fusion makes of the candidates.

    Args:
        controls: (T, nu).
        shares: (N,) how much each member has in it; adds up to 1.
        is_replaced: whether a safer plan took the place of the mixture.
    """

    controls: Plan
    shares: Float[Array, " N"]
    is_replaced: Bool[Array, ""]


class Fusion(eqx.Module):
    """Makes one plan of several. To permute the members permutes the shares and nothing else."""

    def init(self) -> Any:
        """Return what the fusion remembers between steps: nothing by default."""
        return ()

    @abc.abstractmethod
    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Return the plan and the new memory."""

    def check(self, names: tuple[str, ...]) -> None:
        """Raise a `ValueError` if the fusion does not fit members of these names."""
        return


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
        return _mixture(candidates, votes), memory


class BestOnly(Fusion):
    """The plan of least cost under the common objective."""

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Return the best plan."""
        return _one(candidates, _cheapest(candidates.costs)), memory


class Average(Fusion):
    """The mean of all plans."""

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Return the mean."""
        return _mixture(candidates, jnp.ones_like(candidates.costs)), memory


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
        return _mixture(candidates, jnp.where(is_finite, trust, 0.0)), memory


ROLES = ("explorer", "balanced", "exploiter", "cautious")
"""What a contextual fusion chooses among."""


class Contextual(Fusion):
    """The plan of the role that the situation asks for, the first of these that holds:

    | situation | role |
    | --- | --- |
    | the goal is nearer than `near_goal` | exploiter |
    | the nearest obstacle is nearer than `near_obstacle` | cautious |
    | a scan from here tells more than `rich_information` | explorer |
    | otherwise | balanced |

    A situation that has begun ends only when its quantity is `hysteresis` beyond the threshold, so
    that a robot on the edge of one does not change its mind at every step.

    Source: the design notes for ground vehicles, "contextual switching".

    Args:
        names: of the members, in their order; each role must be one of them.
        goal: (x, y) [m]; never near it when absent.
        near_goal: [m].
        near_obstacle: from the robot's covering discs to the nearest cell not known to be free [m].
        rich_information: [nat per beam].
        hysteresis: share of each threshold.

    Raises:
        ValueError: a role that is no member's name, a threshold that is not positive, a negative
            hysteresis.
    """

    goal: Float[Array, "2"] | None
    near_goal: Scalar
    near_obstacle: Scalar
    rich_information: Scalar
    hysteresis: Scalar
    members: tuple[int, ...] = eqx.field(static=True)

    def __init__(
        self,
        names: tuple[str, ...] = ROLES,
        *,
        goal: Vector | None = None,
        near_goal: ArrayLike = 2.0,
        near_obstacle: ArrayLike = 0.3,
        rich_information: ArrayLike = 0.2,
        hysteresis: ArrayLike = 0.2,
    ) -> None:
        for role in ROLES:
            if role not in names:
                raise ValueError(
                    f"names is {tuple(names)}, without {role!r}; accepted: names that include "
                    f"{', '.join(ROLES)}"
                )
        self.members = tuple(names.index(role) for role in ROLES)
        self.goal = None if goal is None else _checks.vector("goal", goal, 2)
        self.near_goal = _checks.scalar("near_goal", near_goal, above=0.0)
        self.near_obstacle = _checks.scalar("near_obstacle", near_obstacle, above=0.0)
        self.rich_information = _checks.scalar("rich_information", rich_information, above=0.0)
        self.hysteresis = _checks.scalar("hysteresis", hysteresis, at_least=0.0)

    def init(self) -> Bool[Array, "3"]:
        """Return which situations hold: none."""
        return jnp.zeros(3, bool)

    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Return the plan of the role that is asked for."""
        holds = self.situations(memory, situation)
        explorer, balanced, exploiter, cautious = self.members
        roles = jnp.asarray([exploiter, cautious, explorer, balanced])
        first = jnp.argmax(jnp.append(holds, True))
        return _one(candidates, roles[first]), holds

    def situations(self, held: Bool[Array, "3"], situation: Situation) -> Bool[Array, "3"]:
        """Say whether the robot is near its goal, near an obstacle, and where a scan is rich.

        Args:
            held: which of them held before.
            situation: as it is now.
        """
        state, belief = situation.state, situation.belief
        position, heading = state.position, state.heading
        footprint = state.dynamics.footprint
        distance = jnp.asarray(jnp.inf)
        if self.goal is not None:
            distance = jnp.linalg.norm(position - self.goal)
        ahead = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        centres = position + footprint.offsets[:, None] * ahead
        room = jnp.min(jax.vmap(belief.clearance)(centres)) - footprint.radius
        field = belief.information
        information = field(position, heading) / field.num_beams
        wider, narrower = 1.0 + self.hysteresis, 1.0 / (1.0 + self.hysteresis)
        near_goal = distance < self.near_goal * jnp.where(held[0], wider, 1.0)
        near_obstacle = room < self.near_obstacle * jnp.where(held[1], wider, 1.0)
        is_rich = information > self.rich_information * jnp.where(held[2], narrower, 1.0)
        return jnp.stack([near_goal, near_obstacle, is_rich])

    def check(self, names: tuple[str, ...]) -> None:
        """Raise a `ValueError` if the fusion was made for members of other names."""
        chosen = [names[index] if index < len(names) else None for index in self.members]
        if chosen != list(ROLES):
            raise ValueError(
                f"names is {names}; accepted for this contextual fusion: those it was made for"
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
        alternative = _one(candidates, best)
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
        return jnp.where(
            jnp.isfinite(jnp.min(among)), jnp.argmin(among), _cheapest(hazards)
        ).astype(jnp.int32)

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


def _cheapest(costs: Float[Array, " N"]) -> Count:
    return jnp.argmin(jnp.where(jnp.isfinite(costs), costs, jnp.inf)).astype(jnp.int32)


def _mixture(candidates: Candidates, votes: Float[Array, " N"]) -> Fused:
    """Return the mean with these weights; without any weight, that of all alike."""
    total = jnp.sum(votes)
    alike = jnp.full_like(votes, 1.0 / votes.shape[0])
    shares = jnp.where(total > 0.0, votes / jnp.where(total > 0.0, total, 1.0), alike)
    controls = jnp.einsum("n,ntu->tu", shares, candidates.controls)
    return Fused(controls, shares, jnp.array(False))


def _one(candidates: Candidates, index: Count) -> Fused:
    shares = jax.nn.one_hot(index, candidates.costs.shape[0])
    return Fused(candidates.controls[index], shares, jnp.array(False))
