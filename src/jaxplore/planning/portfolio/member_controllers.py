"""The members of a portfolio: MPPI controllers that run in one `vmap`.

Each objective is divided by its spread, so that the weights of members are comparable.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, ControlVector, Key, Rows, Scalar, StateVector, Vector
from jaxplore.control.base import Info
from jaxplore.control.mppi import MPPI, MPPIState
from jaxplore.control.proposals import GaussianProposal
from jaxplore.control.rollout import rollout_objectives
from jaxplore.control.weighting import Softmax
from jaxplore.costs.base import Cost
from jaxplore.planning.portfolio._members import (
    normalise_weights,
    positive_each,
    stack_costs,
    values_in_order,
)
from jaxplore.planning.portfolio.fusion import Sequences

FLOOR = 1e-3
"""Default lower bound of the spread that an objective is divided by."""
MEMBERS = "members"
"""Name of the axis over which members are mapped."""


class Normalisation(eqx.Module):
    """Scale of each objective: its mean absolute deviation among rollouts, smoothed over time.

        s_o = max(floor_o, spread_o),   spread_o = mean of |J_o - mean J_o|

    `smoothing_time` is the time constant [s]. All scales are 1 unless `is_on`.
    """

    floors: Float[Array, " O"]
    smoothing_time: Scalar
    is_on: bool = eqx.field(static=True)

    def scale(self, spread: Float[Array, " O"]) -> Float[Array, " O"]:
        """Return the divisors (O,) of objectives with this spread (O,)."""
        return jnp.maximum(spread, self.floors) if self.is_on else jnp.ones_like(spread)

    def update(
        self,
        spread: Float[Array, " O"],
        values: Float[Array, "O K"],
        hard: Float[Array, " K"],
        elapsed: Scalar,
        axis: str,
    ) -> Float[Array, " O"]:
        """Update the spread of the objectives with the rollouts of a step.

            spread <- spread + (1 - exp(-elapsed / smoothing_time)) (new - spread)

        The first new one is taken unsmoothed; one that is 0 or not finite is ignored. `values` are
        the objectives of this member's rollouts, `hard` their hard costs, and `axis` the mapped
        axis of members.
        """
        # Rollouts that collide do not count, as long as others are left: the depth of a collision
        # would hide the differences between the rollouts that may be chosen.
        is_free = hard <= 0.0
        num_free = jax.lax.psum(  # type: ignore[no-untyped-call]
            jnp.sum(is_free, dtype=jnp.float32), axis
        )
        is_counted = jnp.isfinite(values) & (is_free | (num_free == 0.0))
        count = jnp.sum(is_counted, axis=1, dtype=jnp.float32)
        kept = jnp.where(is_counted, values, 0.0)
        # Each member is compared with its own mean, since a longer horizon costs more.
        mean = (jnp.sum(kept, axis=1) / jnp.maximum(count, 1.0))[:, None]
        away = jnp.sum(jnp.where(is_counted, jnp.abs(values - mean), 0.0), axis=1)
        total, number = jax.lax.psum((away, count), axis)  # type: ignore[no-untyped-call]
        now: Array = total / jnp.maximum(number, 1.0)
        # Exponential smoothing for any control period: the share of a step grows with its length.
        share = -jnp.expm1(-elapsed / self.smoothing_time)
        after = jnp.where(spread > 0.0, spread + share * (now - spread), now)
        return jnp.where((now > 0.0) & jnp.isfinite(now), after, spread)


class MemberPlans(NamedTuple):
    """Plans of the N members in one step, along leading axes of N: the states after it, the
    controls (T, nu) on the time grid of the template, and the spreads of the weighted samples, in
    half ranges of the controls; infinite for a member without a finite rollout."""

    states: MPPIState
    infos: Info
    controls: Sequences
    uncertainties: Float[Array, " N"]


class MemberControllers(eqx.Module):
    """N MPPI controllers with different weights of the same objectives.

    See `Portfolio` for the arguments and errors.
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
        self.weights, self.names = normalise_weights(weights, names, self.objective_names)
        number = len(self.names)
        # Objectives that differ are stacked and mapped with the members; the others are not copied.
        self.shared = tuple(
            cost if isinstance(cost, Cost) else None for cost in objectives.values()
        )
        self.own = tuple(
            None if isinstance(cost, Cost) else stack_costs(name, cost, number)
            for name, cost in objectives.items()
        )
        least = values_in_order(floors, self.objective_names, FLOOR)
        given = positive_each("floors", least, len(self.objective_names))
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
        self.temperatures = positive_each("temperatures", temperatures, number)
        self.noise_scales = positive_each("noise_scales", noise_scales, number)
        self.horizons = positive_each("horizons", horizons, number)

    def init(self) -> MPPIState:
        """Return the initial states of the members."""
        states: MPPIState = jax.vmap(lambda index: self.member(index).init())(self.indices)
        return states

    def member(self, index: int | Array) -> MPPI:
        """Return a member as an MPPI controller with J_hard as its cost; `index` may be traced."""
        member = self.mppi
        if self.temperatures is not None:
            member = eqx.tree_at(_temperature, member, self.temperatures[index])
        if self.noise_scales is not None:
            std = _noise_std(member) * self.noise_scales[index]
            member = eqx.tree_at(_noise_std, member, std)
        if self.horizons is not None:
            # The number of steps is a shape and must be equal in all members; their length is not.
            dt = self.horizons[index] / member.horizon
            member = eqx.tree_at(lambda mppi: mppi.dt, member, dt)
        return member

    def objectives(self, index: int) -> tuple[Cost, ...]:
        """Return the objectives of one member, in the order of their names."""
        own = jax.tree.map(lambda leaves: leaves[index], self.own)
        return _merge(self.shared, own)

    def plan(
        self,
        states: MPPIState,
        spread: Float[Array, " O"],
        observation: StateVector,
        belief: Any,
        *,
        key: Key,
    ) -> tuple[MemberPlans, Float[Array, " O"]]:
        """Plan with all members; return their plans and the updated spread of the objectives (O,).

        `spread` is the one before; 0 before the first step. All members share the random key.
        """

        def one(
            index: Array, own: tuple[Cost | None, ...], weights: Array, member_state: MPPIState
        ) -> tuple[MemberPlans, Array]:
            member = self.member(index)
            # One rollout gives all objectives, so that they can be weighted after normalisation.
            sampled = member.sample(member_state, key=key)
            paid = rollout_objectives(
                member.dynamics,
                (member.cost, *_merge(self.shared, own)),
                observation,
                sampled.controls,
                member.dt,
                belief,
                applied=member_state.applied,
            )
            hard, values = paid[0], paid[1:]
            now = self.normalisation.update(spread, values, hard, self.mppi.control_period, MEMBERS)
            values = values / self.normalisation.scale(now)[:, None]
            # An objective without weight may be infinite or NaN, and 0 times that is NaN.
            values = jnp.where(weights[:, None] > 0.0, values, 0.0)
            costs = hard + jnp.einsum("o,ok->k", weights, values)
            _, after, info = member.update(sampled, costs)
            uncertainty = self._uncertainty(sampled.controls, info)
            uncertainty = jnp.where(info.is_finite, uncertainty, jnp.inf)
            return MemberPlans(after, info, info.controls, uncertainty), now

        # All members draw the same noise from the same key, so that their plans differ by their
        # objectives and not by chance. The spread is a sum over members, equal in all of them.
        plans, spreads = jax.vmap(one, axis_name=MEMBERS)(
            self.indices, self.own, self.weights, states
        )
        return plans._replace(controls=self._on_one_grid(plans.controls)), spreads[0]

    def _uncertainty(self, controls: Float[Array, "T nu K"], info: Info) -> Scalar:
        """Compute the standard deviation of the weighted samples over the plan, in half ranges."""
        # Around the mean of the samples, not around the plan, which may be smoothed.
        mean = jnp.einsum("k,tuk->tu", info.weights, controls)
        away = controls - mean[:, :, None]
        variance = jnp.einsum("k,tuk->tu", info.weights, away * away)
        return jnp.sqrt(jnp.mean(variance / self.half_range**2))

    def _on_one_grid(self, controls: Sequences) -> Sequences:
        """Resample plans on the time grid of the template, holding each control for its step."""
        if self.horizons is None:
            return controls
        horizon, dt = self.mppi.horizon, self.mppi.dt
        default = jnp.broadcast_to(self.mppi.dynamics.default_control, controls.shape[2:])
        begin = dt * jnp.arange(horizon, dtype=jnp.float32)

        def hold(plan: Array, length: Array) -> Array:
            # Rounding may put a step that begins with one of the member's just before it.
            row = jnp.floor(begin * (horizon / length) + 1e-3).astype(jnp.int32)
            is_planned = (row < horizon)[:, None]
            return jnp.where(is_planned, plan[jnp.minimum(row, horizon - 1)], default)

        return jax.vmap(hold)(controls, self.horizons)

    @property
    def half_range(self) -> ControlVector:
        """Half range of each control (nu,); 1 for a control with equal bounds."""
        half = self.mppi.dynamics.control_half_range
        return jnp.where(half > 0.0, half, 1.0)

    @property
    def indices(self) -> Array:
        """Indices of the members (N,)."""
        return jnp.arange(len(self.names))


def _merge(shared: tuple[Cost | None, ...], own: tuple[Cost | None, ...]) -> tuple[Cost, ...]:
    """Return for each objective the shared cost, or the member's own where there is none."""
    pairs = zip(shared, own, strict=True)
    return tuple(one if one is not None else other for one, other in pairs)  # type: ignore[misc]


def _temperature(mppi: MPPI) -> Any:
    """Return the leaf of the temperature, for `eqx.tree_at`."""
    weighting: Any = mppi.weighting
    return weighting.temperature


def _noise_std(mppi: MPPI) -> Any:
    """Return the leaf of the noise's standard deviation, for `eqx.tree_at`."""
    proposal: Any = mppi.proposal
    return proposal.noise_std
