"""Informative MPPI: a slow strategic layer and a fast MPPI layer in one controller."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_DIRECTIONS
from jaxplore._types import ArrayLike, ControlVector, Count, Key, Scalar, StateVector
from jaxplore.belief.belief import Belief, StrategicBelief
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.mixtures import BiasedProposal
from jaxplore.control.model_checks import checked_call
from jaxplore.control.mppi import MPPI
from jaxplore.control.mppi_state import MPPIState
from jaxplore.information.field_sensor import FieldSensor
from jaxplore.information.gain import CellSensor, IdealSensor
from jaxplore.information.heading_field import HeadingField
from jaxplore.information.local_field import LocalFieldSensor
from jaxplore.maps.field import ScalarField
from jaxplore.planning.strategy.follower import Follower
from jaxplore.planning.strategy.references import ReferenceStart, StrategicReference
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel


class StrategicPlan(NamedTuple):
    """Result of the strategic layer.

    Args:
        potential: information of a scan at each place around the robot, by heading [nat].
        best: greatest value of `potential` over headings [nat].
        reference: (T, 3) positions (x, y, z) for the robot to follow [m].
    """

    potential: HeadingField
    best: ScalarField
    reference: Float[Array, "T 3"]


class InformativeState(NamedTuple):
    """State of informative MPPI.

    Args:
        mppi: state of the MPPI layer.
        plan: last result of the strategic layer; meaningless before the first step.
        age: number of commands since that result. The strategic layer runs again when it reaches
            the number of commands per strategy period.
    """

    mppi: MPPIState
    plan: StrategicPlan
    age: Count


class ShortRangeField(eqx.Module):
    """Information of a short-range scan at each place around the robot, by heading.

    The quadrotor design notes cast the beams for every sample (Uniform-FSMI, 6 beams of 2.5 m).
    Here a field is computed once per command, with beams in all directions from every node, and
    the samples read it. Like any `InformationField` it integrates over the field of view, so beams
    on its edges count half.

    Args:
        sensor: sensor that casts the beams; it sets the field of view of a scan.
        num_nodes: number of nodes on a side of the window around the robot; static.
        num_headings: number of headings for which scans are kept; static.
    """

    sensor: FieldSensor
    num_nodes: int = eqx.field(static=True)
    num_headings: int = eqx.field(static=True)

    def __check_init__(self) -> None:
        _kinds.instance("sensor", self.sensor, FieldSensor)
        _checks.positive_int("num_nodes", self.num_nodes)
        _checks.positive_int("num_headings", self.num_headings, at_most=MOST_DIRECTIONS)

    def __call__(self, belief: Belief, model: CellSensor, position: Array) -> HeadingField:
        """Compute the field around a position [nat]."""
        window = self.sensor.window(belief.grid, model, position, (self.num_nodes, self.num_nodes))
        return window.at_headings(self.num_headings)


class InformativeMPPI(Controller):
    """Informative MPPI in two architectures: strategy at 5 Hz, MPPI at every command.

    At every n-th command the strategic layer computes the information field around the robot. In
    the two-layer architecture, with a `reference`, it also computes positions that ascend this
    field, and MPPI draws a share of its samples around the controls that follow them. In the
    parallel architecture, without a `reference`, MPPI only reads the field. Between two runs of the
    strategic layer its last result is kept.

    The fields are discounted where the robot has stayed (`Belief.pull`), as guidance is. Once
    everything worthwhile is explored (`Belief.is_explored`) they are zero, so that only guidance
    and goal count.

    Costs read a `StrategicBelief`: the belief of the robot, the fields `potential` and `local`, and
    the reference.

    Args:
        mppi: MPPI layer. If its proposal is a `BiasedProposal`, it is biased by the reference.
        potential_sensor: sensor of the information field of the strategic layer.
        short_range_field: field of short-range scans, computed at every command.
        sensor_model: effect of a measurement on a map cell.
        reference: rule that makes the reference; the parallel architecture when absent.
        follower: follower that turns the reference into controls, for a `BiasedProposal`.
        strategy_period: time between runs of the strategic layer [s]; a multiple of the control
            period.
        altitude: z of the reference [m].

    Raises:
        ValueError: a strategy period that is not a whole number of control periods; a biased
            proposal without reference and follower, or the other way round.
    """

    mppi: MPPI
    potential_sensor: LocalFieldSensor
    short_range_field: ShortRangeField
    sensor_model: CellSensor
    reference: StrategicReference | None
    follower: Follower | None
    strategy_period: Scalar
    altitude: Scalar

    def __init__(
        self,
        mppi: MPPI,
        potential_sensor: LocalFieldSensor,
        short_range_field: ShortRangeField,
        sensor_model: CellSensor,
        *,
        reference: StrategicReference | None = None,
        follower: Follower | None = None,
        strategy_period: ArrayLike = 0.2,
        altitude: ArrayLike = 0.0,
    ) -> None:
        _kinds.instance("mppi", mppi, MPPI)
        _kinds.instance("potential_sensor", potential_sensor, LocalFieldSensor)
        _kinds.instance("short_range_field", short_range_field, ShortRangeField)
        _kinds.instance("sensor_model", sensor_model, InverseSensorModel, IdealSensor)
        _kinds.instance("reference", reference, StrategicReference, may_be_none=True)
        _kinds.instance("follower", follower, Follower, may_be_none=True)
        is_biased = isinstance(mppi.proposal, BiasedProposal)
        if is_biased != (follower is not None) or (is_biased and reference is None):
            raise ValueError(
                f"proposal is {type(mppi.proposal).__name__} with follower {follower!r} and "
                f"reference {reference!r}; accepted: a BiasedProposal with both, or another "
                "proposal without a follower"
            )
        self.mppi = mppi
        self.potential_sensor = potential_sensor
        self.short_range_field = short_range_field
        self.sensor_model = sensor_model
        self.reference = reference
        self.follower = follower
        self.strategy_period = _checks.scalar("strategy_period", strategy_period, above=0.0)
        self.altitude = _checks.scalar("altitude", altitude)
        # Compared with a tolerance: periods such as 0.2 and 0.02 are not exact in float32.
        if not _kinds.is_traced(self.strategy_period, mppi.control_period):
            ratio = float(self.strategy_period) / float(mppi.control_period)
            if abs(ratio - round(ratio)) > 1e-3 * ratio or round(ratio) < 1:
                raise ValueError(
                    f"strategy_period is {float(self.strategy_period):g} s; accepted: a whole "
                    f"number of control periods of {float(mppi.control_period):g} s"
                )

    def init(self) -> InformativeState:
        """Return the initial state. The strategic layer runs in the first step."""
        count = 1 if self.reference is None else self.reference.gradient_reference.num_steps
        potential = self.potential_sensor.empty()
        plan = StrategicPlan(potential, potential.best, jnp.zeros((count, 3)))
        return InformativeState(self.mppi.init(), plan, self._commands_per_strategy)

    def at_period(self, control_period: ArrayLike) -> "InformativeMPPI":
        """Return a copy of this controller that is called every `control_period` seconds."""
        # Built anew, not with `tree_at`: the strategy period must be a multiple of the new period.
        return InformativeMPPI(
            self.mppi.at_period(control_period),
            self.potential_sensor,
            self.short_range_field,
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
        """Run the strategic layer if it is due, then plan with MPPI.

        Args:
            state: state from `init` or the last step.
            observation: (nx,) observed state of the robot.
            belief: what the robot knows of the world.
            key: random key of this step.

        Returns:
            The control (nu,), the new state, and `Info`.

        Raises:
            ValueError: no belief.
        """
        model = self.mppi.dynamics
        observation = checked_call(model, state, InformativeState, observation, key)
        mppi, known, plan, age = self._prepare(state, observation, belief)
        control, inner, info = mppi.step(state.mppi, observation, known, key=key)
        return control, InformativeState(inner, plan, age + 1), info

    def inspect(
        self,
        state: InformativeState,
        observation: StateVector,
        belief: Belief | None = None,
        *,
        key: Key,
        num_trajectories: int = 50,
    ) -> SampledPlan:
        """Return the trajectories of MPPI and the reference; see `Controller.inspect`."""
        model = self.mppi.dynamics
        observation = checked_call(model, state, InformativeState, observation, key)
        mppi, known, _, _ = self._prepare(state, observation, belief)
        plan = mppi.inspect(
            state.mppi, observation, known, key=key, num_trajectories=num_trajectories
        )
        return plan if self.reference is None else plan._replace(reference=known.reference)

    def strategic_plan(self, belief: Belief, observation: StateVector) -> StrategicPlan:
        """Run the strategic layer: compute the information field and the reference.

        Args:
            belief: what the robot knows of the world.
            observation: (nx,) observed state of the robot.
        """
        model = self.mppi.dynamics
        position = model.position(observation)
        field = self.potential_sensor.field(belief.grid, position)
        potential = self._remaining(field, belief)
        best = potential.best
        # `cond` needs a plan of the same shapes as in `init`: one row, which nothing reads.
        if self.reference is None:
            return StrategicPlan(potential, best, jnp.zeros((1, 3)))
        start = ReferenceStart(
            jnp.append(position, self.altitude),
            model.heading(observation),
            model.speed(observation),
        )
        return StrategicPlan(potential, best, self.reference(belief, best, start))

    def _prepare(
        self, state: InformativeState, observation: StateVector, belief: Belief | None
    ) -> tuple[MPPI, StrategicBelief, StrategicPlan, Count]:
        """Return MPPI with its bias, the belief of its costs, the strategic plan and its age."""
        if belief is None:
            raise ValueError("belief is None; accepted: a Belief, which this controller plans on")
        _kinds.instance("belief", belief, Belief)
        mppi = self.mppi
        # A field around an unknown position would be meaningless, so a lost robot keeps its plan.
        is_placed = jnp.isfinite(mppi.dynamics.position(observation)).all()
        is_due = (state.age >= self._commands_per_strategy) & is_placed
        plan: StrategicPlan = jax.lax.cond(
            is_due,
            lambda: self.strategic_plan(belief, observation),
            lambda: state.plan,
        )
        age = jnp.where(is_due, 0, state.age)
        period = jnp.ones(()) if self.reference is None else self.reference.gradient_reference.dt
        # Costs read one belief, so the fields of the strategic layer are added to the robot's own.
        known = StrategicBelief(
            **{part.name: getattr(belief, part.name) for part in dataclasses.fields(Belief)},
            potential=plan.potential,
            best=plan.best,
            local=self._short_range_information(belief, observation),
            reference=plan.reference,
            reference_period=period,
            reference_age=age.astype(jnp.float32) * mppi.control_period,
        )
        if self.follower is not None:
            # The reference has its own time grid and age: it is read at the times of the rollout.
            times = mppi.dt * jnp.arange(1, mppi.horizon + 1, dtype=jnp.float32)
            positions = jax.vmap(known.reference_at)(times)
            controls = self.follower(mppi.dynamics, observation, positions, mppi.dt)
            mppi = eqx.tree_at(_bias, mppi, controls)
        return mppi, known, plan, age

    @property
    def _commands_per_strategy(self) -> Count:
        return jnp.round(self.strategy_period / self.mppi.control_period).astype(jnp.int32)

    def _short_range_information(self, belief: Belief, observation: StateVector) -> HeadingField:
        """Compute the discounted field of short-range scans around the robot [nat]."""
        position = self.mppi.dynamics.position(observation)
        return self._remaining(self.short_range_field(belief, self.sensor_model, position), belief)

    def _remaining(self, field: HeadingField, belief: Belief) -> HeadingField:
        """Discount a field by the time spent at each node; 0 everywhere once all is explored.

        Without the discount the robot would stay at a maximum whose information scans cannot get.
        """
        rows, columns = jnp.mgrid[: field.values.shape[0], : field.values.shape[1]]
        nodes = field.frame.cell_centre(jnp.stack([rows, columns], axis=-1).reshape(-1, 2))
        share = jax.vmap(belief.pull)(nodes).reshape(rows.shape)
        share = jnp.where(belief.is_explored, 0.0, share)
        return HeadingField(share[..., None] * field.values, field.frame)


def _bias(mppi: MPPI) -> Any:
    """Return the leaf of the reference controls, for `eqx.tree_at`."""
    proposal: Any = mppi.proposal
    return proposal.reference
