"""When an exploration is finished."""

import jax.numpy as jnp
from jaxtyping import Array, Bool

from jaxplore._types import Flag, Position, Scalar
from jaxplore.report.exploration.data import MapProgress


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
