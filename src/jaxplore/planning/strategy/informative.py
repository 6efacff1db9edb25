"""Informative MPPI: a slow strategic layer and a fast MPPI layer in one controller."""

import dataclasses
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_DIRECTIONS
from jaxplore._types import ArrayLike, Scalar, StateVector
from jaxplore.belief.belief import Belief, StrategicBelief
from jaxplore.control.mppi import MPPI
from jaxplore.information.field_sensor import FieldSensor
from jaxplore.information.gain import CellSensor
from jaxplore.information.heading_field import HeadingField
from jaxplore.information.local_field import LocalFieldSensor
from jaxplore.maps.field import ScalarField
from jaxplore.planning.strategy.follower import Follower
from jaxplore.planning.strategy.references import ReferenceStart, StrategicReference
from jaxplore.planning.strategy.strategic_mppi import StrategicMPPI, check_strategy


class StrategicPlan(NamedTuple):
    """Result of the strategic layer: the information of a scan at each place around the robot by
    heading, its greatest value over headings [nat], and positions (x, y, z) to follow [m]."""

    potential: HeadingField
    best: ScalarField
    reference: Float[Array, "T 3"]


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


class InformativeMPPI(StrategicMPPI):
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

    belief_type: ClassVar[type] = Belief

    mppi: MPPI
    potential_sensor: LocalFieldSensor
    short_range_field: ShortRangeField
    sensor_model: CellSensor
    reference: StrategicReference | None
    follower: Follower | None
    strategy_period: Scalar
    altitude: Scalar

    @_kinds.check_arguments
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
        strategy_period = check_strategy(mppi, reference, follower, strategy_period)
        self.mppi = mppi
        self.potential_sensor = potential_sensor
        self.short_range_field = short_range_field
        self.sensor_model = sensor_model
        self.reference = reference
        self.follower = follower
        self.strategy_period = strategy_period
        self.altitude = _checks.scalar("altitude", altitude)

    @property
    def has_reference(self) -> bool:
        """Whether the strategic layer makes a reference: the two-layer architecture."""
        return self.reference is not None

    def blank_plan(self) -> StrategicPlan:
        """Return a plan without information, at the origin."""
        count = 1 if self.reference is None else self.reference.gradient_reference.num_steps
        potential = self.potential_sensor.empty()
        return StrategicPlan(potential, potential.best, jnp.zeros((count, 3)))

    def strategic_plan(self, belief: Belief, observation: StateVector) -> StrategicPlan:
        """Run the strategic layer: compute the information field and the reference.

        Args:
            belief: what the robot knows of the world.
            observation: (nx,) observed state of the robot.
        """
        model = self.mppi.dynamics
        position = model.position(observation)
        field = self.potential_sensor.field(belief.grid, position)
        potential = self._discount(field, belief)
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

    def extend_belief(
        self, belief: Belief, observation: StateVector, plan: StrategicPlan, age: Scalar
    ) -> StrategicBelief:
        """Return the belief with the fields and the reference of the strategic layer.

        Args:
            belief: what the robot knows of the world.
            observation: (nx,) observed state of the robot.
            plan: last result of the strategic layer.
            age: time since that result [s].
        """
        period = jnp.ones(()) if self.reference is None else self.reference.gradient_reference.dt
        return StrategicBelief(
            **{part.name: getattr(belief, part.name) for part in dataclasses.fields(Belief)},
            potential=plan.potential,
            best=plan.best,
            local=self._short_range_information(belief, observation),
            reference=plan.reference,
            reference_period=period,
            reference_age=age,
        )

    def _short_range_information(self, belief: Belief, observation: StateVector) -> HeadingField:
        """Compute the discounted field of short-range scans around the robot [nat]."""
        position = self.mppi.dynamics.position(observation)
        return self._discount(self.short_range_field(belief, self.sensor_model, position), belief)

    def _discount(self, field: HeadingField, belief: Belief) -> HeadingField:
        """Discount a field by the time spent at each node; 0 everywhere once all is explored.

        Without the discount the robot would stay at a maximum whose information scans cannot get.
        """
        rows, columns = jnp.mgrid[: field.values.shape[0], : field.values.shape[1]]
        nodes = field.frame.cell_centre(jnp.stack([rows, columns], axis=-1).reshape(-1, 2))
        share = jax.vmap(belief.pull)(nodes).reshape(rows.shape)
        share = jnp.where(belief.is_explored, 0.0, share)
        return HeadingField(share[..., None] * field.values, field.frame)
