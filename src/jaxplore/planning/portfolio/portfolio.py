"""The portfolio: several MPPI controllers with different weights, and the fusion of their plans.

The common objective is one cost that makes the plans of all members comparable.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Key, Rows, Scalar, StateVector, Vector
from jaxplore.control.base import Controller, Info, Members, SampledPlan
from jaxplore.control.model_checks import check_call
from jaxplore.control.mppi import MPPI, MPPIState, choose_samples
from jaxplore.control.rollout import rollout_objectives
from jaxplore.control.trajectory import Trajectory, rollout
from jaxplore.costs.base import Cost, SumCost, WeightedCost
from jaxplore.dynamics.base import Dynamics, State
from jaxplore.planning.portfolio._members import (
    check_objectives,
    normalise_weights,
    values_in_order,
)
from jaxplore.planning.portfolio.fusion import (
    Candidates,
    Fused,
    Fusion,
    Situation,
    least_finite,
)
from jaxplore.planning.portfolio.member_controllers import MemberControllers, MemberPlans
from jaxplore.planning.portfolio.safe_fusion import SafeFusion, fusion_by_name


class CommonObjective(eqx.Module):
    """Evaluates plans from the current state under `sum_o f_o J_o + J_hard`, with the `factors` f_o
    of the `objectives` J_o, and the cost `hard`, which no member trades for an objective. `applied`
    is the control of the last step."""

    dynamics: Dynamics
    hard: Cost
    objectives: Mapping[str, Cost]
    factors: Float[Array, " O"]
    dt: Scalar
    observation: StateVector
    belief: Any
    applied: ControlVector

    def __call__(
        self, controls: Float[Array, "N T nu"]
    ) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
        """Evaluate N plans and return their costs (N,) and the hard part of these costs (N,)."""
        # One rollout for all plans, hard cost first; samples are on the last axis there.
        paid = rollout_objectives(
            self.dynamics,
            (self.hard, *self.objectives.values()),
            self.observation,
            jnp.moveaxis(controls, 0, -1),
            self.dt,
            self.belief,
            applied=self.applied,
        )
        # An objective without weight may be infinite or NaN, and 0 times that is NaN.
        counted = jnp.where(self.factors[:, None] > 0.0, paid[1:], 0.0)
        return paid[0] + self.factors @ counted, paid[0]

    def trajectory(self, controls: Float[Array, "T nu"], dt: Scalar) -> Trajectory:
        """Simulate a plan with steps of `dt` [s] and return its trajectory and the cost by term."""
        terms = tuple(
            WeightedCost(factor, cost.with_name(name))
            for factor, (name, cost) in zip(self.factors, self.objectives.items(), strict=True)
        )
        return rollout(
            self.dynamics,
            SumCost((*terms, self.hard)),
            self.observation,
            controls,
            dt,
            self.belief,
            applied=self.applied,
        )


class PortfolioState(NamedTuple):
    """State of a portfolio.

    Args:
        members: states of the members, stacked.
        spread: (O,) smoothed spread of each objective; 0 before the first step.
        fusion: memory of the fusion.
    """

    members: MPPIState
    spread: Float[Array, " O"]
    fusion: Any


class Portfolio(Controller):
    """N MPPI controllers with different weights of the same objectives, fused into one plan.

    Member n minimises over its own samples

        sum_o w_no J_o / s_o + J_hard,     s_o = max(floor_o, mean of |J_o - mean J_o|)

    with J_o the objectives and J_hard the cost that all members share. The scale s_o is the spread
    over the rollouts of all members that do not collide, smoothed over `smoothing_time`. It removes
    the units, so the weights alone say how much each objective counts. Rows of the weights are
    normalised to a sum of 1. All members run in one `vmap`.

    Members share the model, the belief and the noise. They may differ in temperature, noise
    scale, horizon, and in objectives that are given for each member. A member's horizon is the
    number of model steps times a step of its own, so long and short horizons take the same time to
    compute.

    The plan of each member is then evaluated under a common objective,
    `sum_o c_o J_o / s_o + J_hard`, which makes their costs comparable. `fusion` makes one plan of
    them.

    Source: the design notes for ground vehicles ("parallel MPPI portfolio"), which add the
    objectives without normalisation.

    Args:
        mppi: template of the members. Its cost is J_hard, which no member trades for an objective,
            such as `CollisionCost` [spreads of an objective].
        objectives: objectives by name; each is one cost, or one cost for each member.
        weights: (N, O) weights, or a mapping from member to a mapping from objective to weight;
            absent weights are 0.
        names: names of the members; those of the mapping, or "1", "2" ... when absent.
        common: (O,) weights c of the common objective, or a mapping; the mean over members when
            absent. Objectives that differ between members are not part of it.
        fusion: fusion of the plans, or its name in `FUSIONS`; `SafeFusion()` when absent.
        temperatures: (N,) temperature of each member; that of the template when absent.
        noise_scales: (N,) factor on the noise of each member; 1 when absent.
        horizons: (N,) horizon of each member [s]; that of the template when absent.
        floors: (O,) lower bounds of the scales, or a mapping [unit of the objective, summed over
            the horizon]. An objective that rarely matters, such as nearness to obstacles, has no
            spread in the open. Divided by it, the first wall would outweigh everything.
        is_normalised: whether objectives are divided by their scale; static.
        smoothing_time: time constant of the smoothed spread [s].

    Raises:
        ValueError: weights of the wrong shape, negative ones or a row of zeros; an unknown
            objective; temperatures without a `Softmax`, noise scales without a `GaussianProposal`;
            numbers that are not positive; a fusion that does not fit the names; a template with a
            disturbance or a mesh.
    """

    members: MemberControllers
    common: Float[Array, " O"]
    fusion: Fusion

    @_kinds.check_arguments
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
        check_objectives(objectives)
        _kinds.flag("is_normalised", is_normalised)
        self.members = MemberControllers(
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
        self.common = self._common_weights(common)
        if fusion is None or isinstance(fusion, str):
            fusion = SafeFusion() if fusion is None else fusion_by_name(fusion)
        fusion.check(self.member_names)
        self.fusion = fusion

    @property
    def member_names(self) -> tuple[str, ...]:
        """Names of the members."""
        return self.members.names

    @property
    def objective_names(self) -> tuple[str, ...]:
        """Names of the objectives, in the order of the weights' columns."""
        return self.members.objective_names

    def init(self) -> PortfolioState:
        """Return the initial state."""
        spread = jnp.zeros(len(self.objective_names))
        return PortfolioState(self.members.init(), spread, self.fusion.init())

    def at_period(self, control_period: ArrayLike) -> "Portfolio":
        """Return a copy of this controller that is called every `control_period` seconds."""
        mppi = self.members.mppi.at_period(control_period)
        same: Portfolio = eqx.tree_at(lambda portfolio: portfolio.members.mppi, self, mppi)
        return same

    def single(self, name: str, spread: Vector | None = None) -> MPPI:
        """Return one member as an MPPI controller of its own, with its weighted objectives.

        Args:
            name: name of the member.
            spread: (O,) scales that the objectives are divided by; 1 when absent.

        Raises:
            ValueError: an unknown name.
        """
        if name not in self.member_names:
            raise ValueError(f"name is {name!r}; accepted: {', '.join(self.member_names)}")
        index, count = self.member_names.index(name), len(self.objective_names)
        scale = jnp.ones(count) if spread is None else _checks.vector("spread", spread, count)
        member = self.members.member(index)
        factors = self.members.weights[index] / scale
        terms = tuple(
            WeightedCost(factors[number], cost.with_name(label))
            for number, (label, cost) in enumerate(
                zip(self.objective_names, self.members.objectives(index), strict=True)
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
        """Plan with all members and fuse their plans.

        Args:
            state: state from `init` or the last step.
            observation: (nx,) observed state of the robot.
            belief: what the robot knows of the world.
            key: random key of this step, shared by all members.

        Returns:
            The control (nu,), the new state, and `Info` with the diagnostics of each member.
        """
        model = self.members.mppi.dynamics
        observation = check_call(model, state, PortfolioState, observation, key)
        plans, spread = self.members.plan(state.members, state.spread, observation, belief, key=key)
        candidates, fused, memory = self._fuse(state, plans, spread, observation, belief)
        control = fused.controls[0]
        # The robot applies the fused control, so the members must count changes from that one.
        applied = jnp.broadcast_to(control, plans.states.applied.shape)
        after = PortfolioState(plans.states._replace(applied=applied), spread, memory)
        return control, after, self._info(plans, candidates, fused)

    def inspect(
        self,
        state: PortfolioState,
        observation: StateVector,
        belief: Any = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return the fused plan, the best member's plan, and sampled rollouts of all members.

        The costs by term are the weighted objectives of the common objective. See
        `Controller.inspect` for the arguments.
        """
        model = self.members.mppi.dynamics
        observation = check_call(model, state, PortfolioState, observation, key)
        wanted = _checks.whole_number("num_trajectories", num_trajectories, at_least=0)
        plans, spread = self.members.plan(state.members, state.spread, observation, belief, key=key)
        candidates, fused, _ = self._fuse(state, plans, spread, observation, belief)
        each = max(1, wanted // len(self.member_names))
        chosen = choose_samples(self.members.mppi.num_samples, each)
        objective = self._common_objective(state, spread, observation, belief)

        def draw(index: Array, member_state: MPPIState) -> tuple[Array, Array]:
            member = self.members.member(index)
            controls = member.sample(member_state, key=key).controls[:, :, chosen]
            return jnp.moveaxis(controls, -1, 0), jnp.broadcast_to(member.dt, chosen.shape)

        sampled, steps = jax.vmap(draw)(self.members.indices, state.members)
        best = least_finite(candidates.costs)
        shown = jnp.stack([fused.controls, candidates.controls[best]])
        # All are simulated under the common objective, the samples with the steps of their member.
        trajectories = jax.vmap(objective.trajectory)(
            jnp.concatenate([shown, sampled.reshape(-1, *shown.shape[1:])]),
            jnp.concatenate([jnp.broadcast_to(objective.dt, 2), steps.reshape(-1)]),
        )
        weights = plans.infos.weights[:, chosen] * fused.shares[:, None]
        return SampledPlan.from_trajectories(trajectories, weights.reshape(-1))

    def _fuse(
        self,
        state: PortfolioState,
        plans: MemberPlans,
        spread: Float[Array, " O"],
        observation: StateVector,
        belief: Any,
    ) -> tuple[Candidates, Fused, Any]:
        objective = self._common_objective(state, spread, observation, belief)
        costs, hazards = objective(plans.controls)
        candidates = Candidates(plans.controls, costs, hazards, plans.uncertainties)
        # The fused control of the last step, which is the same in all members.
        here = State(observation, self.members.mppi.dynamics, state.members.applied[0])
        situation = Situation(here, belief, objective, self.members.mppi.dt)
        fused, memory = self.fusion(state.fusion, candidates, situation)
        return candidates, fused, memory

    def _info(self, plans: MemberPlans, candidates: Candidates, fused: Fused) -> Info:
        infos, number = plans.infos, len(self.member_names)
        # The rollouts of all members count as one set, in which each member has the same share.
        share = jnp.full(number, 1.0 / number)[:, None]
        weights, costs = (share * infos.weights).reshape(-1), infos.costs.reshape(-1)
        assert infos.log_ratio is not None  # members are MPPI
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
                uncertainties=plans.uncertainties,
                effective_sample_sizes=infos.effective_sample_size,
                shares=fused.shares,
                diversity=diversity(first / self.members.half_range),
                is_replaced=fused.is_replaced,
            ),
            log_ratio=infos.log_ratio.reshape(-1),
        )

    def _common_objective(
        self,
        state: PortfolioState,
        spread: Float[Array, " O"],
        observation: StateVector,
        belief: Any,
    ) -> CommonObjective:
        """Return the common objective, which is made of the objectives that all members share."""
        # An objective that differs between members cannot compare their plans.
        pairs = zip(self.objective_names, self.members.shared, strict=True)
        objectives = {name: cost for name, cost in pairs if cost is not None}
        shared = np.flatnonzero([cost is not None for cost in self.members.shared])
        return CommonObjective(
            self.members.mppi.dynamics,
            self.members.mppi.cost,
            objectives,
            (self.common / self.members.normalisation.scale(spread))[shared],
            self.members.mppi.dt,
            observation,
            belief,
            state.members.applied[0],
        )

    def _common_weights(self, common: Vector | Mapping[str, float] | None) -> Float[Array, " O"]:
        """Return the weights of the common objective (O,), which add up to 1."""
        is_shared = np.asarray([cost is not None for cost in self.members.shared], np.float32)
        if common is None:
            # Without a shared objective the weights stay 0, and plans compare by J_hard alone.
            mean = self.members.weights.mean(axis=0) * is_shared
            return mean / jnp.maximum(jnp.sum(mean), 1e-6)
        given, _ = normalise_weights(
            [values_in_order(common, self.objective_names)], None, self.objective_names, "common"
        )
        if (np.asarray(given[0]) * (1.0 - is_shared) > 0.0).any():
            raise ValueError(
                f"common is {common!r}, with an objective that differs between members; accepted: "
                "weights of objectives that all share"
            )
        return given[0]


def diversity(controls: Float[Array, "N nu"]) -> Scalar:
    """Compute the mean distance between two members' controls; 0 for a single member.

    The distance is the root mean square over the nu components.

    Args:
        controls: (N, nu) control of each member, in units that make components comparable.
    """
    number = controls.shape[0]
    if number < 2:
        return jnp.zeros(())
    first, second = np.triu_indices(number, 1)
    away = controls[first] - controls[second]
    square = jnp.mean(away * away, axis=1)
    # The derivative of the root at 0 is infinite: equal rows must not pass through it.
    is_equal = square <= 0.0
    return jnp.mean(jnp.where(is_equal, 0.0, jnp.sqrt(jnp.where(is_equal, 1.0, square))))
