"""What the robots of a fleet know together by their parts."""

from collections.abc import Mapping, Sequence
from typing import Any

from jaxplore._trees import stack_trees
from jaxplore.simulation.exploration.scenario import ExplorationScenario


def gather_parts(one: ExplorationScenario, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the states of parts that a robot would have which heard all, by name.

    `rows` are those of each robot, all or some of them. `one` is the exploration of a robot.
    """
    told = stack_trees(rows)
    return {
        each.name: each.gather(one.perception.part_named(each.name), told[each.name])
        for each in one.truths
        if each.name in told
    }
