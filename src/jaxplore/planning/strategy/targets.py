"""Targets of the sequential planner: zones and a goal, the paths to them, and their selection."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Count, Flag, GridMask, Pose, Position, Scalar, Vector
from jaxplore.belief.belief import Belief
from jaxplore.belief.guidance import GuidanceField
from jaxplore.belief.roadmap import Locomotion, Roadmap, TurnsOnTheSpot
from jaxplore.belief.zones import Zones
from jaxplore.maps.field import ScalarField
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.planning.strategy.gradient_reference import GradientReference
from jaxplore.planning.strategy.references import ReferenceStart, StrategicReference, descend

TIE = 1e-3
"""Difference in distance up to which nodes count as equally near [node spacings]."""


class TargetScores(eqx.Module):
    """Scores of Z zones and the goal, and the target that was selected.

    Args:
        score: (Z + 1,) scores of the zones and then of the goal; -inf for a target that is not
            available. The highest score wins.
        index: index of the selected target, Z for the goal.
        position: position of the selected target (x, y) [m]; the centre of a zone.
    """

    score: Float[Array, " N"]
    index: Count
    position: Position


class Targets(eqx.Module):
    """Zones to explore, a final goal, and the shortest paths to them.

    A zone is depleted when its remaining uncertainty (`Zones.uncertainty`) is below `depleted`.
    Parts of a zone that no scan can reach, such as the inside of a wall, remain for ever. All zones
    count as depleted when nothing worthwhile is left to see (`Belief.is_explored`).

    Paths keep the robot clear of whatever is not known to be free, and count double where it just
    fits (`roadmap`). A path ends at any open node of its target, or, if none is open, at the open
    nodes nearest to the centre of the target. The goal is the cell that contains it; off the map it
    is the nearest cell.

    Args:
        zones: Z zones.
        goal: final position (x, y) [m].
        depleted: remaining uncertainty below which a zone is depleted, in (0, 1].
        required_clearance: radius of the robot plus its margin [m].
        stride: cells between nodes of the road map, at most `safe_stride`; static.
        locomotion: paths that the robot can drive; those of a robot that turns on the spot when
            absent.

    Raises:
        ValueError: no zones, a value outside its range.
    """

    zones: Zones
    goal: Position
    depleted: Scalar
    required_clearance: Scalar
    locomotion: Locomotion
    stride: int = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        zones: Zones,
        goal: Vector,
        *,
        depleted: ArrayLike = 0.05,
        required_clearance: ArrayLike = 0.35,
        stride: int = 1,
        locomotion: Locomotion | None = None,
    ) -> None:
        if zones.member.ndim != 3 or zones.member.shape[0] == 0:
            raise ValueError(
                f"zones has members of shape {zones.member.shape}; accepted: (Z, H, W) with Z >= 1"
            )
        self.zones = zones
        self.goal = _checks.vector("goal", goal, 2)
        self.depleted = _checks.scalar("depleted", depleted, above=0.0, at_most=1.0)
        self.required_clearance = _checks.scalar(
            "required_clearance", required_clearance, above=0.0
        )
        self.locomotion = TurnsOnTheSpot() if locomotion is None else locomotion
        self.stride = _checks.positive_int("stride", stride)

    def masks(self, grid: OccupancyGrid) -> Bool[Array, "N H W"]:
        """Return the cells of each target (N, H, W), N = Z + 1: the zones, then the goal.

        Raises:
            ValueError: a grid of another shape than the zones'.
        """
        height, width = grid.shape
        member = self.zones.member
        if grid.map_shape is not None:
            # The zones may be those of the map before it was padded.
            more = [
                (0, max(0, size - own))
                for size, own in zip(grid.shape, member.shape[1:], strict=True)
            ]
            member = jnp.pad(member, [(0, 0), *more])
        if member.shape[1:] != grid.shape:
            raise ValueError(f"grid has shape {grid.shape}; accepted: {member.shape[1:]}")
        cell = jnp.clip(grid.frame.to_cell(self.goal), 0, jnp.asarray([height - 1, width - 1]))
        goal = jnp.zeros((height, width), bool).at[cell[0], cell[1]].set(True)
        return jnp.concatenate([member, goal[None]])

    def cost_to(self, belief: Belief, target: GridMask) -> GuidanceField:
        """Compute the cost to go to a target [m].

        Args:
            belief: what the robot knows of the world.
            target: (H, W) cells of the target.

        Raises:
            ValueError: a target of another shape than the map.
        """
        roads = self._roads(belief)
        return roads.field(self._sources(belief, roads, target))

    def route(self, belief: Belief, target: GridMask, pose: Pose) -> tuple[GuidanceField, Flag]:
        """Compute the cost to go to a target [m], and whether a path leads there from a pose.

        Args:
            belief: what the robot knows of the world.
            target: (H, W) cells of the target.
            pose: pose of the robot (x, y, yaw) [m, m, rad].

        Raises:
            ValueError: a target of another shape than the map.
        """
        roads = self._roads(belief)
        field, cost = roads.field_and_cost(self._sources(belief, roads, target), pose)
        return field, jnp.isfinite(cost)

    def distances(self, belief: Belief, pose: Pose) -> Float[Array, " N"]:
        """Compute the length of the shortest path to each target (N,), N = Z + 1 [m].

            distance_z = min over n of |n - p| + d(n, z)

        over the open nodes n within a node spacing of those nearest to the position p, with d the
        length of the shortest path. The distance is infinite where there is no path, and from a
        pose that is not finite.

        Args:
            belief: what the robot knows of the world.
            pose: pose of the robot (x, y, yaw) [m, m, rad].
        """
        # One search from the robot serves all targets.
        roads = self._roads(belief)
        from_robot = roads.lengths_from(pose)

        def to_target(target: GridMask) -> Scalar:
            return jnp.where(self._ends(belief, roads, target), from_robot, jnp.inf).min()

        return jax.vmap(to_target)(self.masks(belief.grid))

    def choose(self, belief: Belief, values: Float[Array, " N"]) -> TargetScores:
        """Select the remaining zone of highest value, or the goal if all zones are depleted.

        If zones remain but none can be reached, the zone with the most remaining uncertainty is
        selected.

        Args:
            belief: what the robot knows of the world.
            values: (Z + 1,) value of each target; not finite where it cannot be reached.
        """
        remaining = self.zones.uncertainty(belief.grid)
        remains = (remaining >= self.depleted) & ~belief.is_explored
        allowed = jnp.append(remains, ~remains.any())
        score = jnp.where(allowed & jnp.isfinite(values), values, -jnp.inf)
        is_reached = jnp.isfinite(score).any()
        # Used where nothing can be reached: the largest entry is a zone that remains, or the goal.
        most = jnp.append(jnp.where(remains, remaining, -1.0), jnp.where(remains.any(), -1.0, 1.0))
        index = jnp.argmax(jnp.where(is_reached, score, most))
        centres = self.zones.centres(belief.grid.frame)
        return TargetScores(score, index, jnp.append(centres, self.goal[None], axis=0)[index])

    def _roads(self, belief: Belief) -> Roadmap:
        return self.locomotion.roadmap(belief.clearance, self.required_clearance, self.stride)

    def _sources(self, belief: Belief, roads: Roadmap, target: GridMask) -> Float[Array, "H W"]:
        """Return the sources of the paths to a target: 0 at its nodes, infinite elsewhere."""
        if target.shape != belief.grid.shape:
            raise ValueError(f"target has shape {target.shape}; accepted: {belief.grid.shape}")
        at_target = self._ends(belief, roads, target)
        return jnp.where(at_target, 0.0, jnp.inf)

    def _ends(
        self, belief: Belief, roads: Roadmap, target: GridMask
    ) -> Bool[Array, "rows columns"]:
        """Return the nodes at which the paths to a target end."""
        rows, columns = roads.is_open.shape
        height, width = target.shape
        missing = (0, rows * self.stride - height), (0, columns * self.stride - width)
        blocks = jnp.pad(target, missing).reshape(rows, self.stride, columns, self.stride)
        within = blocks.any(axis=(1, 3)) & roads.is_open
        is_near, _ = _nearest(roads, Zones(target[None]).centres(belief.grid.frame)[0])
        return jnp.where(within.any(), within, is_near)


class TargetChoice(eqx.Module):
    """A rule by which the sequential planner selects one of its `targets`."""

    targets: eqx.AbstractVar[Targets]

    @abc.abstractmethod
    def __call__(self, belief: Belief, start: ReferenceStart) -> TargetScores:
        """Score all targets and select one."""


class TargetReference(StrategicReference):
    """Descends the cost to go to the target that a rule selects.

    The reference ends where the path ends. At an open node of the zone the robot stands still until
    the zone is depleted or another zone scores higher.

    If no path leads to the target, the reference descends the guidance field, which leads to where
    a path may still be found. A robot that stood still would never find one.

    Source: the sequential planner of the quadrotor design notes, which goes in a straight line.

    Args:
        choice: rule that selects the target; paths keep the clearance of its `targets`.
        gradient_reference: gradient ascent that makes the positions; the notes' 40 steps of 0.05 s
            at 2 m/s when absent.
    """

    choice: TargetChoice
    gradient_reference: GradientReference

    @_kinds.check_arguments
    def __init__(
        self, choice: TargetChoice, gradient_reference: GradientReference | None = None
    ) -> None:
        self.choice = choice
        self.gradient_reference = (
            GradientReference() if gradient_reference is None else gradient_reference
        )

    def __call__(
        self, belief: Belief, potential: ScalarField, start: ReferenceStart
    ) -> Float[Array, "T 3"]:
        """Compute the positions after 1 ... T steps [m]; the potential is not read."""
        targets = self.choice.targets
        index = self.choice(belief, start).index
        field, is_reachable = targets.route(belief, targets.masks(belief.grid)[index], start.pose)
        to_target = descend(self.gradient_reference, field, belief, start)
        by_guidance = descend(self.gradient_reference, belief.guidance, belief, start)
        return jnp.where(is_reachable, to_target, by_guidance)


def _nearest(
    roads: Roadmap, position: Position
) -> tuple[Bool[Array, "rows columns"], Float[Array, "rows columns"]]:
    """Return the open nodes nearest to a position, and the distances of all nodes [m].

    For a position that is not finite, no node is near.
    """
    row, column = roads.frame.to_grid(position)
    rows, columns = (jnp.arange(size, dtype=jnp.float32) + 0.5 for size in roads.is_open.shape)
    square = (rows - row)[:, None] ** 2 + (columns - column)[None, :] ** 2
    away = jnp.where(roads.is_open, jnp.sqrt(square), jnp.inf)
    is_near = jnp.isfinite(away) & (away <= away.min() + TIE)
    return is_near, away * roads.frame.resolution
