"""The closed loop of every task as one compiled program: perceive, control, advance.

Steps do not return to Python; only chunks of steps do, see `jaxplore.simulation.chunks`.
"""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxplore._types import Count, Key, StateVector
from jaxplore.control.base import Controller
from jaxplore.control.guard import GOOD, LOST, GuardState, MotionGuard
from jaxplore.control.latency import LatencyCompensation
from jaxplore.simulation.chunks import loop
from jaxplore.simulation.scenario import Scenario
from jaxplore.simulation.state import LoopState, Moment


def step_keys(key: Key, step: Count) -> tuple[Key, Key]:
    """Derive the keys of a step's measurements and of its controller.

    They depend only on the key of the run and the number of the step, so a run is reproducible from
    any step.
    """
    measure, control = jax.random.split(jax.random.fold_in(key, step))
    return measure, control


def moment_at(scenario: Scenario, state: LoopState, key: Key) -> Moment:
    """Return the time of the next step, and the state that the controller observes.

    Args:
        scenario: the task.
        state: state of the loop before the step.
        key: key of the whole run.
    """
    period, faults = scenario.control_period, scenario.faults
    # Time is a multiple of the period and not a sum of periods, so rounding does not accumulate.
    time = period * state.step.astype(jnp.float32)
    truth = scenario.measured(state.task)
    if scenario.variation is not None and state.drawn is not None:
        step_key = jax.random.fold_in(key, state.step)
        truth = scenario.variation.observe(scenario.robot, truth, state.drawn, step_key)
    if faults is None:
        moment = Moment(state.step, time, truth, jnp.array(False), jnp.array(False))
    else:
        observed = faults.observe(truth, state.observed, time, period)
        moment = Moment(state.step, time, observed, faults.is_blind(time), faults.is_active(time))
    return _judged(scenario, state, moment)


def _judged(scenario: Scenario, state: LoopState, moment: Moment) -> Moment:
    """Return the moment with the judgement of the guard: a state that it does not trust is NaN."""
    if scenario.guard is None or state.guard is None:
        return moment
    judged = scenario.guard.judge(
        scenario.robot,
        state.guard,
        moment.observed,
        state.observed,
        scenario.scan_points(state.task),
        moment.time,
        scenario.control_period,
    )
    observed = jnp.where(judged.stop == GOOD, moment.observed, jnp.nan)
    return moment._replace(observed=observed, measured=moment.observed, guard=judged)


def initial_loop_state(
    controller: Controller, scenario: Scenario, key: Key | None = None
) -> LoopState:
    """Return the state before the first step.

    Args:
        controller: controller, which makes its own state.
        scenario: task, which makes its own state.
        key: random key of the run; without it nothing is random at the start.
    """
    # Two programs, so that the task's part is compiled once for all controllers.
    state = _initial_task(scenario, key)
    return state._replace(controller=_initial_memory(controller))


@eqx.filter_jit
def _initial_memory(controller: Controller) -> Any:
    return controller.init()


@eqx.filter_jit
def _initial_task(scenario: Scenario, key: Key | None) -> LoopState:
    delay = 0 if scenario.faults is None else scenario.faults.control_delay
    robot, variation = scenario.robot, scenario.variation
    # There is room for the longest delay of any episode.
    delay += 0 if variation is None else variation.control_delay[1]
    return LoopState(
        task=scenario.init(key)[0],
        controller=(),
        step=jnp.zeros((), jnp.int32),
        observed=scenario.start,
        pending=jnp.broadcast_to(robot.default_control, (delay, robot.control_size)),
        drawn=None if variation is None else variation.draw(key, robot),
        guard=None if scenario.guard is None else scenario.guard.init(robot, scenario.start),
    )


def closed_loop_step(
    controller: Controller, scenario: Scenario, state: LoopState, key: Key
) -> tuple[LoopState, Any]:
    """Perceive, compute the control and apply it; return the next state and the record."""
    measure_key, _ = step_keys(key, state.step)
    moment = moment_at(scenario, state, key)
    task, belief = scenario.perceive(state.task, moment, measure_key)
    return control_step(controller, scenario, state._replace(task=task), moment, belief, key)


def control_step(
    controller: Controller,
    scenario: Scenario,
    state: LoopState,
    moment: Moment,
    belief: Any,
    key: Key,
) -> tuple[LoopState, Any]:
    """Compute the control and apply it: the part of a step after perception.

    Args:
        controller: computes the control.
        scenario: the task.
        state: state of the loop, with the task's state as `perceive` returned it.
        moment: the moment that was passed to `perceive`.
        belief: the belief that `perceive` returned.
        key: key of the whole run.
    """
    _, control_key = step_keys(key, state.step)
    guard, watch = scenario.guard, moment.guard
    start = moment.observed
    if guard is not None and watch is not None:
        start = _start_of_plan(controller, scenario, guard, watch)
    control, memory, info = controller.step(state.controller, start, belief, key=control_key)
    if guard is not None and watch is not None:
        # A command that is not finite is none: the robot's base then brakes.
        is_stopped = watch.stop != GOOD
        control = jnp.where(is_stopped, jnp.nan, control)
        seen = scenario.scan_points(state.task)
        args = (start, control, seen, moment.time, scenario.control_period)
        control = guard.keep_clear(scenario.robot, watch, *args)
        # The controller starts anew from rest: its plan was not executed.
        memory = jax.tree.map(functools.partial(jnp.where, is_stopped), controller.init(), memory)
        watch = guard.sent(scenario.robot, watch, control)
        # A plan that was not asked for is no failure of the controller.
        info = info._replace(is_finite=info.is_finite | (is_stopped & (watch.stop != LOST)))
    pending, plant, drawn = state.pending, scenario, state.drawn
    if scenario.variation is not None and drawn is not None:
        pending, control = scenario.variation.delay(pending, control, drawn)
        step_key = jax.random.fold_in(key, state.step)
        robot = scenario.variation.robot(scenario.robot, drawn, step_key)
        # Only the motion has the true robot: the measurements read nothing of it but its pose.
        plant = eqx.tree_at(lambda each: each.robot, scenario, robot)
    elif scenario.faults is not None:
        pending, control = scenario.faults.delay(pending, control)
    if guard is not None and watch is not None:
        robot, period = scenario.robot, scenario.control_period
        points, braked = scenario.scan_points(state.task), watch
        # A loop of one iteration or none. Under vmap a branch would be taken in every step of every
        # run, while a loop is skipped if no run brakes.
        control = jax.lax.fori_loop(
            0,
            jnp.where(jnp.isfinite(control).all(), 0, 1),
            lambda *_: guard.braking(robot, braked, state.task.robot, points, period),
            control,
        )
        watch = guard.moved(robot, watch, state.task.robot, control, period)
    task, record = plant.advance(state.task, control, moment, info)
    # The last finite observation is kept: a frozen odometry repeats it, even after a loss.
    measured = moment.observed if moment.measured is None else moment.measured
    observed = jnp.where(jnp.isfinite(measured).all(), measured, state.observed)
    return LoopState(task, memory, state.step + 1, observed, pending, drawn, watch), record


def _start_of_plan(
    controller: Controller, scenario: Scenario, guard: MotionGuard, watch: GuardState
) -> StateVector:
    """Return the state from which the controller plans; NaN where the robot is stopped."""
    period = scenario.control_period
    # A controller that compensates for a latency itself needs no prediction for it.
    latency = controller.latency if isinstance(controller, LatencyCompensation) else 0.0 * period
    known = jnp.round(latency / period).astype(jnp.int32)
    ahead = guard.ahead(scenario.robot, watch, known, period)
    return jnp.where(watch.stop == GOOD, ahead, jnp.nan)


@eqx.filter_jit(donate="all-except-first")
def run_chunk(
    given: tuple[Controller, Scenario, Key, Count], state: LoopState, capacity: int
) -> tuple[LoopState, Any, Count]:
    """Run a number of steps, fewer if the task is finished.

    The memory of the state is used for the next one: with a large map, copying the map and its
    fields would take longer than a step. The state that was given can not be used any more.

    Args:
        given: computes the controls, the task, the key of the whole run, and the greatest number of
            steps, at most `capacity`.
        state: state to continue from.
        capacity: length of the buffer of records; static.

    Returns:
        The state, the records (the first axis has `capacity` entries), and the number of filled
        records.
    """
    controller, scenario, key, num_steps = given
    return loop(
        lambda current: closed_loop_step(controller, scenario, current, key),
        lambda current: scenario.is_unfinished(current.task),
        state,
        scenario.blank_records(state.task, controller, capacity),
        num_steps,
    )


@eqx.filter_jit
def copied[Tree](tree: Tree) -> Tree:
    """Return a tree whose arrays have memory of their own, which `run_chunk` may use again."""
    return tree


@eqx.filter_jit
def frame_arrays(
    controller: Controller, scenario: Scenario, state: LoopState, key: Key, num_trajectories: int
) -> dict[str, Any]:
    """Return the arrays of a frame, see `Scenario.frame`.

    Args:
        controller: controller whose plan is shown.
        scenario: the task.
        state: state of the loop.
        key: key of the whole run.
        num_trajectories: number of rollouts in the frame; with 0 the controller is not compiled
            again.
    """
    # These are the keys of the coming step, so the frame shows the scan and the plan of that step.
    measure_key, control_key = step_keys(key, state.step)

    def inspect(observed: StateVector, belief: Any) -> Any:
        return controller.inspect(
            state.controller, observed, belief, key=control_key, num_trajectories=num_trajectories
        )

    moment = moment_at(scenario, state, key)
    return scenario.frame(state.task, moment, inspect if num_trajectories else None, measure_key)
