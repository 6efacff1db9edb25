"""Explorers that choose a target by a rule and drive to it like `explorer`."""

from typing import Any

from jaxplore import _kinds
from jaxplore.belief.perception import Perception
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.planning.presets.explorer import explorer
from jaxplore.planning.strategy.target_explorer import TargetExplorer
from jaxplore.planning.strategy.target_rules import RULES, TargetRule


@_kinds.check_arguments
def target_explorer(
    robot: Dynamics,
    rule: TargetRule | str,
    perception: Perception,
    grid: OccupancyGrid,
    *,
    every: int = 10,
    **driving: Any,
) -> TargetExplorer:
    """Build an explorer that drives from target to target.

    Routes to a target run on the nodes of the perception's fields and keep its clearance. A
    position is a target only if a scan from it has the perception's `min_information`.

    Args:
        robot: model of the robot.
        rule: rule that chooses the next target, or its name in `RULES`.
        perception: perception of the scenario.
        grid: a map with the shape and resolution of the scenario's.
        every: number of commands between choices: 10 for commands at 50 Hz and fields at 5 Hz.
        driving: parameters of `explorer`, which drives. A robot with a full-circle sensor drives
            with an `information_weight` of 0: the rule alone decides where to look. Any other
            robot must turn its sensor to the target, and stays until it has scanned it.

    Raises:
        ValueError: a rule that is not in `RULES`, a part of another class, or a value that a part
            rejects.
    """
    rule = check_rule(rule)
    looks_around = perception.sensors[0].is_full_circle
    if looks_around:
        driving = {**driving, "information_weight": 0.0}
    return TargetExplorer(
        explorer(robot, **driving),
        rule,
        grid.frame,
        # A scenario pads its map, and the fields of its belief have that shape.
        grid.pad().shape,
        perception.field_sensor.stride,
        required_clearance=perception.required_clearance,
        min_information=perception.min_information,
        every=every,
        stays=not looks_around,
        locomotion=perception.locomotion,
    )


def check_rule(rule: TargetRule | str) -> TargetRule:
    """Return a rule that is given as one or by its name in `RULES`; refuse anything else."""
    if isinstance(rule, str):
        if rule not in RULES:
            raise ValueError(f"rule is {rule!r}; accepted: {', '.join(RULES)}")
        return RULES[rule]()
    _kinds.instance("rule", rule, TargetRule, hint=f"or one of {', '.join(RULES)}")
    return rule
