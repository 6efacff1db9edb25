"""The closed loop: sense, update the belief, plan, move; one compiled loop, nothing in between.

The loop is a `lax.while_loop` over a buffer of records: a scan whose length is data. So the same
compiled program runs a chunk, a single step that is to be timed, and ends the moment the target is
reached; between steps nothing returns to Python.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array

from jaxplore._types import ControlVector, Count, Flag, Key, Pose, Scalar, StateVector
from jaxplore.control.base import Controller
from jaxplore.dynamics.base import Dynamics
from jaxplore.information.belief import Belief
from jaxplore.simulation.collision import disc_clearance
from jaxplore.simulation.scenario import Scenario


class LoopState(NamedTuple):
    """All that changes: the plant's `robot` state, the `belief`, the `controller` state, the number
    of steps done, and the coverage and entropy of the last map update."""

    robot: StateVector
    belief: Belief
    controller: Any
    step: Count
    coverage: Scalar
    entropy: Scalar


class Record(NamedTuple):
    """What is kept of each step; in a run every field has a leading axis of steps.

    Args:
        state: (nx,) after the step.
        control: (nu,) applied during it.
        coverage: share of the reachable cells known to be free.
        entropy: of the belief over the reachable cells [nat].
        clearance: from the robot's edge to the nearest solid cell [m], up to half a metre.
        is_collision: the step would have led into something; the robot stopped instead.
        effective_sample_size: of the controller's rollouts.
        is_finite: whether any of them was finite.
    """

    state: StateVector
    control: ControlVector
    coverage: Scalar
    entropy: Scalar
    clearance: Scalar
    is_collision: Flag
    effective_sample_size: Scalar
    is_finite: Flag


@eqx.filter_jit
def initial_loop_state(controller: Controller, scenario: Scenario) -> LoopState:
    """Return the state before the first step: nothing known but that the robot stands free."""
    belief = scenario.perception.init(
        type(scenario.world).unknown(scenario.world.shape, scenario.world.frame),
        robot_pose(scenario.robot, scenario.start),
    )
    coverage, entropy = _progress(scenario, belief)
    return LoopState(
        scenario.start, belief, controller.init(), jnp.zeros((), jnp.int32), coverage, entropy
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
    pose = robot_pose(scenario.robot, state.robot)
    perception = scenario.perception

    def sense(belief: Belief, _: Array, __: Array) -> tuple[Belief, Array, Array]:
        scan = scenario.lidar.scan(scenario.world, pose, key=scan_key)
        belief = perception.observe(belief, scan, pose)
        return belief, *_progress(scenario, belief)

    belief, coverage, entropy = jax.lax.cond(
        state.step % scenario.steps_per_scan == 0,
        sense,
        lambda *unchanged: unchanged,
        state.belief,
        state.coverage,
        state.entropy,
    )
    elapsed = scenario.control_period * scenario.steps_per_field.astype(jnp.float32)
    belief = jax.lax.cond(
        state.step % scenario.steps_per_field == 0,
        lambda current: perception.update_fields(current, pose, elapsed),
        lambda current: current,
        belief,
    )
    control, controller_state, info = controller.step(
        state.controller, state.robot, belief, key=control_key
    )
    moved = scenario.robot.step(state.robot, control, scenario.control_period)
    solid = ~scenario.world.is_free

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
    record = Record(
        state=robot,
        control=control,
        coverage=coverage,
        entropy=entropy,
        clearance=clearance(robot),
        is_collision=is_collision,
        effective_sample_size=info.effective_sample_size,
        is_finite=info.is_finite,
    )
    return LoopState(robot, belief, controller_state, state.step + 1, coverage, entropy), record


@eqx.filter_jit
def run_chunk(
    controller: Controller,
    scenario: Scenario,
    state: LoopState,
    key: Key,
    num_steps: Count,
    capacity: int,
) -> tuple[LoopState, Record, Count]:
    """Run up to `num_steps` steps, fewer if the target coverage is reached.

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
    blank = jax.eval_shape(closed_loop_step, controller, scenario, state, key)[1]
    buffer = jax.tree.map(lambda leaf: jnp.zeros((capacity, *leaf.shape), leaf.dtype), blank)

    def unfinished(carry: tuple[LoopState, Record, Array]) -> Array:
        current, _, done = carry
        return (done < num_steps) & (current.coverage < scenario.target_coverage)

    def advance(carry: tuple[LoopState, Record, Array]) -> tuple[LoopState, Record, Array]:
        current, records, done = carry
        current, record = closed_loop_step(controller, scenario, current, key)
        records = jax.tree.map(lambda rows, row: rows.at[done].set(row), records, record)
        return current, records, done + 1

    return jax.lax.while_loop(unfinished, advance, (state, buffer, jnp.zeros((), jnp.int32)))


def robot_pose(robot: Dynamics, state: StateVector) -> Pose:
    """Return the pose (x, y, yaw) [m, m, rad] of a state."""
    return jnp.concatenate([robot.position(state), robot.heading(state)[None]])


def _progress(scenario: Scenario, belief: Belief) -> tuple[Scalar, Scalar]:
    """Return the coverage and the remaining entropy [nat] over the reachable cells."""
    reachable = scenario.reachable
    known = jnp.sum(belief.grid.is_free & reachable, dtype=jnp.float32)
    coverage = known / jnp.sum(reachable, dtype=jnp.float32)
    return coverage, jnp.sum(jnp.where(reachable, belief.grid.entropy, 0.0))
