"""Informative MPPI in a volume: a slow strategic layer and a fast MPPI layer in one controller."""

import dataclasses
import math
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _kinds
from jaxplore._types import ArrayLike, Scalar, StateVector
from jaxplore.belief.volume import VolumePerception
from jaxplore.belief.volume_belief import VolumeBelief
from jaxplore.belief.volume_strategic import VolumeStrategicBelief
from jaxplore.control.mppi import MPPI
from jaxplore.dynamics.quadrotor import position_upwards
from jaxplore.maps.volume_field import VolumeField
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.planning.strategy.follower import Follower
from jaxplore.planning.strategy.quadrotor_follower import QuadrotorFollower
from jaxplore.planning.strategy.strategic_mppi import StrategicMPPI, check_strategy
from jaxplore.planning.strategy.volume_reference import VolumeReference


class VolumeStrategicPlan(NamedTuple):
    """Result of the strategic layer in a volume: the greatest information over headings [nat m^3],
    positions (x, y, z) to follow, z up [m], and the heading with the most attention at their
    end."""

    best: VolumeField
    reference: Float[Array, "T 3"]
    heading: Scalar


class VolumeInformativeMPPI(StrategicMPPI):
    """Informative MPPI in a volume, in two architectures: see `StrategicMPPI`.

    In the two-layer architecture, with a `reference`, the strategic layer computes positions that
    descend the cost-to-go to the remaining information, and MPPI draws a share of its samples
    around the controls that follow them. The follower turns the robot to where the reference leads,
    and where that stands still to the heading with the most attention at its end. In the parallel
    architecture, without a `reference`, MPPI only reads the field of information.

    Costs read a `VolumeStrategicBelief`: the belief of the robot, the field `best` and the
    reference.

    Args:
        mppi: MPPI layer. If its proposal is a `BiasedProposal`, it is biased by the reference.
        perception: perception of the scenario, whose clearance the reference keeps.
        grid: a map with the shape and resolution of the scenario's.
        reference: rule that makes the reference; the parallel architecture when absent.
        follower: follower that turns the reference into controls, for a `BiasedProposal`.
        strategy_period: time between runs of the strategic layer [s]; a multiple of the control
            period.

    Raises:
        ValueError: a part of another class, a strategy period that is not a whole number of control
            periods; a biased proposal without reference and follower, or the other way round.
    """

    belief_type: ClassVar[type] = VolumeBelief

    mppi: MPPI
    perception: VolumePerception
    blank: VolumeField
    reference: VolumeReference | None
    follower: QuadrotorFollower | None
    strategy_period: Scalar

    @_kinds.check_arguments
    def __init__(
        self,
        mppi: MPPI,
        perception: VolumePerception,
        grid: VoxelGrid,
        *,
        reference: VolumeReference | None = None,
        follower: QuadrotorFollower | None = None,
        strategy_period: ArrayLike = 0.2,
    ) -> None:
        self.strategy_period = check_strategy(mppi, reference, follower, strategy_period)
        self.mppi, self.perception = mppi, perception
        self.reference, self.follower = reference, follower
        self.blank = perception.blank_field(grid)

    @property
    def has_reference(self) -> bool:
        """Whether the strategic layer makes a reference: the two-layer architecture."""
        return self.reference is not None

    def place(self, observation: StateVector) -> Float[Array, "3"]:
        """Return the position (x, y, z) of the robot, z up [m]."""
        return position_upwards(observation)

    def path(self, reference: Float[Array, "T 3"]) -> Float[Array, "T 3"]:
        """Return positions of the reference in the frame of the model, z down [m]."""
        # A mirror in z is its own inverse.
        mirrored: Float[Array, "T 3"] = jax.vmap(position_upwards)(reference)
        return mirrored

    def follower_of(self, plan: VolumeStrategicPlan) -> Follower | None:
        """Return the follower, which turns to the heading of the plan where the reference stands
        still."""
        if self.follower is None:
            return None
        turned: Follower = eqx.tree_at(
            lambda each: each.heading,
            self.follower,
            plan.heading,
            is_leaf=lambda leaf: leaf is None,
        )
        return turned

    def blank_plan(self) -> VolumeStrategicPlan:
        """Return a plan without information, at the origin."""
        count = 1 if self.reference is None else self.reference.num_steps
        return VolumeStrategicPlan(self._nothing, jnp.zeros((count, 3)), jnp.zeros(()))

    def strategic_plan(self, belief: VolumeBelief, observation: StateVector) -> VolumeStrategicPlan:
        """Run the strategic layer: take the best headings and compute the reference.

        Args:
            belief: what the robot knows of the volume.
            observation: (nx,) observed state of the robot.
        """
        # A window that has moved has moved its lattice as well.
        best = eqx.tree_at(
            lambda each: (each.values, each.origin),
            self._nothing,
            (belief.information.values.max(axis=0), belief.information.origin),
        )
        heading = self.mppi.dynamics.heading(observation)
        # `cond` needs a plan of the same shapes as in `init`: one row, which nothing reads.
        if self.reference is None:
            return VolumeStrategicPlan(best, jnp.zeros((1, 3)), heading)
        path = self.reference(
            belief.guidance, belief.clearance, self.perception.required, self.place(observation)
        )
        return VolumeStrategicPlan(best, path, _best_heading(belief, path[-1], heading))

    def extend_belief(
        self,
        belief: VolumeBelief,
        observation: StateVector,
        plan: VolumeStrategicPlan,
        age: Scalar,
    ) -> VolumeStrategicBelief:
        """Return the belief with the field and the reference of the strategic layer.

        Args:
            belief: what the robot knows of the volume.
            observation: (nx,) observed state of the robot.
            plan: last result of the strategic layer.
            age: time since that result [s].
        """
        return VolumeStrategicBelief(
            **{part.name: getattr(belief, part.name) for part in dataclasses.fields(VolumeBelief)},
            best=plan.best,
            reference=plan.reference,
            reference_period=jnp.ones(()) if self.reference is None else self.reference.dt,
            reference_age=age,
        )

    @property
    def _nothing(self) -> VolumeField:
        """A field without information on the lattice of the viewpoints, 0 off it."""
        field: VolumeField = eqx.tree_at(lambda each: each.outside, self.blank, jnp.zeros(()))
        return field


def _best_heading(belief: VolumeBelief, at: Float[Array, "3"], heading: Scalar) -> Scalar:
    """Return the heading with the most attention at a place; the given one without any [rad]."""
    number = belief.attention.values.shape[0]
    headings = jnp.arange(number, dtype=jnp.float32) * (2.0 * math.pi / number)
    found = jax.vmap(lambda each: belief.attention(at, each))(headings)
    return jnp.where(found.max() > 0.0, headings[jnp.argmax(found)], heading)
