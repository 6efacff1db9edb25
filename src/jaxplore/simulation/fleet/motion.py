"""The motion of the robots of a fleet among what is solid, before contact with one another."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
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


def stack_parts(
    records: Sequence[ExplorationRecord], together: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the records of parts of a `FleetRecord`, by name.

    `together` are those of what all robots know together. The others are those of each robot (N,).
    """
    apart = [
        {name: each for name, each in one.parts.items() if name not in together} for one in records
    ]
    return {**stack_trees(apart), **together}


def stack_errors(records: Sequence[ExplorationRecord]) -> dict[str, Array]:
    """Return the fields (N,) of a `FleetRecord` of robots that find their pose."""
    rows = {
        name: [getattr(each, name) for each in records] for name in ("pose_error", "uncertainty")
    }
    return {name: jnp.stack(each) for name, each in rows.items() if each[0] is not None}
