"""A portfolio: MPPI controllers with different objectives side by side, and their fusion."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float

from jaxplore import _checks
from jaxplore._types import ControlVector, Key, Rows, Scalar, StateVector, Vector
from jaxplore.control.base import Controller, Info, Members, SampledPlan
from jaxplore.control.draft import MPPIState
from jaxplore.control.mppi import MPPI
from jaxplore.costs.base import Cost, SumCost, WeightedCost
from jaxplore.dynamics.base import State
from jaxplore.planning.portfolio._members import named_row, weight_rows
from jaxplore.planning.portfolio.common_objective import CommonObjective
from jaxplore.planning.portfolio.fusion import Candidates, Fused, Fusion, Situation
from jaxplore.planning.portfolio.safe_fusion import SafeFusion, fusion_by_name
from jaxplore.planning.portfolio.team import Proposed, Team


class PortfolioState(NamedTuple):
    """What a portfolio remembers.

    Args:
        members: of each member, stacked.
        spread: (O,) of each objective, smoothed over time; 0 before the first step.
        fusion: of the fusion.
    """

    members: MPPIState
    spread: Float[Array, " O"]
    fusion: Any


class Portfolio(Controller):
    """N MPPI controllers with different weights of the same objectives, in one `vmap`, fused.

    Member n minimises, over its own samples, with objectives J_o and what all pay alike J_hard,

        sum_o w_no J_o / s_o + J_hard,     s_o = max(floor_o, mean of |J_o - mean J_o|)

    The spread s_o is that over the rollouts of all members that do not collide, smoothed over
    `smoothing_time`: so every objective moves the costs equally, whatever its unit, and the weights
    say how much each counts. Rows of the weights are made to add up to 1.

    Members share model, belief and noise; they may differ in temperature, size of the noise,
    horizon and, for objectives that are given one for each member, in those. A member's horizon is
    its number of model steps times its own step, so short and long ones cost the same.

    Each member's plan is rolled out under a common objective, `sum_o c_o J_o / s_o + J_hard`, which
    makes their costs comparable; `fusion` makes one plan of them.

    Source: the design notes for ground vehicles ("parallel MPPI portfolio"); there the objectives
    are added up as they are.

    Args:
        mppi: what the members have in common. Its cost is J_hard: what no member trades for
            anything, such as `CollisionCost`, in multiples of an objective's spread.
        objectives: by name: a cost, or one for each member.
        weights: (N, O), or by member's name a mapping from objectives to weights; absent is 0.
        names: of the members; those of the mapping, or "1", "2" ... when absent.
        common: (O,) or a mapping, c of the common objective; the mean over members when absent.
            Objectives that differ between members are not part of it.
        fusion: how plans become one, or its name in `FUSIONS`; `SafeFusion()` when absent.
        temperatures: (N,) of each member; the template's when absent.
        noise_scales: (N,) by which the noise is multiplied; 1 when absent.
        horizons: (N,) how far each looks ahead [s]; the template's when absent.
        floors: (O,) or a mapping, the least spread by which each is divided [its unit, summed over
            the horizon]. One that rarely matters, such as nearness to obstacles, has no spread in
            the open; divided by that, the first wall would outweigh everything.
        is_normalised: whether objectives are divided by their spread; static.
        smoothing_time: of the spread [s].

    Raises:
        ValueError: weights of another shape, negative or all zero in a row; an objective that is
            not known; temperatures without a `Softmax`, noise scales without a `GaussianProposal`;
            numbers that are not positive; a fusion that does not fit the names; a template with a
            disturbance or a mesh.
    """

    team: Team
    common: Float[Array, " O"]
    fusion: Fusion

    def __init__(
        self,
        mppi: MPPI,
        objectives: Mapping[str, Cost | Sequence[Cost]],
        weights: Rows | Mapping[str, Mapping[str, float]],
        *,
        names: Sequence[str] | None = None,
        common: Vector | Mapping[str, float] | None = None,
        fusion: Fusion | str | None = None,
        temperatures: Vector | None = None,
        noise_scales: Vector | None = None,
        horizons: Vector | None = None,
        floors: Vector | Mapping[str, float] | None = None,
        is_normalised: bool = True,
        smoothing_time: ArrayLike = 1.0,
    ) -> None:
        self.team = Team(
            mppi,
            objectives,
            weights,
            names=names,
            temperatures=temperatures,
            noise_scales=noise_scales,
            horizons=horizons,
            floors=floors,
            is_normalised=is_normalised,
            smoothing_time=smoothing_time,
        )
        self.common = self._common(common)
        if fusion is None or isinstance(fusion, str):
            fusion = SafeFusion() if fusion is None else fusion_by_name(fusion)
        fusion.check(self.member_names)
        self.fusion = fusion

    @property
    def member_names(self) -> tuple[str, ...]:
        """Names of the members."""
        return self.team.names

    @property
    def objective_names(self) -> tuple[str, ...]:
        """Names of the objectives, in the order of the weights' columns."""
        return self.team.objective_names

    def init(self) -> PortfolioState:
        """Return the state before the first step."""
        spread = jnp.zeros(len(self.objective_names))
        return PortfolioState(self.team.init(), spread, self.fusion.init())

    def at_period(self, control_period: ArrayLike) -> "Portfolio":
        """Return this controller for commands that are `control_period` seconds apart."""
        same: Portfolio = eqx.tree_at(
            lambda portfolio: portfolio.team.mppi, self, self.team.mppi.at_period(control_period)
        )
        return same

    def single(self, name: str, spread: Vector | None = None) -> MPPI:
        """Return a member alone: MPPI that minimises the sum of its weighted objectives.

        Args:
            name: of the member.
            spread: (O,) by which objectives are divided; 1 when absent.

        Raises:
            ValueError: an unknown name.
        """
        if name not in self.member_names:
            raise ValueError(f"name is {name!r}; accepted: {', '.join(self.member_names)}")
        index, count = self.member_names.index(name), len(self.objective_names)
        scale = jnp.ones(count) if spread is None else _checks.vector("spread", spread, count)
        member = self.team.member(index)
        factors = self.team.weights[index] / scale
        terms = tuple(
            WeightedCost(factors[number], cost.named(label))
            for number, (label, cost) in enumerate(
                zip(self.objective_names, self.team.objectives(index), strict=True)
            )
        )
        total = SumCost((*terms, member.cost))
        single: MPPI = eqx.tree_at(lambda mppi: mppi.cost, member, total)
        return single

    def step(
        self,
        state: PortfolioState,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
    ) -> tuple[ControlVector, PortfolioState, Info]:
        """Plan once: all members, then the fusion.

        Args:
            state: from `init` or the last step.
            observation: (nx,) the robot's state.
            belief: what the robot knows.
            key: randomness; the same for all members.
        """
        proposed, spread = self.team.propose(
            state.members, state.spread, observation, belief, key=key
        )
        candidates, fused, memory = self._fuse(state, proposed, spread, observation, belief)
        control = fused.controls[0]
        # What was given out is the fused control: that is what changes are counted from.
        applied = jnp.broadcast_to(control, proposed.states.applied.shape)
        after = PortfolioState(proposed.states._replace(applied=applied), spread, memory)
        return control, after, self._info(proposed, candidates, fused)

    def inspect(
        self,
        state: PortfolioState,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return what `step` sees: the fused plan, the best member's, and all members' rollouts.

        Costs by term are the weighted objectives of the common objective.
        """
        proposed, spread = self.team.propose(
            state.members, state.spread, observation, belief, key=key
        )
        candidates, fused, _ = self._fuse(state, proposed, spread, observation, belief)
        each = min(max(1, num_trajectories // len(self.member_names)), self.team.mppi.num_samples)
        chosen = np.linspace(0, self.team.mppi.num_samples - 1, each).round().astype(int)
        judge = self._judge(state, spread, observation, belief)

        def drawn(index: Array, member_state: MPPIState) -> tuple[Array, Array]:
            member = self.team.member(index)
            controls = member.draft(member_state, key=key).controls[:, :, chosen]
            return jnp.moveaxis(controls, -1, 0), jnp.broadcast_to(member.dt, each)

        sampled, steps = jax.vmap(drawn)(self.team.indices, state.members)
        best = jnp.argmin(jnp.where(jnp.isfinite(candidates.costs), candidates.costs, jnp.inf))
        shown = jnp.stack([fused.controls, candidates.controls[best]])
        followed = jax.vmap(judge.follow)(
            jnp.concatenate([shown, sampled.reshape(-1, *shown.shape[1:])]),
            jnp.concatenate([jnp.broadcast_to(judge.dt, 2), steps.reshape(-1)]),
        )
        weights = proposed.infos.weights[:, chosen] * fused.shares[:, None]
        return SampledPlan.of(followed, weights.reshape(-1))

    def _fuse(
        self,
        state: PortfolioState,
        proposed: Proposed,
        spread: Float[Array, " O"],
        observation: StateVector,
        belief: Any,
    ) -> tuple[Candidates, Fused, Any]:
        judge = self._judge(state, spread, observation, belief)
        costs, hazards = judge(proposed.plans)
        candidates = Candidates(proposed.plans, costs, hazards, proposed.uncertainties)
        situation = Situation(State(observation, self.team.mppi.dynamics), belief, judge)
        fused, memory = self.fusion(state.fusion, candidates, situation)
        return candidates, fused, memory

    def _info(self, proposed: Proposed, candidates: Candidates, fused: Fused) -> Info:
        infos, number = proposed.infos, len(self.member_names)
        share = jnp.full(number, 1.0 / number)[:, None]
        weights, costs = (share * infos.weights).reshape(-1), infos.costs.reshape(-1)
        first = candidates.controls[:, 0]
        return Info(
            controls=fused.controls,
            weights=weights,
            costs=costs,
            effective_sample_size=jnp.mean(infos.effective_sample_size),
            is_finite=jnp.any(infos.is_finite),
            members=Members(
                controls=first,
                costs=candidates.costs,
                uncertainties=proposed.uncertainties,
                effective_sample_sizes=infos.effective_sample_size,
                shares=fused.shares,
                diversity=diversity(first / self.team.half_range),
                is_replaced=fused.is_replaced,
            ),
        )

    def _judge(
        self,
        state: PortfolioState,
        spread: Float[Array, " O"],
        observation: StateVector,
        belief: Any,
    ) -> CommonObjective:
        """Return the common objective, of what all members share."""
        pairs = zip(self.objective_names, self.team.shared, strict=True)
        judged = {name: cost for name, cost in pairs if cost is not None}
        shared = np.flatnonzero([cost is not None for cost in self.team.shared])
        return CommonObjective(
            self.team.mppi.dynamics,
            self.team.mppi.cost,
            judged,
            (self.common / self.team.normalisation.scale(spread))[shared],
            self.team.mppi.dt,
            observation,
            belief,
            state.members.applied[0],
        )

    def _common(self, common: Vector | Mapping[str, float] | None) -> Float[Array, " O"]:
        is_shared = np.asarray([cost is not None for cost in self.team.shared], np.float32)
        if common is None:
            mean = self.team.weights.mean(axis=0) * is_shared
            return mean / jnp.maximum(jnp.sum(mean), 1e-6)
        given, _ = weight_rows(
            [named_row(common, self.objective_names)], None, self.objective_names, "common"
        )
        if (np.asarray(given[0]) * (1.0 - is_shared) > 0.0).any():
            raise ValueError(
                f"common is {common!r}, with an objective that differs between members; accepted: "
                "weights of objectives that all share"
            )
        return given[0]


def diversity(controls: Float[Array, "N nu"]) -> Scalar:
    """Return the mean over pairs of rows of the root mean square of their difference; 0 of one row.

    Args:
        controls: (N, nu) in units in which components compare.
    """
    number = controls.shape[0]
    if number < 2:
        return jnp.zeros(())
    first, second = np.triu_indices(number, 1)
    away = controls[first] - controls[second]
    square = jnp.mean(away * away, axis=1)
    is_equal = square <= 0.0
    return jnp.mean(jnp.where(is_equal, 0.0, jnp.sqrt(jnp.where(is_equal, 1.0, square))))
