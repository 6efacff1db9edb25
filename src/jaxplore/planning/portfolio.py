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
from jaxplore.control.mppi import MPPI, MPPIState
from jaxplore.control.proposals import GaussianProposal
from jaxplore.control.rollout import rollout_objectives
from jaxplore.control.weighting import Softmax
from jaxplore.costs.base import Cost, SumCost, WeightedCost
from jaxplore.dynamics.base import State
from jaxplore.planning._members import named_row, one_each, stacked, weight_rows
from jaxplore.planning.fusion import Candidates, Fused, Fusion, Sequences, Situation
from jaxplore.planning.judge import Judge
from jaxplore.planning.normalisation import FLOOR, Normalisation
from jaxplore.planning.safe_fusion import SafeFusion, fusion_by_name

MEMBERS = "members"
"""Name of the axis over which members are mapped."""


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


class _Proposed(NamedTuple):
    """What the members propose; arrays have a leading axis of N."""

    states: MPPIState
    infos: Info
    uncertainties: Float[Array, " N"]


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

    mppi: MPPI
    shared: tuple[Cost | None, ...]
    own: tuple[Cost | None, ...]
    weights: Float[Array, "N O"]
    common: Float[Array, " O"]
    normalisation: Normalisation
    fusion: Fusion
    temperatures: Float[Array, " N"] | None
    noise_scales: Float[Array, " N"] | None
    horizons: Float[Array, " N"] | None
    names: tuple[str, ...] = eqx.field(static=True)
    objective_names: tuple[str, ...] = eqx.field(static=True)

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
        if not objectives:
            raise ValueError("objectives is empty; accepted: at least one cost by its name")
        for part in ("disturbance", "mesh"):
            if getattr(mppi, part) is not None:
                raise ValueError(
                    f"{part} of mppi is {getattr(mppi, part)!r}; accepted: None, members roll out "
                    "one outcome on one device"
                )
        self.mppi = mppi
        self.objective_names = tuple(objectives)
        self.weights, self.names = weight_rows(weights, names, self.objective_names)
        number = len(self.names)
        self.shared = tuple(
            cost if isinstance(cost, Cost) else None for cost in objectives.values()
        )
        self.own = tuple(
            None if isinstance(cost, Cost) else stacked(name, cost, number)
            for name, cost in objectives.items()
        )
        self.common = self._common(common)
        least = named_row(floors, self.objective_names, FLOOR)
        given = one_each("floors", least, len(self.objective_names))
        self.normalisation = Normalisation(
            jnp.full(len(self.objective_names), FLOOR) if given is None else given,
            _checks.scalar("smoothing_time", smoothing_time, above=0.0),
            is_normalised,
        )
        if fusion is None or isinstance(fusion, str):
            fusion = SafeFusion() if fusion is None else fusion_by_name(fusion)
        fusion.check(self.names)
        self.fusion = fusion
        if temperatures is not None and not isinstance(mppi.weighting, Softmax):
            raise ValueError(
                f"temperatures is {temperatures!r} beside {type(mppi.weighting).__name__}; "
                "accepted: with a Softmax"
            )
        proposal = mppi.proposal
        has_std = isinstance(proposal, GaussianProposal) and proposal.noise_std is not None
        if noise_scales is not None and not has_std:
            raise ValueError(
                f"noise_scales is {noise_scales!r} beside {type(proposal).__name__}; accepted: "
                "with a GaussianProposal that has a noise_std"
            )
        self.temperatures = one_each("temperatures", temperatures, number)
        self.noise_scales = one_each("noise_scales", noise_scales, number)
        self.horizons = one_each("horizons", horizons, number)

    @property
    def member_names(self) -> tuple[str, ...]:
        """Names of the members."""
        return self.names

    def init(self) -> PortfolioState:
        """Return the state before the first step."""
        states = jax.vmap(lambda index: self.member(index).init())(self._indices)
        return PortfolioState(states, jnp.zeros(len(self.objective_names)), self.fusion.init())

    def at_period(self, control_period: ArrayLike) -> "Portfolio":
        """Return this controller for commands that are `control_period` seconds apart."""
        same: Portfolio = eqx.tree_at(
            lambda portfolio: portfolio.mppi, self, self.mppi.at_period(control_period)
        )
        return same

    def member(self, index: int | Array) -> MPPI:
        """Return a member as MPPI of its own; its cost is what all members pay alike.

        Args:
            index: which.
        """
        member = self.mppi
        if self.temperatures is not None:
            member = eqx.tree_at(_temperature, member, self.temperatures[index])
        if self.noise_scales is not None:
            std = _noise_std(member) * self.noise_scales[index]
            member = eqx.tree_at(_noise_std, member, std)
        if self.horizons is not None:
            dt = self.horizons[index] / member.horizon
            member = eqx.tree_at(lambda mppi: mppi.dt, member, dt)
        return member

    def single(self, name: str, spread: Vector | None = None) -> MPPI:
        """Return a member alone: MPPI that minimises the sum of its weighted objectives.

        Args:
            name: of the member.
            spread: (O,) by which objectives are divided; 1 when absent.

        Raises:
            ValueError: an unknown name.
        """
        if name not in self.names:
            raise ValueError(f"name is {name!r}; accepted: {', '.join(self.names)}")
        index, count = self.names.index(name), len(self.objective_names)
        scale = jnp.ones(count) if spread is None else _checks.vector("spread", spread, count)
        member = self.member(index)
        factors = self.weights[index] / scale
        terms = tuple(
            WeightedCost(factors[number], cost.named(label))
            for number, (label, cost) in enumerate(
                zip(self.objective_names, self._objectives(index), strict=True)
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
        proposed, spread = self._propose(state, observation, belief, key)
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
        proposed, spread = self._propose(state, observation, belief, key)
        candidates, fused, _ = self._fuse(state, proposed, spread, observation, belief)
        each = min(max(1, num_trajectories // len(self.names)), self.mppi.num_samples)
        chosen = np.linspace(0, self.mppi.num_samples - 1, each).round().astype(int)
        judge = self._judge(state, spread, observation, belief)

        def look(index: Array, member_state: MPPIState) -> Array:
            member = self.member(index)
            controls = member.draft(member_state, key=key).controls[:, :, chosen]

            def places(plan: Array) -> Array:
                return judge.follow(plan, member.dt).states

            states: Array = jax.vmap(places, in_axes=-1)(controls)
            return states

        samples = jax.vmap(look)(self._indices, state.members)
        weights = proposed.infos.weights[:, chosen] * fused.shares[:, None]
        best = jnp.argmin(jnp.where(jnp.isfinite(candidates.costs), candidates.costs, jnp.inf))
        return SampledPlan(
            nominal=judge.follow(fused.controls),
            best=judge.follow(candidates.controls[best]),
            samples=samples.reshape(-1, *samples.shape[2:]),
            weights=weights.reshape(-1),
        )

    def _propose(
        self, state: PortfolioState, observation: StateVector, belief: Any, key: Key
    ) -> tuple["_Proposed", Float[Array, " O"]]:
        """Return what the members propose, and the spread of the objectives brought up to date."""

        def propose(
            index: Array, own: tuple[Cost | None, ...], weights: Array, member_state: MPPIState
        ) -> tuple[_Proposed, Array]:
            member = self.member(index)
            draft = member.draft(member_state, key=key)
            paid = rollout_objectives(
                member.dynamics,
                (member.cost, *_merged(self.shared, own)),
                observation,
                draft.controls,
                member.dt,
                belief,
                applied=member_state.applied,
            )
            hard, values = paid[0], paid[1:]
            spread = self.normalisation.updated(
                state.spread, values, hard, self.mppi.control_period, MEMBERS
            )
            values = values / self.normalisation.scale(spread)[:, None]
            # What has no weight may be anything, also no number.
            values = jnp.where(weights[:, None] > 0.0, values, 0.0)
            costs = hard + jnp.einsum("o,ok->k", weights, values)
            _, after, info = member.conclude(draft, costs)
            uncertainty = self._uncertainty(draft.controls, info)
            uncertainty = jnp.where(info.is_finite, uncertainty, jnp.inf)
            return _Proposed(after, info, uncertainty), spread

        proposed, spreads = jax.vmap(propose, axis_name=MEMBERS)(
            self._indices, self.own, self.weights, state.members
        )
        return proposed, spreads[0]

    def _uncertainty(self, controls: Float[Array, "T nu K"], info: Info) -> Scalar:
        """Return the spread of the weighted samples over the plan, in half ranges."""
        mean = jnp.einsum("k,tuk->tu", info.weights, controls)
        away = controls - mean[:, :, None]
        variance = jnp.einsum("k,tuk->tu", info.weights, away * away)
        return jnp.sqrt(jnp.mean(variance / self._half_range**2))

    def _fuse(
        self,
        state: PortfolioState,
        proposed: _Proposed,
        spread: Float[Array, " O"],
        observation: StateVector,
        belief: Any,
    ) -> tuple[Candidates, Fused, Any]:
        judge = self._judge(state, spread, observation, belief)
        controls = self._on_one_grid(proposed.infos.controls)
        costs, hazards = judge(controls)
        candidates = Candidates(controls, costs, hazards, proposed.uncertainties)
        situation = Situation(State(observation, self.mppi.dynamics), belief, judge)
        fused, memory = self.fusion(state.fusion, candidates, situation)
        return candidates, fused, memory

    def _on_one_grid(self, controls: Sequences) -> Sequences:
        """Return plans on the template's time grid: each control is held for its member's step."""
        if self.horizons is None:
            return controls
        horizon, dt = self.mppi.horizon, self.mppi.dt
        default = jnp.broadcast_to(self.mppi.dynamics.default_control, controls.shape[2:])
        begin = dt * jnp.arange(horizon, dtype=jnp.float32)

        def held(plan: Array, length: Array) -> Array:
            # A step that begins with one of the member's comes rounded: it is that one.
            row = jnp.floor(begin * (horizon / length) + 1e-3).astype(jnp.int32)
            is_planned = (row < horizon)[:, None]
            return jnp.where(is_planned, plan[jnp.minimum(row, horizon - 1)], default)

        return jax.vmap(held)(controls, self.horizons)

    def _info(self, proposed: _Proposed, candidates: Candidates, fused: Fused) -> Info:
        infos, number = proposed.infos, len(self.names)
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
                diversity=diversity(first / self._half_range),
                is_replaced=fused.is_replaced,
            ),
        )

    def _judge(
        self,
        state: PortfolioState,
        spread: Float[Array, " O"],
        observation: StateVector,
        belief: Any,
    ) -> Judge:
        """Return the common objective, of what all members share."""
        pairs = zip(self.objective_names, self.shared, strict=True)
        judged = {name: cost for name, cost in pairs if cost is not None}
        shared = np.flatnonzero([cost is not None for cost in self.shared])
        return Judge(
            self.mppi.dynamics,
            self.mppi.cost,
            judged,
            (self.common / self.normalisation.scale(spread))[shared],
            self.mppi.dt,
            observation,
            belief,
            state.members.applied[0],
        )

    def _objectives(self, index: int) -> tuple[Cost, ...]:
        """Return the objectives of one member."""
        own = jax.tree.map(lambda leaves: leaves[index], self.own)
        return _merged(self.shared, own)

    def _common(self, common: Vector | Mapping[str, float] | None) -> Float[Array, " O"]:
        is_shared = np.asarray([cost is not None for cost in self.shared], np.float32)
        if common is None:
            mean = self.weights.mean(axis=0) * is_shared
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

    @property
    def _half_range(self) -> ControlVector:
        model = self.mppi.dynamics
        half = 0.5 * (model.control_max - model.control_min)
        return jnp.where(half > 0.0, half, 1.0)

    @property
    def _indices(self) -> Array:
        return jnp.arange(len(self.names))


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


def _merged(shared: tuple[Cost | None, ...], own: tuple[Cost | None, ...]) -> tuple[Cost, ...]:
    pairs = zip(shared, own, strict=True)
    return tuple(one if one is not None else other for one, other in pairs)  # type: ignore[misc]


def _temperature(mppi: MPPI) -> Any:
    weighting: Any = mppi.weighting
    return weighting.temperature


def _noise_std(mppi: MPPI) -> Any:
    proposal: Any = mppi.proposal
    return proposal.noise_std
