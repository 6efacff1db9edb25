"""The closed loop of a robot that follows a path: look at what moves, plan, move."""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import ControlVector, Count, Flag, Key, Scalar, StateVector
from jaxplore.control.base import Controller
from jaxplore.costs.comfort import acceleration
from jaxplore.costs.obstacle_distance import ObstacleDistanceCost
from jaxplore.costs.path_following import ContouringCost, CorridorCost, LagCost
from jaxplore.dynamics.base import ContinuousDynamics, State
from jaxplore.simulation.chunks import loop
from jaxplore.simulation.following.scenario import PathScenario


class PathRecord(NamedTuple):
    """What is kept of each step; in a run every field has a leading axis of steps.

    Args:
        state: (nx,) after the step, with its path parameter phi.
        control: (nu,) that led to it.
        contouring: error at phi, by the object that plans [m].
        lag: error at phi [m].
        progress: arc length of the point of the path that is nearest to the robot [m]; on laps it
            goes on growing.
        deviation: distance across the path there, positive to its right [m].
        room: from the robot's edge to the edge of the corridor there [m], negative beyond it;
            infinite without one.
        gap: from the robot's edge to the nearest obstacle [m]; infinite without any.
        acceleration: (2,) along the heading and to the left [m/s^2]; not a number of a model that
            does not say.
        effective_sample_size: of the controller's rollouts.
        is_finite: whether any of them was finite.
    """

    state: StateVector
    control: ControlVector
    contouring: Scalar
    lag: Scalar
    progress: Scalar
    deviation: Scalar
    room: Scalar
    gap: Scalar
    acceleration: Float[Array, "2"]
    effective_sample_size: Scalar
    is_finite: Flag


class PathLoopState(NamedTuple):
    """All that changes.

    Args:
        robot: (nx,) state of the plant.
        controller: its state.
        step: steps done.
        progress: see `PathRecord`.
    """

    robot: StateVector
    controller: Any
    step: Count
    progress: Scalar


@eqx.filter_jit
def initial_path_state(controller: Controller, scenario: PathScenario) -> PathLoopState:
    """Return the state before the first step."""
    phi = scenario.model.component(scenario.start, "phi")
    return PathLoopState(scenario.start, controller.init(), jnp.zeros((), jnp.int32), phi)


def path_step(
    controller: Controller, scenario: PathScenario, state: PathLoopState, key: Key
) -> tuple[PathLoopState, PathRecord]:
    """Return the loop's state one control period later, and the record of it."""
    track_key, control_key = jax.random.split(jax.random.fold_in(key, state.step))
    period, model = scenario.control_period, scenario.model
    time = period * state.step.astype(jnp.float32)
    known = scenario.obstacles(time, key=track_key)
    control, memory, info = controller.step(state.controller, state.robot, known, key=control_key)
    moved = model.step(state.robot, control, period)
    # A controller that asks for what is not a number does not move.
    robot = jnp.where(jnp.all(jnp.isfinite(moved)), moved, state.robot)
    record = _record(scenario, robot, control, state.progress, time + period)
    record = record._replace(
        effective_sample_size=info.effective_sample_size, is_finite=info.is_finite
    )
    after = PathLoopState(robot, memory, state.step + 1, record.progress)
    return after, record


def _record(
    scenario: PathScenario,
    robot: StateVector,
    control: ControlVector,
    progress: Scalar,
    time: Scalar,
) -> PathRecord:
    """Measure a step, with the costs that plan."""
    path, model = scenario.path, scenario.model
    here = State(robot, model)
    now = path.nearest(here.position, near=progress)
    room = gap = jnp.full((), jnp.inf)
    if path.has_room:
        # Where the robot is, whatever phi it plans with.
        room = CorridorCost(path, parameter=lambda _: now).clearance(here)
    truth = scenario.true_obstacles(time)
    if truth is not None:
        gap = ObstacleDistanceCost().room(here, truth)
    felt = jnp.full(2, jnp.nan)
    if isinstance(model.physical, ContinuousDynamics):
        felt = jnp.stack(acceleration(robot, control, model))
    return PathRecord(
        state=robot,
        control=control,
        contouring=ContouringCost(path).error(here),
        lag=LagCost(path).error(here),
        progress=now,
        deviation=path.errors(here.position, now).contouring,
        room=room,
        gap=gap,
        acceleration=felt,
        effective_sample_size=jnp.zeros(()),
        is_finite=jnp.zeros((), bool),
    )


def is_on_the_way(scenario: PathScenario, state: PathLoopState) -> Flag:
    """Say whether the robot has not come to the end yet."""
    return state.progress < scenario.end


def blank_path_records(scenario: PathScenario, capacity: int) -> PathRecord:
    """Return records to be filled.

    Args:
        scenario: whose robot it is.
        capacity: how many steps there is room for; static.
    """
    model = scenario.model
    number, flag = jnp.zeros(capacity), jnp.zeros(capacity, bool)
    return PathRecord(
        state=jnp.zeros((capacity, model.state_size)),
        control=jnp.zeros((capacity, model.control_size)),
        acceleration=jnp.zeros((capacity, 2)),
        is_finite=flag,
        **dict.fromkeys(
            (
                "contouring",
                "lag",
                "progress",
                "deviation",
                "room",
                "gap",
                "effective_sample_size",
            ),
            number,
        ),
    )


@eqx.filter_jit
def run_path_chunk(
    controller: Controller,
    scenario: PathScenario,
    state: PathLoopState,
    key: Key,
    num_steps: Count,
    capacity: int,
) -> tuple[PathLoopState, PathRecord, Count]:
    """Run up to `num_steps` steps, fewer if the robot has come to the end.

    Args:
        controller: decides.
        scenario: where and how.
        state: to go on from.
        key: of the whole run.
        num_steps: at most `capacity`.
        capacity: length of the buffer of records; static.

    Returns:
        The state, the records (the first axis has `capacity` entries) and how many are filled.
    """
    return loop(
        lambda current: path_step(controller, scenario, current, key),
        functools.partial(is_on_the_way, scenario),
        state,
        blank_path_records(scenario, capacity),
        num_steps,
    )
