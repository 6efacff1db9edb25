"""The compiled steps of a pilot: its start, mapping, fields, and the plan with its check."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore._types import ControlVector, Count, Flag, GridMask, Key, Pose, Scalar, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.belief.perception import Perception
from jaxplore.belief.tracks import ObstacleTracker
from jaxplore.control.base import Controller
from jaxplore.control.latency import predicted_state
from jaxplore.control.plausibility import MAX_MISFIT, scan_misfit
from jaxplore.control.validation import StopCheck
from jaxplore.dynamics.base import Dynamics
from jaxplore.robot.localisation import corrected_state
from jaxplore.sensing.beams import Scan
from jaxplore.simulation.exploration.frames import frame_arrays
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.exploration.state import ExplorationState

NUM_AHEAD = 10
"""Number of commands of a plan that are kept, for deadlines that are missed."""


SPEED_TOLERANCE = {"v": 0.3, "vx": 0.3, "vy": 0.3, "omega": 0.6, "steering": 1.0}
"""Greatest difference of a predicted component from the commanded one for which the commanded one
is used [m/s, rad/s, rad]. A steering angle is not measured."""


class Planned(NamedTuple):
    """A command and the plan behind it.

    Args:
        controls: (N, nu) controls of the coming periods; the first row is the command.
        twists: (N, 3) velocities (vx, vy, omega) at the end of these periods, in the robot's frame.
        memory: state of the controller.
        state: (nx,) state in which the command takes effect.
        after: (nx,) state after the first period.
        is_finite: whether the state, the plan and the command are finite.
        is_replaced: whether the check replaced the command.
        gap: least distance from the scan until the robot could stand [m].
        effective_sample_size: of the rollouts.
    """

    controls: Float[Array, "N nu"]
    twists: Float[Array, "N 3"]
    memory: Any
    state: StateVector
    after: StateVector
    is_finite: Flag
    is_replaced: Flag
    gap: Scalar
    effective_sample_size: Scalar


class Mapped(NamedTuple):
    """A belief after a scan.

    Args:
        belief: the belief.
        is_free: (H, W) cells that are known to be free.
        is_misfit: whether the scan contradicted the map.
    """

    belief: Belief
    is_free: GridMask
    is_misfit: Flag


@eqx.filter_jit
def initial(scenario: ExplorationScenario, key: Key | None = None) -> ExplorationState:
    """Return the state before the first scan. Without a program it takes seconds."""
    return scenario.init(key)[0]


@eqx.filter_jit
def observe(
    perception: Perception,
    belief: Belief,
    scan: Scan,
    pose: Pose,
    elapsed: Scalar,
    is_changed: Flag,
) -> Mapped:
    """Update the map by a scan that fits it; see `Perception.observe`.

    Args:
        perception: perception of the task.
        belief: the belief before the scan.
        scan: the scan.
        pose: pose of the lidar (x, y, yaw) [m, m, rad].
        elapsed: time since the last mapped scan [s].
        is_changed: whether the world has changed, so that a scan that does not fit is mapped.
    """
    is_misfit = scan_misfit(belief, perception.sensors[0], scan, pose) > MAX_MISFIT
    belief = jax.lax.cond(
        is_misfit & ~is_changed,
        lambda: belief,
        lambda: perception.observe(belief, scan, pose, elapsed),
    )
    return Mapped(belief, belief.grid.is_free, is_misfit)


@eqx.filter_jit
def free_cells(belief: Belief) -> GridMask:
    """Return the cells (H, W) of a map that are known to be free."""
    return belief.grid.is_free


@eqx.filter_jit
def derive(
    perception: Perception, belief: Belief, pose: Pose, elapsed: Scalar
) -> tuple[Belief, Scalar]:
    """Update the fields; return them, and the cost-to-go of the guidance field at the robot [m]."""
    belief = perception.update_fields(belief, pose, elapsed)
    return belief, belief.guidance(pose[:2])


def corrected(
    robot: Dynamics, state: np.ndarray, before: np.ndarray, after: np.ndarray
) -> np.ndarray:
    """Return a state (nx,) moved by a correction of the robot's pose.

    Args:
        robot: model of the robot.
        state: (nx,) the state.
        before: (3,) pose before the correction [m, m, rad].
        after: (3,) pose after it.
    """
    given = (each.astype(np.float32) for each in (state, before, after))
    return np.asarray(_corrected(robot, *jax.device_put(tuple(given))))


@eqx.filter_jit
def _corrected(robot: Dynamics, state: StateVector, before: Pose, after: Pose) -> StateVector:
    return corrected_state(robot, state, before, after)


class PlanInputs(NamedTuple):
    """What a plan starts from.

    Args:
        state: (nx,) newest measured state.
        expected: (nx,) state that the last command leads to.
        sent: (D, nu) commands that were sent and take effect after that, oldest first.
        durations: (D,) time for which each of them has effect [s]; 0 for none.
        points: (P, 2) points of the newest scan [m].
        is_point: (P,) points that count.
        elapsed: time since the last command [s].
        number: number of the step, for its random key.
        age: time from the newest scan to the effect of the command [s].
        since_map: time from the newest scan in the map to the effect of the command [s].
    """

    state: StateVector
    expected: StateVector
    sent: Float[Array, "D nu"]
    durations: Float[Array, " D"]
    points: Float[Array, "P 2"]
    is_point: Bool[Array, " P"]
    elapsed: Scalar
    number: Count
    age: Scalar
    since_map: Scalar


@eqx.filter_jit
def plan(
    controller: Controller,
    robot: Dynamics,
    check: StopCheck,
    tracker: ObstacleTracker | None,
    memory: Any,
    belief: Any,
    inputs: PlanInputs,
    period: Scalar,
    key: Key,
) -> Planned:
    """Predict the state in which a command takes effect, plan from there, and check the command.

    Args:
        controller: controller of the robot.
        robot: model of the robot, by which the state is predicted.
        check: check of the command against the scan.
        tracker: what tracks moving obstacles; None if nothing moves.
        memory: state of the controller.
        belief: what the robot knows.
        inputs: what the plan starts from.
        period: control period [s].
        key: random key of the drive.
    """
    key = jax.random.fold_in(key, inputs.number)
    start = predicted_state(robot, inputs.state, inputs.sent, inputs.durations)
    start = _with_commanded_speeds(robot, start, inputs.expected)
    adapted = controller.at_period(inputs.elapsed)
    points, is_point, speeds = inputs.points, inputs.is_point, None
    if tracker is not None and belief.tracks is not None and belief.obstacles is not None:
        speeds = tracker.possible_speeds(belief.tracks, belief.clearance, points, is_point)
        later = belief.obstacles.after(inputs.since_map)
        belief = dataclasses.replace(belief, obstacles=later)
    control, memory, info = adapted.step(memory, start, belief, key=key)
    is_wall = None if speeds is None else is_point & (speeds == 0.0)
    checked = check(robot, start, control, period, points, is_point, speeds, inputs.age, is_wall)
    controls = _ahead(controller, info.controls, checked.control, period)

    def step(at: StateVector, each: ControlVector) -> tuple[StateVector, tuple[Array, Array]]:
        after = robot.step(at, each, period)
        return after, (after, robot.twist(after, each))

    _, (states, twists) = jax.lax.scan(step, start, controls)
    is_finite = (
        info.is_finite
        & jnp.isfinite(start).all()
        & jnp.isfinite(twists).all()
        & jnp.isfinite(control).all()
    )
    return Planned(
        controls,
        twists,
        memory,
        start,
        states[0],
        is_finite,
        checked.is_replaced,
        checked.gap,
        info.effective_sample_size,
    )


def _with_commanded_speeds(
    robot: Dynamics, predicted: StateVector, expected: StateVector
) -> StateVector:
    """Return the predicted state with the speeds that were commanded, where they are close to it.

    The robot's own controller makes it drive as fast as commanded. A measured speed is older than
    the last command, and a latency that is not known exactly would make successive commands start
    from different speeds. A robot that was slowed down by something else has its measured speed.
    """
    tolerance = jnp.asarray([SPEED_TOLERANCE.get(name, 0.0) for name in robot.state_names])
    is_close = jnp.abs(predicted - expected) < tolerance
    return jnp.where(is_close, expected, predicted)


def _ahead(
    controller: Controller, planned: Float[Array, "T nu"], first: ControlVector, period: Scalar
) -> Float[Array, "N nu"]:
    """Return the controls of the coming periods from a plan of model steps."""
    # Every controller plans in model steps of its own; those without a step plan in periods.
    model_step = getattr(controller, "dt", period)
    numbers = jnp.arange(NUM_AHEAD, dtype=jnp.float32)
    index = jnp.floor(numbers * period / model_step + 1e-3).astype(jnp.int32)
    rows = planned[jnp.clip(index, 0, planned.shape[0] - 1)]
    return rows.at[0].set(first)


@eqx.filter_jit
def frame(
    scenario: ExplorationScenario,
    controller: Controller,
    memory: Any,
    state: ExplorationState,
    scan: Scan,
    key: Key,
    num_trajectories: int,
) -> dict[str, Any]:
    """Return the arrays of an `ExplorationFrame` with the plan of the coming step."""
    planned = None
    if num_trajectories:
        planned = controller.inspect(
            memory, state.robot, state.belief, key=key, num_trajectories=num_trajectories
        )
    sensor = scenario.sensors[0]
    return frame_arrays(scenario.robot, sensor, state, scan, None, planned)
