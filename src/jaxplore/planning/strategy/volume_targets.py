"""Target explorer of a volume: choose a target by a rule and fly there."""

import math
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Count, Key, Position, Scalar, StateVector
from jaxplore.belief.coarse_voxels import FREE, UNKNOWN
from jaxplore.belief.exploration_field import LEFTOVER_SHARE
from jaxplore.belief.rolling_map import shift_array
from jaxplore.belief.volume import VolumePerception
from jaxplore.belief.volume_belief import VolumeBelief
from jaxplore.belief.volume_lattice import NODE
from jaxplore.control.base import ModelBasedController
from jaxplore.dynamics.quadrotor import position_upwards
from jaxplore.maps.volume_field import VolumeField
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.planning.strategy.frontiers import Frontiers, cluster_sizes
from jaxplore.planning.strategy.target_controller import (
    TargetController,
    TargetProgress,
    TargetState,
)
from jaxplore.planning.strategy.target_rules import TargetRule


class VolumeTargetExplorer(TargetController):
    """Chooses a target in a volume by a rule and flies there: see `TargetController`.

    The nodes are those of the fields of the belief. The information of a node is that of its best
    heading. Frontiers are those of the coarser voxels in which the information is computed.

    Args:
        tracker: controller that flies down `belief.guidance`, such as MPPI.
        rule: rule that chooses targets.
        perception: perception of the scenario.
        grid: a map with the shape and resolution of the scenario's.
        min_information: information of its best view below which a place is not visited
            [nat m^3].
        min_frontier: minimum area of a frontier, and of a cluster [m^2].
        near: length of the path to a target at which it counts as reached [m].
        every: number of commands between choices.
        leftover_share: share of `min_information` below which a place has nothing left.

    Raises:
        ValueError: a part of another class, a number outside its range.
    """

    belief_type: ClassVar[type] = VolumeBelief

    tracker: ModelBasedController
    rule: TargetRule
    perception: VolumePerception
    blank: VolumeField
    min_information: Scalar
    leftover_share: Scalar
    min_frontier: Scalar
    near: Scalar
    every: Count
    blocks_to_unknown: int = eqx.field(static=True)
    stays: bool = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        tracker: ModelBasedController,
        rule: TargetRule,
        perception: VolumePerception,
        grid: VoxelGrid,
        *,
        min_information: ArrayLike,
        min_frontier: ArrayLike,
        near: ArrayLike,
        every: int,
        leftover_share: ArrayLike = LEFTOVER_SHARE,
    ) -> None:
        self.tracker, self.rule, self.perception = tracker, rule, perception
        self.blank = perception.blank_field(grid)
        # The robot keeps its clearance from unknown voxels, so a node from which a frontier is
        # visited is at least that far away from it.
        spacing = self.blank.spacing
        self.blocks_to_unknown = 1 + math.ceil(float(perception.required) / spacing)
        self.min_information = _checks.scalar("min_information", min_information, above=0.0)
        self.leftover_share = _checks.scalar(
            "leftover_share", leftover_share, at_least=0.0, at_most=1.0
        )
        self.min_frontier = _checks.scalar("min_frontier", min_frontier, at_least=0.0)
        self.near = _checks.scalar("near", near, above=0.0)
        self.every = jnp.asarray(_checks.positive_int("every", every), jnp.int32)
        # A camera must be turned to what is to be seen.
        self.stays = perception.needs_turning

    def init(self) -> TargetState:
        """Return the initial state, without a target."""
        return TargetState(
            self.tracker.init(),
            jnp.zeros(3, jnp.int32),
            jnp.array(False),
            self.blank,
            jnp.zeros((), jnp.int32),
            TargetProgress.begin(self.blank.values.shape),
        )

    def find(self, belief: VolumeBelief, observation: StateVector) -> Frontiers:
        """Return the frontiers and views that the robot can reach."""
        perception = self.perception
        roads = perception.roads(belief)
        distance = roads.lengths_from(position_upwards(observation))
        worth = belief.information.values.max(axis=0)
        can_reach = roads.is_open & jnp.isfinite(distance)
        is_view = can_reach & (worth >= self.min_information)
        area, largest = self._frontier_areas(belief, worth.shape)
        return Frontiers(
            roads,
            distance,
            worth,
            is_view & (area >= self.min_frontier),
            is_view & (largest >= self.min_frontier),
            is_view,
            can_reach & (worth >= self.leftover_share * self.min_information),
        )

    def guidance(
        self,
        frontiers: Frontiers,
        source: Float[Array, "D H W"],
        state: TargetState,
        observation: StateVector,
    ) -> VolumeField:
        """Return the cost to go to a source as a field."""
        field = frontiers.roads.field(source)
        assert isinstance(field, VolumeField)
        return field

    def _choose_if_due(
        self, state: TargetState, observation: StateVector, belief: VolumeBelief, key: Key
    ) -> TargetState:
        """Return the state after a choice, if one is due: also when the window has moved."""
        old, new = state.guidance, belief.guidance
        assert isinstance(old, VolumeField)
        gap = jnp.round((new.origin - old.origin) / new.spacing).astype(jnp.int32)
        node, shape = state.node - jnp.flip(gap), jnp.asarray(new.values.shape)
        is_inside = jnp.all((node >= 0) & (node < shape))
        moved = state._replace(
            node=jnp.clip(node, 0, shape - 1),
            has_target=state.has_target & is_inside,
            guidance=eqx.tree_at(lambda each: each.origin, old, new.origin),
            since=jnp.where(jnp.any(gap != 0), 0, state.since),
            progress=state.progress._replace(
                avoided=shift_array(state.progress.avoided, jnp.flip(gap))
            ),
        )
        return super()._choose_if_due(moved, observation, belief, key)

    def spacing(self, state: TargetState) -> float:
        """Return the distance between the nodes of the lattice [m]."""
        return self.blank.spacing

    def target(self, state: TargetState) -> Position:
        """Return the position (x, y) of the target of a state [m]."""
        assert isinstance(state.guidance, VolumeField)
        return state.guidance.place(state.node)[:2]

    def _frontier_areas(
        self, belief: VolumeBelief, shape: tuple[int, ...]
    ) -> tuple[Float[Array, "D H W"], Float[Array, "D H W"]]:
        """Compute the area of the frontier voxels near each node, and that of the largest cluster
        with a voxel there [m^2]."""
        is_free = belief.coarse == FREE
        # The padding is not unknown: the border of the volume is no frontier.
        unknown = jnp.pad(belief.coarse == UNKNOWN, 1)
        beside = jnp.zeros_like(is_free)
        for axis in range(3):
            for begin in (0, 2):
                index = [slice(1, -1)] * 3
                index[axis] = slice(begin, begin + is_free.shape[axis])
                beside |= unknown[tuple(index)]
        is_frontier = is_free & beside
        near = self.blocks_to_unknown

        def over(values: Array, start: float, combine: Callable[[Array, Array], Array]) -> Array:
            # Node n is the middle voxel of its block, with index NODE n + 1.
            wide = [(NODE * near - 1, NODE * (near + 1))] * 3
            padded = jnp.pad(values.astype(jnp.float32), wide, constant_values=start)
            window = (2 * NODE * near + 1,) * 3
            found: Array = jax.lax.reduce_window(
                padded, start, combine, window, (NODE,) * 3, "VALID"
            )
            return found[tuple(slice(size) for size in shape)]

        face = (belief.grid.resolution * self.perception.pool) ** 2
        area = face * over(is_frontier, 0.0, jax.lax.add)
        largest = face * over(cluster_sizes(is_frontier), 0.0, jax.lax.max)
        return area, largest
