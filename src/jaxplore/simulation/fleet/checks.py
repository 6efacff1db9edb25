"""Checks of the explorations of a fleet."""

from collections.abc import Sequence

import numpy as np

from jaxplore import _kinds
from jaxplore._limits import MOST_ROBOTS
from jaxplore._types import Rows
from jaxplore.simulation.disturbances import Disturbance
from jaxplore.simulation.exploration.scenario import ExplorationScenario


def check_members(
    robots: ExplorationScenario | Sequence[ExplorationScenario], starts: Rows | None
) -> tuple[ExplorationScenario, ...]:
    """Return the exploration of each robot of a fleet.

    A single exploration stands for as many equal robots as there are starts (N, 3), or for one
    without starts.

    Raises:
        ValueError: no robots or too many, explorations that a fleet does not support, different
            worlds or rates.
    """
    if isinstance(robots, ExplorationScenario):
        number = 1 if starts is None else len(np.atleast_1d(np.asarray(starts, object)))
        # The same arrays stand for all equal robots, so N robots need no more memory for them.
        members = (robots,) * number
    else:
        _kinds.instances("robots", robots, ExplorationScenario)
        members = tuple(robots)
    if not 1 <= len(members) <= MOST_ROBOTS:
        raise ValueError(f"robots is {len(members)}; accepted: from 1 to {MOST_ROBOTS} robots")
    for index, each in enumerate(members):
        _check_supported(index, each)
    first = members[0]
    check_disturbances(first.disturbed_by, len(members))
    for index, each in enumerate(members[1:], start=1):
        is_same = each.map_arrays.world.shape == first.map_arrays.world.shape and np.array_equal(
            each.map_arrays.world.probability, first.map_arrays.world.probability
        )
        if each is not first and not is_same:
            raise ValueError(f"robots[{index}] is in another world; accepted: that of robots[0]")
        if not np.array_equal(each.targets, first.targets):
            raise ValueError(
                f"targets of robots[{index}] differ; accepted: those of robots[0], for which all "
                "robots look"
            )
        ends = [
            None if one.goal is None else np.asarray(one.goal).tolist() for one in (each, first)
        ]
        if ends[0] != ends[1]:
            raise ValueError(
                f"goal of robots[{index}] is {ends[0]}; accepted: that of robots[0], {ends[1]}"
            )
        for name in ("guard", "localisation"):
            if (getattr(each, name) is None) != (getattr(first, name) is None):
                raise ValueError(
                    f"{name} of robots[{index}] differs; accepted: as robots[0], with one or "
                    "without"
                )
        names = [[part.name for part in one.perception.parts] for one in (each, first)]
        if names[0] != names[1]:
            raise ValueError(
                f"parts of robots[{index}] are {names[0]}; accepted: those of robots[0], {names[1]}"
            )
        names = [[truth.name for truth in one.truths] for one in (each, first)]
        if names[0] != names[1]:
            raise ValueError(
                f"truths of robots[{index}] are {names[0]}; accepted: those of robots[0], "
                f"{names[1]}"
            )
        for name in ("control_period", "steps_per_scan", "steps_per_field"):
            here, there = (np.asarray(getattr(one, name)).item() for one in (each, first))
            if here != there:
                raise ValueError(
                    f"{name} of robots[{index}] is {here:g}; accepted: {there:g}, that of robots[0]"
                )
    return members


def check_disturbances(disturbances: Sequence[Disturbance], number: int) -> None:
    """Check that disturbances can happen to each of a number of robots."""
    if number > 1:
        for each in disturbances:
            each.check_team(number)


def _check_supported(index: int, one: ExplorationScenario) -> None:
    """Raise a `ValueError` if a fleet does not support what an exploration has."""
    if one.target == "walls":
        raise ValueError(
            f"target of robots[{index}] is {one.target!r}; accepted in a fleet: 'coverage', 'never'"
        )
    for each in one.perception.parts:
        each.check_fleet()


def identities(starts: np.ndarray) -> np.ndarray:
    """Return the number of each robot (N,) by the order of the starts (N, 3) by x, y and yaw.

    It moves with the robot when the robots are given in another order.
    """
    order = np.lexsort(starts.T[::-1])
    numbers = np.empty(len(starts), np.int32)
    numbers[order] = np.arange(len(starts), dtype=np.int32)
    return numbers
