"""When an exploration is finished or given up, and what counts then."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxplore._types import Flag, Position, Scalar
from jaxplore.dynamics._bounds import bound_of_speed
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.exploration.data import MapProgress

PATIENCE = 60.0
"""Time without progress beyond that of a drive across the map and back [s]."""


def default_give_up_after(world: OccupancyGrid, robot: Dynamics) -> float:
    """Return the time without progress after which an exploration is given up [s].

    It is `PATIENCE + 2 L / v`: the robot may drive the diagonal L of the map twice at its greatest
    speed v before it sees something new. A model without a greatest speed counts as 1 m/s.

    Args:
        world: the true map.
        robot: model of the robot.
    """
    bound = bound_of_speed(robot)
    speed = 1.0 if bound is None else float(bound)
    return PATIENCE + 2.0 * world.resolution * math.hypot(*world.shape) / speed


def has_coverage_target(target_coverage: Scalar) -> Flag:
    """Check whether there is a target coverage: one above 1, which none reaches, stands for none.

    Args:
        target_coverage: share of the reachable cells that must be known.
    """
    return target_coverage <= 1.0


def is_finished(
    position: Position,
    progress: MapProgress,
    is_seen: Bool[Array, " M"],
    target_coverage: Scalar,
    goal: Position | None,
    goal_radius: Scalar,
    max_unknown: Scalar,
) -> Flag:
    """Check whether an exploration is finished; see `ExplorationScenario`.

    Args:
        position: position of the robot [m].
        progress: statistics of the known map.
        is_seen: (M,) whether each target has been seen; with M = 0 the coverage counts instead.
        target_coverage: share of the reachable cells that must be known.
        goal: goal position (x, y) [m]; None without one.
        goal_radius: distance at which the goal is reached [m].
        max_unknown: share of unknown cells below which the map is explored; only with a goal.
    """
    has_targets = is_seen.shape[0] > 0
    is_covered = jnp.all(is_seen) if has_targets else progress.coverage >= target_coverage
    if goal is None:
        return is_covered
    offset = position - goal
    is_there = jnp.sum(offset * offset) < goal_radius**2
    # Targets are an end of their own: seeing all of them counts, not how much of the map is known.
    if not has_targets:
        is_covered |= progress.unknown_map < max_unknown
    return is_there & is_covered


def default_objective(num_targets: int, goal: Position | None, target_coverage: Scalar) -> str:
    """Return the default objective: time to the end, or the idleness of a patrol, plus contacts.

    Args:
        num_targets: number of targets.
        goal: goal position (x, y) [m]; None without one.
        target_coverage: share of the reachable cells that must be known.
    """
    if num_targets:
        return "last_target_at + 100*collisions"
    if goal is None and not has_coverage_target(target_coverage):
        return "mean_idleness + 100*collisions"
    return "finished_at + 100*collisions"
