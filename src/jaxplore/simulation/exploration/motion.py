"""The motion of the robot in the true world during a control period."""

import jax.numpy as jnp

from jaxplore._types import ControlVector, Count, Flag, Scalar
from jaxplore.control.base import Info
from jaxplore.dynamics.base import Dynamics
from jaxplore.report.exploration.data import ExplorationRecord
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
) -> ExplorationRecord:
    """Move the robot, unless it would touch something solid, and return the record of the step.

    Args:
        robot: true model of the robot.
        state: state of the task before the step.
        control: (nu,) control of the step.
        truth: the true world at the end of the step.
        period: control period [s].
        reach: number of cells that are examined in each direction, see `clearance_reach`.
        info: diagnostics of the controller.
        is_faulty: whether a fault is active.
        stop: why the guard stops the robot; None without a guard.
    """
    moved = robot.step(state.robot, control, period)
    stopped, is_collision = truth.stopped(robot, state.robot, moved, reach)
    return ExplorationRecord(
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
    )
