"""The closed loop: sense, update the belief, plan, move; one compiled loop, nothing in between.

The loop is a `lax.while_loop` over a buffer of records: a scan whose length is data. So the same
compiled program runs a chunk, a single step that is to be timed, and ends the moment the target is
reached; between steps nothing returns to Python.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import ControlVector, Count, Flag, Key, Pose, Scalar, StateVector
from jaxplore.control.base import Controller
from jaxplore.dynamics.base import Dynamics
from jaxplore.information.belief import Belief
from jaxplore.information.zones import unknown_fraction
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.simulation.collision import disc_clearance
from jaxplore.simulation.scenario import Scenario


class LoopState(NamedTuple):
    """All that changes.

    Args:
        robot: (nx,) state of the plant.
        belief: what the robot knows.
        controller: its state.
        step: steps done.
        progress: of the last map update.
        finished: steps done since the scenario was finished, 0 before.
        observed: (nx,) what the controller was told last.
        pending: (D, nu) commands that have not taken effect yet, oldest first.
    """

    robot: StateVector
    belief: Belief
    controller: Any
    step: Count
    progress: "Progress"
    finished: Count
    observed: StateVector
    pending: Float[Array, "D nu"]


class Progress(NamedTuple):
    """How much of the map is known: see `Record`."""

    coverage: Scalar
    entropy: Scalar
    unknown: Scalar


class Record(NamedTuple):
    """What is kept of each step; in a run every field has a leading axis of steps.

    Args:
        state: (nx,) after the step.
        control: (nu,) that took effect during it.
        coverage: share of the reachable cells known to be free.
        entropy: of the belief over the reachable cells [nat].
        unknown: share of the map's cells with `4 p (1 - p) > 1/2`.
        clearance: from the robot's edge to the nearest solid cell [m], up to half a metre.
        is_collision: the step would have led into something; the robot stopped instead.
        effective_sample_size: of the controller's rollouts.
        is_finite: whether any of them was finite.
        is_faulty: whether scans or odometry failed, by the scenario's faults.
    """

    state: StateVector
    control: ControlVector
    coverage: Scalar
    entropy: Scalar
    unknown: Scalar
    clearance: Scalar
    is_collision: Flag
    effective_sample_size: Scalar
    is_finite: Flag
    is_faulty: Flag


@eqx.filter_jit
def initial_loop_state(controller: Controller, scenario: Scenario) -> LoopState:
    """Return the state before the first step: what is known beforehand, and that the robot stands
    free."""
    belief = scenario.perception.init(scenario.prior, robot_pose(scenario.robot, scenario.start))
    delay = 0 if scenario.faults is None else scenario.faults.control_delay
    robot = scenario.robot
    return LoopState(
        robot=scenario.start,
        belief=belief,
        controller=controller.init(),
        step=jnp.zeros((), jnp.int32),
        progress=_progress(scenario, belief),
        finished=jnp.zeros((), jnp.int32),
        observed=scenario.start,
        pending=jnp.broadcast_to(robot.default_control, (delay, robot.control_size)),
    )


def closed_loop_step(
    controller: Controller, scenario: Scenario, state: LoopState, key: Key
) -> tuple[LoopState, Record]:
    """Return the loop's state one control period later, and the record of it.

    Sense (at the sensing rate) and update the map; derive the fields (at the field rate); control;
    move. A move that would touch something solid is not made: the robot stands still and the step
    counts as a collision. The randomness of a step depends on the key and the step's number only.
    """
    scan_key, control_key = jax.random.split(jax.random.fold_in(key, state.step))
    perception, faults = scenario.perception, scenario.faults
    world, observed = world_at(scenario, state.step), state.robot
    is_blind, is_faulty = jnp.array(False), jnp.array(False)
    if faults is not None:
        period = scenario.control_period
        time = period * state.step.astype(jnp.float32)
        is_blind, is_faulty = faults.is_blind(time), faults.is_active(time)
        observed = faults.observe(state.robot, state.observed, time, period)
    # The map is made with the pose that the robot takes for its own, the scan where it really is.
    pose = robot_pose(scenario.robot, observed)
    is_placed = jnp.isfinite(pose).all()

    def sense(belief: Belief, _: Progress) -> tuple[Belief, Progress]:
        at = robot_pose(scenario.robot, state.robot)
        scan = scenario.lidar.scan(world, at, key=scan_key)
        belief = perception.observe(belief, scan, pose)
        return belief, _progress(scenario, belief)

    belief, progress = jax.lax.cond(
        (state.step % scenario.steps_per_scan == 0) & ~is_blind & is_placed,
        sense,
        lambda *unchanged: unchanged,
        state.belief,
        state.progress,
    )
    # One step ahead of what a controller does at the same rate, a strategy for example: that reads
    # fresh fields, and no single step has to pay for both.
    every = scenario.steps_per_field
    elapsed = scenario.control_period * every.astype(jnp.float32)
    belief = jax.lax.cond(
        ((state.step % every == every - 1) | (state.step == 0)) & is_placed,
        lambda current: perception.update_fields(current, pose, elapsed),
        lambda current: current,
        belief,
    )
    control, controller_state, info = controller.step(
        state.controller, observed, belief, key=control_key
    )
    pending = state.pending
    if faults is not None:
        pending, control = faults.delay(pending, control)
    moved = scenario.robot.step(state.robot, control, scenario.control_period)
    solid = ~world.is_free

    def clearance(robot: Array) -> Array:
        return disc_clearance(
            solid,
            scenario.world.frame.to_grid(scenario.robot.position(robot)),
            scenario.robot.radius,
            scenario.world.resolution,
            scenario.clearance_reach,
        )

    is_finite = jnp.all(jnp.isfinite(moved))
    is_collision = is_finite & (clearance(moved) < 0.0)
    blocked = scenario.robot.blocked(state.robot, moved)
    robot = jnp.where(is_collision, blocked, jnp.where(is_finite, moved, state.robot))
    # What the controller is told while it is frozen is what it was told last, unless that was lost.
    told = jnp.where(jnp.isfinite(observed).all(), observed, state.observed)
    is_over = _is_finished(scenario, robot, progress) | (state.finished > 0)
    record = Record(
        state=robot,
        control=control,
        coverage=progress.coverage,
        entropy=progress.entropy,
        unknown=progress.unknown,
        clearance=clearance(robot),
        is_collision=is_collision,
        effective_sample_size=info.effective_sample_size,
        is_finite=info.is_finite,
        is_faulty=is_faulty,
    )
    after = LoopState(
        robot=robot,
        belief=belief,
        controller=controller_state,
        step=state.step + 1,
        progress=progress,
        finished=state.finished + is_over.astype(jnp.int32),
        observed=told,
        pending=pending,
    )
    return after, record


def _is_finished(scenario: Scenario, robot: StateVector, progress: Progress) -> Flag:
    is_covered = progress.coverage >= scenario.target_coverage
    if scenario.goal is None:
        return is_covered
    offset = scenario.robot.position(robot) - scenario.goal
    is_there = jnp.sum(offset * offset) < scenario.goal_radius**2
    return is_there & (is_covered | (progress.unknown < scenario.max_unknown))


def is_unfinished(scenario: Scenario, state: LoopState) -> Flag:
    """Say whether the loop goes on: until the end, and for the hovering after it.

    A scenario without a goal that is covered beforehand takes no step.
    """
    is_over = state.finished > scenario.hover_steps
    if scenario.goal is None:
        is_done = state.progress.coverage >= scenario.target_coverage
        is_over = is_over | (is_done & (scenario.hover_steps == 0))
    return ~is_over


@eqx.filter_jit
def run_chunk(
    controller: Controller,
    scenario: Scenario,
    state: LoopState,
    key: Key,
    num_steps: Count,
    capacity: int,
) -> tuple[LoopState, Record, Count]:
    """Run up to `num_steps` steps, fewer if the scenario is finished.

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
    buffer = _blank(scenario, capacity)

    def unfinished(carry: tuple[LoopState, Record, Array]) -> Array:
        current, _, done = carry
        return (done < num_steps) & is_unfinished(scenario, current)

    def advance(carry: tuple[LoopState, Record, Array]) -> tuple[LoopState, Record, Array]:
        current, records, done = carry
        current, record = closed_loop_step(controller, scenario, current, key)
        records = jax.tree.map(lambda rows, row: rows.at[done].set(row), records, record)
        return current, records, done + 1

    return jax.lax.while_loop(unfinished, advance, (state, buffer, jnp.zeros((), jnp.int32)))


def _blank(scenario: Scenario, capacity: int) -> Record:
    """Return records to be filled; to trace a step for their shapes would take a second."""
    robot = scenario.robot
    number, flag = jnp.zeros(capacity), jnp.zeros(capacity, bool)
    return Record(
        state=jnp.zeros((capacity, robot.state_size)),
        control=jnp.zeros((capacity, robot.control_size)),
        coverage=number,
        entropy=number,
        unknown=number,
        clearance=number,
        is_collision=flag,
        effective_sample_size=number,
        is_finite=flag,
        is_faulty=flag,
    )


def world_at(scenario: Scenario, step: Count) -> OccupancyGrid:
    """Return the world after so many steps, with the walls that have appeared."""
    if scenario.faults is None:
        return scenario.world
    return scenario.faults.world(scenario.world, scenario.control_period * step.astype(jnp.float32))


def robot_pose(robot: Dynamics, state: StateVector) -> Pose:
    """Return the pose (x, y, yaw) [m, m, rad] of a state."""
    return jnp.concatenate([robot.position(state), robot.heading(state)[None]])


def _progress(scenario: Scenario, belief: Belief) -> Progress:
    """Return how much is known of the reachable cells, and of all."""
    reachable = scenario.reachable
    known = jnp.sum(belief.grid.is_free & reachable, dtype=jnp.float32)
    return Progress(
        coverage=known / jnp.sum(reachable, dtype=jnp.float32),
        entropy=jnp.sum(jnp.where(reachable, belief.grid.entropy, 0.0)),
        unknown=unknown_fraction(belief.grid),
    )
