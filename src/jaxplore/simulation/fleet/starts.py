"""Starts of the robots of a fleet: checked if given, chosen near one another if not."""

import math
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_ROBOTS
from jaxplore._types import Rows
from jaxplore.dynamics.formation import extent
from jaxplore.simulation.exploration.reachability import to_grid
from jaxplore.simulation.exploration.scenario import ExplorationScenario

APART = 0.4
"""Least distance between the edges of two robots at starts that are chosen [m]."""


@_kinds.check_arguments
def near_starts(scenario: ExplorationScenario, number: int) -> np.ndarray:
    """Choose starts (N, 3) around that of a robot, with its heading [m, m, rad].

    The first is that of the scenario. Each further one is the nearest place to it from which the
    others are `APART` and where the robot has as much room as it needs to turn. Nothing is random.

    Args:
        scenario: exploration of one robot.
        number: number of robots, N.

    Raises:
        ValueError: less than one robot, more than there is room for.
    """
    number = _checks.positive_int("robots", number, at_most=MOST_ROBOTS)
    import scipy.ndimage  # slow to import, and few need it

    world, robot = scenario.world, scenario.robot
    first = np.asarray(robot.pose(scenario.start), np.float64)
    cells = np.pad(np.asarray(scenario.reachable), 1)
    # Reachable are places of the robot's centre. Off their border it has room to turn as well.
    inside = scipy.ndimage.distance_transform_edt(cells)[1:-1, 1:-1] * world.resolution
    spare = max(extent(robot.footprint) - float(robot.radius), 0.0) + world.resolution
    places = np.argwhere(inside > spare)
    centres = np.asarray(world.frame.cell_centre(jnp.asarray(places)), np.float64).reshape(-1, 2)
    away = np.hypot(*(centres - first[:2]).T)
    apart = 2.0 * extent(robot.footprint) + APART
    chosen = [first[:2]]
    # A stable order makes the choice the same on every machine.
    for index in np.lexsort((places[:, 1], places[:, 0], np.round(away, 6))):
        if len(chosen) == number:
            break
        place = centres[index]
        if all(math.dist(place, other) >= apart for other in chosen):
            chosen.append(place)
    if len(chosen) < number:
        raise ValueError(
            f"robots is {number}; accepted: at most {len(chosen)}, for which there is room around "
            f"the start ({first[0]:g}, {first[1]:g})"
        )
    return np.column_stack([chosen, np.full(number, first[2])]).astype(np.float32)


def check_starts(scenarios: Sequence[ExplorationScenario], starts: Rows | None) -> np.ndarray:
    """Return the starts (N, 3) of a fleet [m, m, rad]; those of the scenarios when absent.

    Raises:
        ValueError: another shape; a start where its robot cannot stand or from which it cannot
            reach the others; two robots that touch.
    """
    number = len(scenarios)
    if starts is None:
        given = np.array([one.robot.pose(one.start) for one in scenarios], np.float32)
    else:
        given = _checks.floats("starts", starts, f"({number}, 3), a pose (x, y, yaw) of each robot")
    if given.shape != (number, 3) or not np.isfinite(given).all():
        raise ValueError(
            f"starts is {np.asarray(given).tolist()}; accepted: ({number}, 3) finite numbers, a "
            "pose (x, y, yaw) of each robot"
        )
    for index, (one, pose) in enumerate(zip(scenarios, given, strict=True)):
        cell = np.floor(np.asarray(to_grid(one.world.frame, jnp.asarray(pose[:2])))).astype(int)
        reachable = np.asarray(one.reachable)
        is_on_map = (cell >= 0).all() and (cell < reachable.shape).all()
        if not (is_on_map and reachable[tuple(cell)]):
            x, y = one.datum.round_to_map(pose[:2]).tolist()
            raise ValueError(
                f"starts[{index}] is ({x:g}, {y:g}); accepted: free space that the first robot can "
                "reach"
            )
    sizes = [extent(one.robot.footprint) for one in scenarios]
    for j in range(number):
        for i in range(j):
            gap, least = math.dist(given[i, :2], given[j, :2]), sizes[i] + sizes[j]
            if gap < least:
                raise ValueError(
                    f"starts[{i}] and starts[{j}] are {gap:.2f} m apart, where the robots touch; "
                    f"accepted: at least {least:.2f} m"
                )
    return np.asarray(given, np.float32)
