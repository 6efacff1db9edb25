"""Rules by which the sequential planner selects a zone."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, GridMask, Position, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.information.trajectory import TrajectoryInformation, path_headings
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.planning.strategy.gradient_reference import GradientReference
from jaxplore.planning.strategy.references import ReferenceStart, descend
from jaxplore.planning.strategy.targets import TargetChoice, Targets, TargetScores


class RemainingInformation(TargetChoice):
    """Selects the zone with much remaining uncertainty at a short distance:

        score_z = remaining_z - weight * distance_z

    with `remaining` the mean of `4 p (1 - p)` over the cells of the zone and `distance` the length
    of the shortest path, infinite where there is none. Depleted zones are left out. The goal is
    selected if and only if all zones are depleted.

    Source: the sequential planner of the quadrotor design notes. Its distances are straight lines
    to the centres of the zones (`straight`), which ignore walls. Distances on the map are an
    addition.

    Args:
        targets: zones, goal, and the paths to them.
        weight: weight of the distance [1/m].
        straight: whether distances are straight lines; static.

    Raises:
        ValueError: a negative weight.
    """

    targets: Targets
    weight: Scalar
    straight: bool = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self, targets: Targets, weight: ArrayLike = 0.05, *, straight: bool = False
    ) -> None:
        self.targets = targets
        self.weight = _checks.scalar("weight", weight, at_least=0.0)
        self.straight = _kinds.flag("straight", straight)

    def __call__(self, belief: Belief, start: ReferenceStart) -> TargetScores:
        """Score all targets and select one."""
        targets = self.targets
        if self.straight:
            centres = targets.zones.centres(belief.grid.frame)
            offset = jnp.append(centres, targets.goal[None], axis=0) - start.position[:2]
            distance = jnp.sqrt((offset * offset).sum(axis=-1))
        else:
            distance = targets.distances(belief, start.pose)
        # The goal has no uncertainty of its own; `choose` takes it only when no zone remains.
        remaining = jnp.append(targets.zones.uncertainty(belief.grid), 0.0)
        # Masked before the product: a weight of 0 times an infinite distance is NaN.
        is_reached = jnp.isfinite(distance)
        cost = self.weight * jnp.where(is_reached, distance, 0.0)
        return targets.choose(belief, jnp.where(is_reached, remaining - cost, -jnp.inf))


class TrajectoryChoice(TargetChoice):
    """Selects the zone whose path has the most information for its length:

        score_z = information(path_z) - weight * length(path_z)

    with path_z the positions of a robot that descends the cost to go (`Targets.cost_to`), facing
    the direction of motion. Scans are counted while it moves: once it has arrived, or stands still,
    they add nothing. Depleted zones and zones without a path are left out. The goal is selected if
    and only if all zones are depleted.

    Source: target selection by trajectory in the quadrotor design notes, whose paths are straight.

    Args:
        targets: zones, goal, and the paths to them.
        information: joint information of the scans along a path, by any of its methods.
        gradient_reference: gradient ascent that makes the path; nothing beyond its last step
            counts. 40 steps of 0.25 s at 2 m/s when absent.
        weight: weight of the length of a path [nat/m].

    Raises:
        ValueError: a negative weight.
    """

    targets: Targets
    information: TrajectoryInformation
    gradient_reference: GradientReference
    weight: Scalar

    @_kinds.check_arguments
    def __init__(
        self,
        targets: Targets,
        information: TrajectoryInformation,
        gradient_reference: GradientReference | None = None,
        weight: ArrayLike = 1.0,
    ) -> None:
        self.targets = targets
        self.information = information
        self.gradient_reference = (
            GradientReference(2.0, 40, 0.25) if gradient_reference is None else gradient_reference
        )
        self.weight = _checks.scalar("weight", weight, at_least=0.0)

    def __call__(self, belief: Belief, start: ReferenceStart) -> TargetScores:
        """Score all targets and select one."""

        def value(target: GridMask) -> Scalar:
            field, is_reachable = self.targets.route(belief, target, start.pose)
            path = descend(self.gradient_reference, field, belief, start)[:, :2]
            worth = self.worth(belief.grid, start.position[:2], path)
            return jnp.where(is_reachable, worth, -jnp.inf)

        return self.targets.choose(belief, jax.vmap(value)(self.targets.masks(belief.grid)))

    def worth(self, grid: OccupancyGrid, start: Position, path: Float[Array, "T 2"]) -> Scalar:
        """Compute the information of the scans along a path minus the cost of its length [nat].

        Args:
            grid: map that the robot knows.
            start: (2,) position of the robot [m].
            path: (T, 2) position after each step [m]; it ends where the robot first stands still.
        """
        step = jnp.diff(path, axis=0, prepend=start[None])
        length = jnp.sqrt((step * step).sum(axis=-1)).sum()
        # The first scan counts even if the robot does not move.
        is_scan = (step != 0.0).any(axis=-1).at[0].set(True)
        # Shapes are static: scans that do not count are moved off the map, where they see nothing.
        off_map = grid.frame.to_world(jnp.full(2, -1.0))
        scans = jnp.where(is_scan[:, None], path, off_map)
        return self.information(grid, scans, path_headings(path)) - self.weight * length
