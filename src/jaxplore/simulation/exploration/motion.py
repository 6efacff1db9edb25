"""The motion of the robot in the true world during a control period."""

from collections.abc import Mapping, Sequence
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
    drive = move_parts(truths, state.truths, drive)
    stopped, is_collision = truth.check_move(robot, state.robot, drive.after, reach)
    states, parts = update_parts(truths, state.truths, drive._replace(after=stopped))
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
        parts=parts,
        **_error(state, robot.pose(state.robot)),
    )
    return record, states


def move_parts(truths: Sequence[PartTruth], states: Mapping[str, Any], drive: Drive) -> Drive:
    """Return the motion with what is true of the robot's parts, given their states by name."""
    for each in truths:
        drive = drive._replace(after=each.drive(states.get(each.name), drive))
    return drive


def update_parts(
    truths: Sequence[PartTruth], states: Mapping[str, Any], drive: Drive
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the states of the truths of parts after a motion, and their records, by name."""
    after = {
        each.name: each.update(states[each.name], drive) for each in truths if each.name in states
    }
    records = {each.name: each.record(after[each.name]) for each in truths if each.name in after}
    return {**states, **after}, {n: each for n, each in records.items() if each is not None}


def _error(state: ExplorationState, pose: Pose) -> dict[str, Scalar]:
    """Return the error of the robot's pose in a record; nothing if it knows its pose."""
    if state.own.place is None:
        return {}
    known = state.own.place.known
    away = known.pose - pose
    return {"pose_error": jnp.hypot(away[0], away[1]), "uncertainty": known.uncertainty}
