"""The motion of the robots of a fleet among what is solid, before contact with one another."""

from collections.abc import Mapping, Sequence
from typing import Any

from jaxtyping import Array

from jaxplore._trees import stack_trees
from jaxplore.control.base import Info
from jaxplore.control.fleet_share import Share
from jaxplore.dynamics.base import Dynamics
from jaxplore.report.exploration.data import ExplorationRecord
from jaxplore.simulation.exploration.motion import move
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.state import Moment


def moves(
    robots: Sequence[tuple[ExplorationScenario, Dynamics]],
    share: Share,
    members: Sequence[ExplorationState],
    before: Sequence[Array],
    controls: Sequence[Array],
    moment: Moment,
    info: Info,
) -> list[tuple[ExplorationRecord, dict[str, Any]]]:
    """Move each robot for a control period, unless it would touch something solid; see `move`.

    Return the record of each, and the states of the truths of its parts.

    `robots` are the exploration and the true model of each. Every process moves all robots. Of one
    that another process computes, nothing but the record's state, clearance and collision is meant.
    `members` are the states of the robots of `share`, which this process computes.
    """
    here = dict(zip(share.mine, members, strict=True))
    records = []
    given = zip(robots, before, controls, strict=True)
    for index, ((one, true_robot), robot, control) in enumerate(given):
        # What is read of another state than the robot's is the same for equal robots.
        each = here.get(index, members[0])._replace(robot=robot)
        period = robots[0][0].control_period
        # What moves does so during the step as well, so contact is with where it is at its end.
        truth = one.true_world(each, moment._replace(time=moment.time + period))
        moved = move(
            true_robot,
            each,
            control,
            truth,
            period=period,
            reach=one.clearance_reach,
            info=info,
            is_faulty=moment.is_faulty,
            stop=None,
            truths=one.truths,
        )
        records.append(moved)
    return records


def stack_records(
    records: Sequence[ExplorationRecord], together: Mapping[str, Any]
) -> ExplorationRecord:
    """Return the record of all robots, in which fields have an axis of robots (N,).

    `together` are the records of parts, by name, that judge what all robots know together. The
    states, the controls and what is counted on one map are left out.
    """
    alone = [
        each._replace(
            state=None,
            control=None,
            entropy=None,
            unknown=None,
            unknown_map=None,
            members=None,
            parts={name: own for name, own in each.parts.items() if name not in together},
        )
        for each in records
    ]
    every: ExplorationRecord = stack_trees(alone)
    return every._replace(parts={**every.parts, **together})
