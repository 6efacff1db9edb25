"""The motion of the robot in the true world during a control period."""

import jax.numpy as jnp

from jaxplore._types import ControlVector, Count, Flag, Pose, Scalar
from jaxplore.control.base import Info
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.chassis import Chassis
from jaxplore.report.exploration.data import ExplorationRecord
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.exploration.true_world import TrueWorld
from jaxplore.simulation.exploration.wheels import Wheels, drive_on_wheels, stability, update_wheels


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
    chassis: Chassis | None,
) -> tuple[ExplorationRecord, Wheels | None]:
    """Move the robot, unless it would touch something solid; return the record and the wheels.

    `state` is the state of the task before the step, `truth` the world at the end of the step.
    `reach` cells are examined in each direction, see `clearance_reach`. `stop` is why the guard
    stops the robot; None without a guard. `chassis` is None for a robot that cannot tip over.
    """
    moved = robot.step(state.robot, control, period)
    if state.wheels is not None:
        moved = drive_on_wheels(state.wheels, robot, state.robot, moved)
    stopped, is_collision = truth.check_move(robot, state.robot, moved, reach)
    wheels = state.wheels
    if wheels is not None and chassis is not None:
        used = stability(chassis, truth, robot, stopped, control)
        wheels = update_wheels(wheels, used, period)
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
        targets_seen=jnp.sum(state.is_seen, dtype=jnp.int32),
        stop=stop,
        **({} if wheels is None else wheels.record_fields()),
        **_error(state, robot.pose(state.robot)),
    )
    return record, wheels


def _error(state: ExplorationState, pose: Pose) -> dict[str, Scalar]:
    """Return the error of the robot's pose in a record; nothing if it knows its pose."""
    if state.own.place is None:
        return {}
    known = state.own.place.known
    away = known.pose - pose
    return {"pose_error": jnp.hypot(away[0], away[1]), "uncertainty": known.uncertainty}
