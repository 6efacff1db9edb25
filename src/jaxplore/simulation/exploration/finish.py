"""When an exploration is finished or given up, and what counts then."""

import math
from collections.abc import Sequence

from jaxplore._types import Count, Flag, Scalar
from jaxplore.dynamics._bounds import bound_of_speed
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.report.exploration.data import MapProgress
from jaxplore.robot.robot import Knowledge

NEVER = "never"
TARGETS = ("coverage", "information", "walls", NEVER)
"""What an exploration may end by; a patrol by nothing."""
_COVERAGE, _INFORMATION, _WALLS, _ = range(len(TARGETS))
DONE_AFTER = 3.0
"""Time without a place that is worth a visit after which a robot has nothing left to learn [s]."""
PATIENCE = 60.0
"""Time without progress beyond that of a drive across the map and back [s]."""


def default_give_up_after(world: OccupancyGrid | VoxelGrid, robot: Dynamics) -> float:
    """Return the time without progress after which an exploration is given up [s].

    It is `PATIENCE + 2 L / v`: the robot may drive the diagonal L of the map twice at its greatest
    speed v before it sees something new. A model without a greatest speed counts as 1 m/s.
    """
    bound = bound_of_speed(robot)
    speed = 1.0 if bound is None else float(bound)
    return PATIENCE + 2.0 * world.resolution * math.hypot(*world.shape) / speed


def has_coverage_target(target_coverage: Scalar) -> Flag:
    """Check for a target coverage; one above 1, which no run reaches, stands for none."""
    return target_coverage <= 1.0


def choose_target(target: str | None, *, has_coverage: bool, is_patrol: bool) -> str:
    """Return what an exploration ends by, one of `TARGETS`; chosen when absent.

    The choice is the target coverage if there is one. Otherwise it is nothing on a patrol, where
    all must be seen again and again, and else what the robot can learn.

    Raises:
        ValueError: another word; a target that needs a target coverage, without one.
    """
    if target is None:
        return "coverage" if has_coverage else NEVER if is_patrol else "information"
    if target not in TARGETS:
        raise ValueError(f"target is {target!r}; accepted: {', '.join(TARGETS)}")
    if target in ("coverage", "walls") and not has_coverage:
        raise ValueError(
            f"target is {target!r} without a target_coverage; accepted: with a share in (0, 1]"
        )
    return target


def is_finished(
    progress: MapProgress,
    is_told: Flag | None,
    target: Count,
    target_coverage: Scalar,
    known: Knowledge,
    is_there: Flag | None,
    max_unknown: Scalar | None,
    *,
    counts_walls: bool = False,
) -> Flag:
    """Check whether an exploration is finished; see `ExplorationScenario`.

    `target` is what it ends by, an index into `TARGETS`. `is_told` is what truths of parts say,
    which counts instead; None if they say nothing. `target_coverage` is a share of the reachable
    cells, or of the walls if `counts_walls`, which is static. `is_there` says whether the goal is
    reached; None without a goal. `max_unknown` is the share of unknown cells below which the map is
    explored; None without a goal.
    """
    is_done = known.idle >= DONE_AFTER
    if is_told is not None:
        is_covered = is_told
    else:
        # The target is traced, so that a search or an environment may change it.
        share = known.walls if counts_walls else progress.coverage
        ends_by_share = (target == _COVERAGE) | (target == _WALLS)
        is_covered = ends_by_share & (share >= target_coverage) | (target == _INFORMATION) & is_done
    if is_there is None or max_unknown is None:
        return is_covered
    # What a part is about is an end of its own, however much of the map is known.
    if is_told is None:
        is_covered |= is_done | (progress.unknown_map < max_unknown)
    return is_there & is_covered


def default_objective(
    target: str, ends: Sequence[str], endless: Sequence[str], *, has_goal: bool
) -> str:
    """Return the default objective: time to the end, plus contacts.

    `ends` are metrics of truths that end the task, the first of which takes the place of the time.
    For a run without an end it is the first of the metrics `endless`, if there are any.
    """
    is_endless = not has_goal and target == NEVER
    found = next(iter((*ends, *(endless if is_endless else ()))), "finished_at")
    return f"{found} + 100*collisions"
