"""The members of a portfolio: what they share, what each has of its own, what they propose."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float

from jaxplore import _checks
from jaxplore._types import ControlVector, Key, Rows, Scalar, StateVector, Vector
from jaxplore.control.base import Info
from jaxplore.control.draft import MPPIState
from jaxplore.control.mppi import MPPI
from jaxplore.control.proposals import GaussianProposal
from jaxplore.control.rollout import rollout_objectives
from jaxplore.control.weighting import Softmax
from jaxplore.costs.base import Cost
from jaxplore.planning.portfolio._members import named_row, one_each, stacked, weight_rows
from jaxplore.planning.portfolio.fusion import Sequences
from jaxplore.planning.portfolio.normalisation import FLOOR, Normalisation

MEMBERS = "members"
"""Name of the axis over which members are mapped."""


class Proposed(NamedTuple):
    """What the members propose; arrays have a leading axis of N.

    Args:
        states: of the members after their step.
        infos: what each says about it.
        plans: (N, T, nu) on the template's time grid.
        uncertainties: (N,) spread of the weighted samples, in half ranges; infinite of a member
            without a finite rollout.
    """

    states: MPPIState
    infos: Info
    plans: Sequences
    uncertainties: Float[Array, " N"]


class Team(eqx.Module):
    """N MPPI controllers that weigh the same objectives differently: see `Portfolio`.

    Args:
        mppi: as of `Portfolio`, and so are the others.
    """

    mppi: MPPI
    shared: tuple[Cost | None, ...]
    own: tuple[Cost | None, ...]
    weights: Float[Array, "N O"]
    normalisation: Normalisation
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
        names: Sequence[str] | None,
        temperatures: Vector | None,
        noise_scales: Vector | None,
        horizons: Vector | None,
        floors: Vector | Mapping[str, float] | None,
        is_normalised: bool,
        smoothing_time: ArrayLike,
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
        least = named_row(floors, self.objective_names, FLOOR)
        given = one_each("floors", least, len(self.objective_names))
        self.normalisation = Normalisation(
            jnp.full(len(self.objective_names), FLOOR) if given is None else given,
            _checks.scalar("smoothing_time", smoothing_time, above=0.0),
            is_normalised,
        )
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

    def init(self) -> MPPIState:
        """Return the members' states before the first step."""
        states: MPPIState = jax.vmap(lambda index: self.member(index).init())(self.indices)
        return states

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

    def objectives(self, index: int) -> tuple[Cost, ...]:
        """Return the objectives of one member."""
        own = jax.tree.map(lambda leaves: leaves[index], self.own)
        return _merged(self.shared, own)

    def propose(
        self,
        states: MPPIState,
        spread: Float[Array, " O"],
        observation: StateVector,
        belief: Any,
        *,
        key: Key,
    ) -> tuple[Proposed, Float[Array, " O"]]:
        """Return what the members propose, and the spread of the objectives brought up to date.

        Args:
            states: of the members.
            spread: (O,) of the objectives before; 0 before the first step.
            observation: (nx,) the robot's state.
            belief: what the robot knows.
            key: randomness; the same for all members.
        """

        def one(
            index: Array, own: tuple[Cost | None, ...], weights: Array, member_state: MPPIState
        ) -> tuple[Proposed, Array]:
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
            now = self.normalisation.updated(
                spread, values, hard, self.mppi.control_period, MEMBERS
            )
            values = values / self.normalisation.scale(now)[:, None]
            # What has no weight may be anything, also no number.
            values = jnp.where(weights[:, None] > 0.0, values, 0.0)
            costs = hard + jnp.einsum("o,ok->k", weights, values)
            _, after, info = member.conclude(draft, costs)
            uncertainty = self._uncertainty(draft.controls, info)
            uncertainty = jnp.where(info.is_finite, uncertainty, jnp.inf)
            return Proposed(after, info, info.controls, uncertainty), now

        proposed, spreads = jax.vmap(one, axis_name=MEMBERS)(
            self.indices, self.own, self.weights, states
        )
        return proposed._replace(plans=self._on_one_grid(proposed.plans)), spreads[0]

    def _uncertainty(self, controls: Float[Array, "T nu K"], info: Info) -> Scalar:
        """Return the spread of the weighted samples over the plan, in half ranges."""
        mean = jnp.einsum("k,tuk->tu", info.weights, controls)
        away = controls - mean[:, :, None]
        variance = jnp.einsum("k,tuk->tu", info.weights, away * away)
        return jnp.sqrt(jnp.mean(variance / self.half_range**2))

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

    @property
    def half_range(self) -> ControlVector:
        """Half the range of each control (nu,); 1 of one that is fixed."""
        model = self.mppi.dynamics
        half = model.control_half_range
        return jnp.where(half > 0.0, half, 1.0)

    @property
    def indices(self) -> Array:
        """(N,) of the members."""
        return jnp.arange(len(self.names))


def _merged(shared: tuple[Cost | None, ...], own: tuple[Cost | None, ...]) -> tuple[Cost, ...]:
    pairs = zip(shared, own, strict=True)
    return tuple(one if one is not None else other for one, other in pairs)  # type: ignore[misc]


def _temperature(mppi: MPPI) -> Any:
    weighting: Any = mppi.weighting
    return weighting.temperature


def _noise_std(mppi: MPPI) -> Any:
    proposal: Any = mppi.proposal
    return proposal.noise_std
