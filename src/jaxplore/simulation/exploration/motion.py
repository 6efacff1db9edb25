"""The motion of the robot in the true world during a control period."""

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp

from jaxplore._types import ControlVector, Count, Flag, Pose, Scalar
from jaxplore.control.base import Info
from jaxplore.dynamics.base import Dynamics
from jaxplore.report.exploration.data import ExplorationRecord
from jaxplore.simulation.exploration.part_truth import Drive, PartTruth
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.exploration.true_world import TrueWorld


def move(
    robot: Dynamics,
    state: ExplorationState,
    control: ControlVector,
    truth: TrueWorld,
    *,
    period: Scalar,
    reach: int,
    info: Info,
    is_faulty: Flag,
    stop: Count | None,
    truths: Sequence[PartTruth],
) -> tuple[ExplorationRecord, dict[str, Any]]:
    """Move the robot, unless it would touch something solid.

    Return the record, and the states of the truths of parts.

    `state` is the state of the task before the step, `truth` the world at the end of the step.
    `reach` cells are examined in each direction, see `clearance_reach`. `stop` is why the guard
    stops the robot; None without a guard. `truths` are what is true of its parts.
    """
    moved = robot.step(state.robot, control, period)
    drive = Drive(robot, state.robot, moved, control, truth, period)
    for each in truths:
        drive = drive._replace(after=each.drive(state.truths.get(each.name), drive))
    stopped, is_collision = truth.check_move(robot, state.robot, drive.after, reach)
    drive, states, records = drive._replace(after=stopped), dict(state.truths), {}
    for each in truths:
        if each.name in states:
            states[each.name] = each.update(states[each.name], drive)
            records[each.name] = each.record(states[each.name])
    record = ExplorationRecord(
        state=stopped,
        control=control,
        **state.progress._asdict(),
        clearance=truth.clearance(robot, stopped, reach),
        is_collision=is_collision,
        is_untraversable=truth.is_untraversable(robot, stopped, reach),
        effective_sample_size=info.effective_sample_size,
        is_finite=info.is_finite,
        is_faulty=is_faulty,
        members=info.members,
        stop=stop,
        parts={name: each for name, each in records.items() if each is not None},
        **_error(state, robot.pose(state.robot)),
    )
    return record, states


def _error(state: ExplorationState, pose: Pose) -> dict[str, Scalar]:
    """Return the error of the robot's pose in a record; nothing if it knows its pose."""
    if state.own.place is None:
        return {}
    known = state.own.place.known
    away = known.pose - pose
    return {"pose_error": jnp.hypot(away[0], away[1]), "uncertainty": known.uncertainty}
