"""Informative MPPI: a slow strategic layer and fast MPPI in one controller."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ControlVector, Count, Key, Scalar, StateVector
from jaxplore.belief.belief import Belief, StrategicBelief
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.draft import MPPIState
from jaxplore.control.mixtures import BiasedProposal
from jaxplore.control.mppi import MPPI
from jaxplore.information.field_sensor import FieldSensor
from jaxplore.information.gain import CellSensor
from jaxplore.information.heading_field import HeadingField
from jaxplore.information.local_field import LocalFieldSensor
from jaxplore.maps.field import ScalarField
from jaxplore.planning.strategy.follower import Follower
from jaxplore.planning.strategy.references import StrategicReference


class Strategy(NamedTuple):
    """What the strategic layer found when it ran last.

    Args:
        potential: information of a scan around the robot, by heading [nat].
        best: its greatest value over headings [nat].
        reference: (T, 3) positions to be at [m].
    """

    potential: HeadingField
    best: ScalarField
    reference: Float[Array, "T 3"]


class InformativeState(NamedTuple):
    """What the controller remembers.

    Args:
        mppi: of MPPI.
        strategy: of the strategic layer; meaningless before the first step.
        age: commands given since that strategy was made; as many as are given between strategies
            when the next one is due.
    """

    mppi: MPPIState
    strategy: Strategy
    age: Count


class ShortRangeField(eqx.Module):
    """The information of a short look from everywhere around the robot, by heading.

    The quadrotor design notes cast it for every sample (Uniform-FSMI, 6 beams of 2.5 m). A map
    holds it: beams in all directions from every other cell, once per command. Like any
    `InformationField` it is an integral over the view: beams on its edges count half.

    Args:
        sensor: the beams; its field of view is that of a look.
        num_nodes: nodes on a side of the window; static.
        num_headings: headings for which looks are kept; static.
    """

    sensor: FieldSensor
    num_nodes: int = eqx.field(static=True)
    num_headings: int = eqx.field(static=True)

    def __call__(self, belief: Belief, model: CellSensor, position: Array) -> HeadingField:
        """Return the field around a position [nat]."""
        window = self.sensor.window(belief.grid, model, position, (self.num_nodes, self.num_nodes))
        return window.at_headings(self.num_headings)


class InformativeMPPI(Controller):
    """Both architectures of informative MPPI: strategy at 5 Hz, reaction at every command.

    Every n-th command the strategic layer computes the information field around the robot, and
    with a `reference` a path that climbs it: the two-layer architecture. MPPI samples part of its
    rollouts around the controls that follow this path. Without a `reference` MPPI reads the field
    alone: the parallel architecture. In between the last strategy is kept.

    Both fields fade where the robot stays (`Belief.pull`), as guidance does. Once all worthwhile is
    explored (`Belief.is_explored`) they are zero: only guidance and goal count then.

    Costs read a `StrategicBelief`: the robot's own belief, the `potential`, the `local`
    information of a short look, and the reference.

    Args:
        mppi: the reactive layer; its proposal is biased, if at all, by the reference.
        potential_sensor: the strategic layer's field.
        lookout: the field of short looks.
        sensor_model: what a measurement does to a cell.
        reference: where the robot is sent; the parallel architecture when absent.
        follower: turns the reference into controls, for a `BiasedProposal`.
        strategy_period: time between strategies [s]; whole control periods.
        altitude: z of the reference [m].

    Raises:
        ValueError: a strategy period that is not a whole number of control periods; a biased
            proposal without reference and follower, or the other way round.
    """

    mppi: MPPI
    potential_sensor: LocalFieldSensor
    lookout: ShortRangeField
    sensor_model: CellSensor
    reference: StrategicReference | None
    follower: Follower | None
    strategy_period: Scalar
    altitude: Scalar

    def __init__(
        self,
        mppi: MPPI,
        potential_sensor: LocalFieldSensor,
        lookout: ShortRangeField,
        sensor_model: CellSensor,
        *,
        reference: StrategicReference | None = None,
        follower: Follower | None = None,
        strategy_period: ArrayLike = 0.2,
        altitude: ArrayLike = 0.0,
    ) -> None:
        is_biased = isinstance(mppi.proposal, BiasedProposal)
        if is_biased != (follower is not None) or (is_biased and reference is None):
            raise ValueError(
                f"proposal is {type(mppi.proposal).__name__} with follower {follower!r} and "
                f"reference {reference!r}; accepted: a BiasedProposal with both, or another "
                "proposal without a follower"
            )
        self.mppi = mppi
        self.potential_sensor = potential_sensor
        self.lookout = lookout
        self.sensor_model = sensor_model
        self.reference = reference
        self.follower = follower
        self.strategy_period = _checks.scalar("strategy_period", strategy_period, above=0.0)
        self.altitude = _checks.scalar("altitude", altitude)
        if not _checks.is_traced(self.strategy_period, mppi.control_period):
            ratio = float(self.strategy_period) / float(mppi.control_period)
            if abs(ratio - round(ratio)) > 1e-3 * ratio or round(ratio) < 1:
                raise ValueError(
                    f"strategy_period is {float(self.strategy_period):g} s; accepted: a whole "
                    f"number of control periods of {float(mppi.control_period):g} s"
                )

    def init(self) -> InformativeState:
        """Return the state before the first step."""
        count = 1 if self.reference is None else self.reference.walk.num_steps
        potential = self.potential_sensor.empty()
        strategy = Strategy(potential, potential.best, jnp.zeros((count, 3)))
        return InformativeState(self.mppi.init(), strategy, self._commands_per_strategy)

    def at_period(self, control_period: ArrayLike) -> "InformativeMPPI":
        """Return this controller for commands that are `control_period` seconds apart."""
        return InformativeMPPI(
            self.mppi.at_period(control_period),
            self.potential_sensor,
            self.lookout,
            self.sensor_model,
            reference=self.reference,
            follower=self.follower,
            strategy_period=self.strategy_period,
            altitude=self.altitude,
        )

    def step(
        self,
        state: InformativeState,
        observation: StateVector,
        belief: Belief | None = None,
        *,
        key: Key,
    ) -> tuple[ControlVector, InformativeState, Info]:
        """Plan once: renew the strategy if it is due, then MPPI.

        Args:
            state: from `init` or the last step.
            observation: (nx,) the robot's state.
            belief: what the robot knows.
            key: randomness.
        """
        mppi, known, strategy, age = self._prepare(state, observation, belief)
        control, inner, info = mppi.step(state.mppi, observation, known, key=key)
        return control, InformativeState(inner, strategy, age + 1), info

    def inspect(
        self,
        state: InformativeState,
        observation: StateVector,
        belief: Belief | None = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return what `step` sees with the same arguments: trajectories, and the cost by term."""
        mppi, known, _, _ = self._prepare(state, observation, belief)
        plan = mppi.inspect(
            state.mppi, observation, known, key=key, num_trajectories=num_trajectories
        )
        return plan if self.reference is None else plan._replace(reference=known.reference)

    def strategy(self, belief: Belief, observation: StateVector) -> Strategy:
        """Return what the strategic layer makes of a belief, for a robot at a state."""
        position = self.mppi.dynamics.position(observation)
        field = self.potential_sensor.field(belief.grid, position)
        potential = self._remaining(field, belief)
        best = potential.best
        if self.reference is None:
            return Strategy(potential, best, jnp.zeros((1, 3)))
        start = jnp.append(position, self.altitude)
        return Strategy(potential, best, self.reference(belief, best, start))

    def _prepare(
        self, state: InformativeState, observation: StateVector, belief: Belief | None
    ) -> tuple[MPPI, StrategicBelief, Strategy, Count]:
        """Return the reactive layer, what its costs read, the strategy and its age."""
        if belief is None:
            raise ValueError("belief is None; accepted: a Belief, which this controller plans on")
        mppi = self.mppi
        # A robot that does not know where it is keeps its strategy until it knows.
        is_placed = jnp.isfinite(mppi.dynamics.position(observation)).all()
        is_due = (state.age >= self._commands_per_strategy) & is_placed
        strategy: Strategy = jax.lax.cond(
            is_due,
            lambda: self.strategy(belief, observation),
            lambda: state.strategy,
        )
        age = jnp.where(is_due, 0, state.age)
        period = jnp.ones(()) if self.reference is None else self.reference.walk.dt
        known = StrategicBelief(
            **{part.name: getattr(belief, part.name) for part in dataclasses.fields(Belief)},
            potential=strategy.potential,
            best=strategy.best,
            local=self._local(belief, observation),
            reference=strategy.reference,
            reference_period=period,
            reference_age=age.astype(jnp.float32) * mppi.control_period,
        )
        if self.follower is not None:
            times = mppi.dt * jnp.arange(1, mppi.horizon + 1, dtype=jnp.float32)
            wanted = jax.vmap(known.reference_at)(times)
            controls = self.follower(mppi.dynamics, observation, wanted, mppi.dt)
            mppi = eqx.tree_at(_bias, mppi, controls)
        return mppi, known, strategy, age

    @property
    def _commands_per_strategy(self) -> Count:
        return jnp.round(self.strategy_period / self.mppi.control_period).astype(jnp.int32)

    def _local(self, belief: Belief, observation: StateVector) -> HeadingField:
        position = self.mppi.dynamics.position(observation)
        return self._remaining(self.lookout(belief, self.sensor_model, position), belief)

    def _remaining(self, field: HeadingField, belief: Belief) -> HeadingField:
        """Return what is still worth going for of a field.

        Nothing once all is explored; less where the robot has been for long, or it would stay at a
        top of the field of which scans take nothing away.
        """
        rows, columns = jnp.mgrid[: field.values.shape[0], : field.values.shape[1]]
        nodes = field.frame.cell_centre(jnp.stack([rows, columns], axis=-1).reshape(-1, 2))
        share = jax.vmap(belief.pull)(nodes).reshape(rows.shape)
        share = jnp.where(belief.is_explored, 0.0, share)
        return HeadingField(share[..., None] * field.values, field.frame)


def _bias(mppi: MPPI) -> Any:
    proposal: Any = mppi.proposal
    return proposal.reference
