"""Explorers that choose a target by a rule and drive there as `explorer` does."""

from typing import Any

from jaxplore.belief.perception import Perception
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.planning.presets.explorer import explorer
from jaxplore.planning.strategy.target_explorer import TargetExplorer
from jaxplore.planning.strategy.target_rules import RULES, TargetRule


def target_explorer(
    robot: Dynamics,
    rule: TargetRule | str,
    perception: Perception,
    grid: OccupancyGrid,
    *,
    every: int = 10,
    **driving: Any,
) -> TargetExplorer:
    """Return an explorer that goes from target to target.

    Ways to a target keep the clearance of the perception, on the nodes of its fields; what is worth
    a look is what it says.

    Args:
        robot: model of the robot.
        rule: chooses the next target; or its name in `RULES`.
        perception: perception of the scenario.
        grid: a map with the shape and resolution of the scenario's.
        every: commands between choices: 10 for commands at 50 Hz and fields at 5 Hz.
        driving: numbers of `explorer`, which drives. A robot that sees all around drives with an
            `information_weight` of 0: what is worth seeing is the rule's alone. One that does not
            has to turn to what it came for, and stays until it has seen it.

    Raises:
        ValueError: a rule that is none of `RULES`, and what the parts refuse.
    """
    if isinstance(rule, str):
        if rule not in RULES:
            raise ValueError(f"rule is {rule!r}; accepted: {', '.join(RULES)}")
        rule = RULES[rule]()
    looks_around = perception.sensors[0].is_full_circle
    if looks_around:
        driving = {**driving, "information_weight": 0.0}
    return TargetExplorer(
        explorer(robot, **driving),
        rule,
        grid.frame,
        grid.shape,
        perception.field_sensor.stride,
        required_clearance=perception.required_clearance,
        min_information=perception.min_information,
        every=every,
        stays=not looks_around,
    )
