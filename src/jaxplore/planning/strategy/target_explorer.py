"""Target explorer: choose a target by a rule and drive to it."""

import dataclasses
import math
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Count, Position, Scalar, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.belief.exploration_field import LEFTOVER_SHARE
from jaxplore.belief.guidance import GuidanceField
from jaxplore.belief.roadmap import Locomotion, Roadmap, TurnsOnTheSpot
from jaxplore.control.base import ModelBasedController
from jaxplore.maps.frame import GridFrame
from jaxplore.planning.strategy.frontiers import Frontiers, find_frontiers
from jaxplore.planning.strategy.target_controller import (
    TargetController,
    TargetProgress,
    TargetState,
)
from jaxplore.planning.strategy.target_rules import TargetRule


class TargetExplorer(TargetController):
    """Chooses a target in the plane by a rule and drives there: see `TargetController`.

    Args:
        tracker: controller that drives down `belief.guidance`, such as MPPI.
        rule: rule that chooses targets.
        frame: frame of the map.
        shape: rows and columns of the belief's arrays, those of `scenario.map_arrays.world`;
            static.
        stride: cells between the nodes of the fields of the belief; static.
        required_clearance: clearance that a path needs [m]. The distance between a frontier node
            and unknown space follows from it.
        min_information: discounted information below which a place is not visited [nat].
        leftover_share: share of `min_information` below which a place has nothing left.
        min_frontier: minimum length of a frontier, and of a cluster [m].
        near: length of the path to a target at which it counts as reached [m].
        every: number of commands between choices.
        stays: whether the robot stays at a target until its information is seen or discounted. This
            suits a robot with a limited field of view, whose tracker turns it towards the
            information; static.
        locomotion: paths that the robot can drive; those of a robot that turns on the spot when
            absent.

    Raises:
        ValueError: a number outside its range.
    """

    belief_type: ClassVar[type] = Belief

    tracker: ModelBasedController
    rule: TargetRule
    frame: GridFrame
    locomotion: Locomotion
    required_clearance: Scalar
    min_information: Scalar
    leftover_share: Scalar
    min_frontier: Scalar
    near: Scalar
    every: Count
    shape: tuple[int, int] = eqx.field(static=True)
    stride: int = eqx.field(static=True)
    nodes_to_unknown: int = eqx.field(static=True)
    stays: bool = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        tracker: ModelBasedController,
        rule: TargetRule,
        frame: GridFrame,
        shape: tuple[int, int],
        stride: int,
        *,
        required_clearance: ArrayLike,
        min_information: ArrayLike,
        leftover_share: ArrayLike = LEFTOVER_SHARE,
        min_frontier: ArrayLike = 0.75,
        near: ArrayLike = 0.4,
        every: int,
        stays: bool = False,
        locomotion: Locomotion | None = None,
    ) -> None:
        if not isinstance(shape, tuple) or len(shape) != 2:
            raise ValueError(f"shape is {_kinds.describe(shape)}; accepted: (H, W)")
        self.tracker, self.rule, self.frame = tracker, rule, frame
        rows, columns = (_checks.positive_int("shape", side) for side in shape)
        self.shape = (rows, columns)
        self.stride = _checks.positive_int("stride", stride)
        self.required_clearance = _checks.scalar(
            "required_clearance", required_clearance, above=0.0
        )
        # The robot keeps its clearance from unknown cells, so a node from which a frontier is
        # visited is at least that far away from it.
        spacing = frame.resolution * self.stride
        self.locomotion = TurnsOnTheSpot() if locomotion is None else locomotion
        self.nodes_to_unknown = 1 + math.ceil(float(self.required_clearance) / spacing)
        self.min_information = _checks.scalar("min_information", min_information, above=0.0)
        self.leftover_share = _checks.scalar(
            "leftover_share", leftover_share, at_least=0.0, at_most=1.0
        )
        self.min_frontier = _checks.scalar("min_frontier", min_frontier, at_least=0.0)
        self.near = _checks.scalar("near", near, above=0.0)
        self.stays = _kinds.flag("stays", stays)
        self.every = jnp.asarray(_checks.positive_int("every", every), jnp.int32)

    def init(self) -> TargetState:
        """Return the initial state, without a target."""
        rows, columns = (-(-side // self.stride) for side in self.shape)
        lattice = self.frame.coarsen(self.stride, self.stride / 2.0)
        # The loop needs a state of fixed shapes; a flat cost to go attracts the robot nowhere.
        flat = self.locomotion.level_field(lattice, (rows, columns))
        return TargetState(
            self.tracker.init(),
            jnp.zeros(2, jnp.int32),
            jnp.array(False),
            flat,
            jnp.zeros((), jnp.int32),
            TargetProgress.begin((rows, columns)),
        )

    def find(self, belief: Belief, observation: StateVector) -> Frontiers:
        """Return the frontiers and views that the robot can reach.

        Raises:
            ValueError: a belief whose map has another shape.
        """
        if self.shape != belief.grid.shape:
            raise ValueError(
                f"shape is {self.shape}; accepted: that of the belief's map, which has arrays "
                f"of {belief.grid.shape} cells"
            )
        return find_frontiers(
            belief,
            self.tracker.dynamics.pose(observation),
            self.locomotion,
            required_clearance=self.required_clearance,
            min_information=self.min_information,
            leftover_share=self.leftover_share,
            min_frontier=self.min_frontier,
            stride=self.stride,
            near=self.nodes_to_unknown,
        )

    def guidance(
        self,
        frontiers: Frontiers,
        source: Float[Array, "H W"],
        state: TargetState,
        observation: StateVector,
    ) -> GuidanceField:
        """Return the cost to go to a source as a field."""
        assert isinstance(frontiers.roads, Roadmap)
        field = frontiers.roads.field(source, self.tracker.dynamics.position(observation))
        former = state.guidance
        assert isinstance(former, GuidanceField)
        # The lattice is that of the state, whose frame a caller may have made without padding.
        return dataclasses.replace(field, frame=former.frame)

    def target(self, state: TargetState) -> Position:
        """Return the position (x, y) of the target of a state [m]."""
        assert isinstance(state.guidance, GuidanceField)
        return state.guidance.frame.cell_centre(state.node)

    def spacing(self, state: TargetState) -> float:
        """Return the distance between the nodes of the lattice [m]."""
        assert isinstance(state.guidance, GuidanceField)
        return state.guidance.frame.resolution
