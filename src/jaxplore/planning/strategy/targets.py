"""Which zone to go to next: target selection of the sequential planner, and the way there."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Bool, Float

from jaxplore import _checks
from jaxplore._types import Count, Flag, GridMask, Position, Scalar, Vector
from jaxplore.belief.belief import Belief
from jaxplore.belief.guidance import GuidanceField, Roadmap, descent_field, geodesic, roadmap
from jaxplore.belief.perception import LAYERS
from jaxplore.belief.zones import Zones
from jaxplore.information.trajectory import TrajectoryInformation, path_headings
from jaxplore.maps.field import ScalarField
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.planning.strategy.gradient_reference import GradientReference
from jaxplore.planning.strategy.references import StrategicReference, follow

TIE = 1e-3
"""Nodes this much farther away than the nearest one are as near [node spacings]."""


class TargetScores(eqx.Module):
    """What was chosen of Z zones and the goal, and why.

    Args:
        score: (Z + 1,) of the zones, then of the goal; -inf for what is not to be had. The
            greatest wins.
        index: of the target, Z for the goal.
        position: of the target (x, y) [m], a zone's being its centre.
    """

    score: Float[Array, " N"]
    index: Count
    position: Position


class Targets(eqx.Module):
    """Zones in which something is to be learned, the goal after them, and the ways there.

    A zone is depleted when what remains of it (`Zones.remaining`) is less than `depleted`. Part of
    a zone that no scan can reach, such as the inside of a wall, remains for ever. All are depleted
    when nothing worthwhile is left to see (`Belief.is_explored`).

    Ways keep the robot clear of whatever is not known to be free; they count double where it just
    fits (`roadmap`). They end at any open node of a target, or where none is open at the open nodes
    nearest to its centre. The goal is the cell that holds it; off the map, the nearest one.

    Args:
        zones: Z of them.
        goal: (x, y) to go to in the end [m].
        depleted: what remains of a zone that is done with, in (0, 1].
        required_clearance: radius of the robot and its margin [m].
        stride: cells between nodes of the road map; static. At most `safe_stride`.

    Raises:
        ValueError: no zones, a value out of its range.
    """

    zones: Zones
    goal: Position
    depleted: Scalar
    required_clearance: Scalar
    stride: int = eqx.field(static=True)

    def __init__(
        self,
        zones: Zones,
        goal: Vector,
        *,
        depleted: ArrayLike = 0.05,
        required_clearance: ArrayLike = 0.35,
        stride: int = 1,
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
        self.stride = _checks.positive_int("stride", stride)

    def masks(self, grid: OccupancyGrid) -> Bool[Array, "N H W"]:
        """Return the cells of each target, N = Z + 1: of the zones, then of the goal.

        Raises:
            ValueError: a grid of another shape than the zones'.
        """
        height, width = grid.shape
        if self.zones.member.shape[1:] != grid.shape:
            raise ValueError(
                f"grid has shape {grid.shape}; accepted: {self.zones.member.shape[1:]}"
            )
        cell = jnp.clip(grid.frame.to_cell(self.goal), 0, jnp.asarray([height - 1, width - 1]))
        goal = jnp.zeros((height, width), bool).at[cell[0], cell[1]].set(True)
        return jnp.concatenate([self.zones.member, goal[None]])

    def cost_to(self, belief: Belief, target: GridMask) -> GuidanceField:
        """Return the cost to go to a target [m].

        Args:
            belief: what the robot knows.
            target: (H, W) cells of the target.

        Raises:
            ValueError: a target of another shape than the map.
        """
        roads = self._roads(belief)
        return descent_field(self._cost(belief, roads, target), roads.frame, LAYERS)

    def way(
        self, belief: Belief, target: GridMask, position: Position
    ) -> tuple[GuidanceField, Flag]:
        """Return the cost to go to a target [m], and whether a way leads there from a position.

        Args:
            belief: what the robot knows.
            target: (H, W) cells of the target.
            position: of the robot (x, y) [m].

        Raises:
            ValueError: a target of another shape than the map.
        """
        roads = self._roads(belief)
        cost = self._cost(belief, roads, target)
        is_near, _ = _nearest(roads, position)
        leads = (is_near & jnp.isfinite(cost)).any()
        return descent_field(cost, roads.frame, LAYERS), leads

    def distances(self, belief: Belief, position: Position) -> Float[Array, " N"]:
        """Return the length of the shortest way to each target, N = Z + 1 [m].

            distance_z = min over n of |n - position| + d(n, z)

        over the open nodes n nearest to the position, with d the cost to go of `cost_to`. Infinite
        where no way leads, and from a position that is not finite. As long there as back: one
        search from the robot answers for all targets.

        Args:
            belief: what the robot knows.
            position: of the robot (x, y) [m].
        """
        roads = self._roads(belief)
        is_near, away = _nearest(roads, position)
        from_robot = geodesic(jnp.where(is_near, away, jnp.inf), roads.slowness, roads.is_open)

        def to_target(target: GridMask) -> Scalar:
            return jnp.where(self._ends(belief, roads, target), from_robot, jnp.inf).min()

        return jax.vmap(to_target)(self.masks(belief.grid))

    def choose(self, belief: Belief, values: Float[Array, " N"]) -> TargetScores:
        """Return the best zone of those that remain, or the goal if none does.

        Where something remains but nothing of it can be reached, the zone of which most remains.

        Args:
            belief: what the robot knows.
            values: (Z + 1,) of each target; not finite where it cannot be reached.
        """
        remaining = self.zones.remaining(belief.grid)
        remains = (remaining >= self.depleted) & ~belief.is_explored
        allowed = jnp.append(remains, ~remains.any())
        score = jnp.where(allowed & jnp.isfinite(values), values, -jnp.inf)
        is_reached = jnp.isfinite(score).any()
        most = jnp.append(jnp.where(remains, remaining, -1.0), jnp.where(remains.any(), -1.0, 1.0))
        index = jnp.argmax(jnp.where(is_reached, score, most))
        centres = self.zones.centres(belief.grid.frame)
        return TargetScores(score, index, jnp.append(centres, self.goal[None], axis=0)[index])

    def _roads(self, belief: Belief) -> Roadmap:
        return roadmap(belief.clearance, self.required_clearance, self.stride)

    def _cost(self, belief: Belief, roads: Roadmap, target: GridMask) -> Float[Array, "H W"]:
        """Return the cost to go to a target from each node, infinite where no way leads."""
        if target.shape != belief.grid.shape:
            raise ValueError(f"target has shape {target.shape}; accepted: {belief.grid.shape}")
        at_target = self._ends(belief, roads, target)
        return geodesic(jnp.where(at_target, 0.0, jnp.inf), roads.slowness, roads.is_open)

    def _ends(
        self, belief: Belief, roads: Roadmap, target: GridMask
    ) -> Bool[Array, "rows columns"]:
        """Return the nodes at which the ways to a target end."""
        rows, columns = roads.is_open.shape
        height, width = target.shape
        missing = (0, rows * self.stride - height), (0, columns * self.stride - width)
        blocks = jnp.pad(target, missing).reshape(rows, self.stride, columns, self.stride)
        within = blocks.any(axis=(1, 3)) & roads.is_open
        is_near, _ = _nearest(roads, Zones(target[None]).centres(belief.grid.frame)[0])
        return jnp.where(within.any(), within, is_near)


class TargetChoice(eqx.Module):
    """A rule by which the sequential planner picks where to go.

    `targets` says what there is to pick from.
    """

    targets: eqx.AbstractVar[Targets]

    @abc.abstractmethod
    def __call__(self, belief: Belief, position: Position) -> TargetScores:
        """Return the scores of all targets and the choice.

        Args:
            belief: what the robot knows.
            position: of the robot (x, y) [m].
        """


class RemainingInformation(TargetChoice):
    """The zone of which much remains and which is near:

        score_z = remaining_z - weight * distance_z

    with `remaining` the mean of `4 p (1 - p)` over the zone's cells and `distance` the length of
    the shortest way there, infinite where none leads. Depleted zones are left out. The goal, of
    which nothing remains, is chosen if and only if all zones are depleted.

    Source: the sequential planner of the quadrotor design notes, whose distances are straight lines
    to the zones' centres: `straight`. These know of no walls; `distance` by the map is ours.

    Args:
        targets: the zones, the goal, and the ways there.
        weight: of the distance [1/m].
        straight: whether distances are straight lines; static.

    Raises:
        ValueError: a negative weight.
    """

    targets: Targets
    weight: Scalar
    straight: bool = eqx.field(static=True)

    def __init__(
        self, targets: Targets, weight: ArrayLike = 0.05, *, straight: bool = False
    ) -> None:
        self.targets = targets
        self.weight = _checks.scalar("weight", weight, at_least=0.0)
        self.straight = bool(straight)

    def __call__(self, belief: Belief, position: Position) -> TargetScores:
        """Return the scores of all targets and the choice."""
        targets = self.targets
        if self.straight:
            centres = targets.zones.centres(belief.grid.frame)
            offset = jnp.append(centres, targets.goal[None], axis=0) - position
            distance = jnp.sqrt((offset * offset).sum(axis=-1))
        else:
            distance = targets.distances(belief, position)
        remaining = jnp.append(targets.zones.remaining(belief.grid), 0.0)
        is_reached = jnp.isfinite(distance)
        cost = self.weight * jnp.where(is_reached, distance, 0.0)
        return targets.choose(belief, jnp.where(is_reached, remaining - cost, -jnp.inf))


class TrajectoryChoice(TargetChoice):
    """The zone on the way to which most is learned for the way's length:

        score_z = information(path_z) - weight * length(path_z)

    with path_z the positions of a robot that walks there, down the cost to go (`Targets.cost_to`),
    looking where it goes. It ends at the zone: a robot that has arrived, or stands still, looks no
    more. The least cost, `-score`, wins. Zones to which no way leads and depleted ones are left
    out. The goal is chosen if and only if all zones are depleted.

    Source: target selection by trajectory in the quadrotor design notes, whose paths are straight.

    Args:
        targets: the zones, the goal, and the ways there.
        information: what the scans along a path are worth together, by any of its methods.
        walk: how the robot goes there; what lies beyond its last step does not count. 40 steps of
            0.25 s at 2 m/s when absent.
        weight: of the length of a path [nat/m].

    Raises:
        ValueError: a negative weight.
    """

    targets: Targets
    information: TrajectoryInformation
    walk: GradientReference
    weight: Scalar

    def __init__(
        self,
        targets: Targets,
        information: TrajectoryInformation,
        walk: GradientReference | None = None,
        weight: ArrayLike = 1.0,
    ) -> None:
        self.targets = targets
        self.information = information
        self.walk = GradientReference(2.0, 40, 0.25) if walk is None else walk
        self.weight = _checks.scalar("weight", weight, at_least=0.0)

    def __call__(self, belief: Belief, position: Position) -> TargetScores:
        """Return the scores of all targets and the choice."""

        def value(target: GridMask) -> Scalar:
            field, leads = self.targets.way(belief, target, position)
            path = follow(self.walk, field, belief, jnp.append(position, 0.0))[:, :2]
            return jnp.where(leads, self.worth(belief.grid, position, path), -jnp.inf)

        return self.targets.choose(belief, jax.vmap(value)(self.targets.masks(belief.grid)))

    def worth(self, grid: OccupancyGrid, start: Position, path: Float[Array, "T 2"]) -> Scalar:
        """Return what is learned along a path less what its length costs [nat].

        Args:
            grid: what is known.
            start: where the robot is (x, y) [m].
            path: where it is after each step; it ends where the robot first stands still.
        """
        step = jnp.diff(path, axis=0, prepend=start[None])
        length = jnp.sqrt((step * step).sum(axis=-1)).sum()
        looks = (step != 0.0).any(axis=-1).at[0].set(True)
        nowhere = grid.frame.to_world(jnp.full(2, -1.0))  # off the map nothing is learned
        scans = jnp.where(looks[:, None], path, nowhere)
        return self.information(grid, scans, path_headings(path)) - self.weight * length


class TargetReference(StrategicReference):
    """Go to the target that a rule picks, down the cost to go there.

    It ends where the way does: a robot at an open node of the zone stands still until the zone is
    depleted or another one scores higher.

    Where no way leads to it the robot follows the guidance field, which knows where a way may yet
    be found: a robot that stood still would learn of none.

    Source: the sequential planner of the quadrotor design notes, which goes in a straight line.

    Args:
        choice: the rule; ways keep the clearance of its `targets`.
        walk: how the robot goes there; the notes' 40 steps of 0.05 s at 2 m/s when absent.
    """

    choice: TargetChoice
    walk: GradientReference

    def __init__(self, choice: TargetChoice, walk: GradientReference | None = None) -> None:
        self.choice = choice
        self.walk = GradientReference() if walk is None else walk

    def __call__(
        self, belief: Belief, potential: ScalarField, start: Float[Array, "3"]
    ) -> Float[Array, "T 3"]:
        """Return the positions after 1 ... T steps [m]; the potential is not read."""
        targets = self.choice.targets
        index = self.choice(belief, start[:2]).index
        field, leads = targets.way(belief, targets.masks(belief.grid)[index], start[:2])
        there = follow(self.walk, field, belief, start)
        around = follow(self.walk, belief.guidance, belief, start)
        return jnp.where(leads, there, around)


def _nearest(
    roads: Roadmap, position: Position
) -> tuple[Bool[Array, "rows columns"], Float[Array, "rows columns"]]:
    """Return the open nodes nearest to a position, and how far away [m] all nodes are.

    None is near a position that is not finite.
    """
    row, column = roads.frame.to_grid(position)
    rows, columns = (jnp.arange(size, dtype=jnp.float32) + 0.5 for size in roads.is_open.shape)
    square = (rows - row)[:, None] ** 2 + (columns - column)[None, :] ** 2
    away = jnp.where(roads.is_open, jnp.sqrt(square), jnp.inf)
    is_near = jnp.isfinite(away) & (away <= away.min() + TIE)
    return is_near, away * roads.frame.resolution
