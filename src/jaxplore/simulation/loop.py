"""The closed loop of every task as one compiled program: perceive, control, advance.

Steps do not return to Python; only chunks of steps do, see `jaxplore.simulation.chunks`.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxplore._types import Count, Key, StateVector
from jaxplore.control.base import Controller
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
    """Return the next step's time and what the controller observes; `key` is that of the run."""
    period = scenario.control_period
    # Time is a multiple of the period and not a sum of periods, so rounding does not accumulate.
    time = period * state.step.astype(jnp.float32)
    found = scenario.disturbances.observe(
        scenario.robot,
        scenario.measure_state(state.task),
        state.observed,
        state.drawn,
        time,
        period,
        jax.random.fold_in(key, state.step),
    )
    return _judge(scenario, state, Moment(state.step, time, *found))


def _judge(scenario: Scenario, state: LoopState, moment: Moment) -> Moment:
    """Return the moment with the judgement of the guard: a state that it does not trust is NaN."""
    points = scenario.scan_points(state.task, moment)
    given = state.guard, moment.observed, state.observed, points, moment.time
    observed, judged = scenario.driver().judge(*given)
    measured = None if judged is None else moment.observed
    return moment._replace(observed=observed, measured=measured, guard=judged)


def initial_loop_state(
    controller: Controller, scenario: Scenario, key: Key | None = None
) -> LoopState:
    """Return the state before the first step; without the key of a run nothing is random there."""
    # Two programs, so that the task's part is compiled once for all controllers.
    state = _initial_task(scenario, key)
    return state._replace(controller=_initial_memory(controller))


@eqx.filter_jit
def _initial_memory(controller: Controller) -> Any:
    return _with_strong_types(controller.init())


@eqx.filter_jit
def _initial_task(scenario: Scenario, key: Key | None) -> LoopState:
    robot, disturbances = scenario.robot, scenario.disturbances
    delay = disturbances.longest_delay
    state = LoopState(
        task=scenario.init(key)[0],
        controller=(),
        step=jnp.zeros((), jnp.int32),
        observed=scenario.start,
        pending=jnp.broadcast_to(robot.default_control, (delay, robot.control_size)),
        drawn=disturbances.draw(key, robot),
        guard=scenario.driver().init(scenario.start),
    )
    return _with_strong_types(state)


def _with_strong_types[Tree](tree: Tree) -> Tree:
    """Return a tree without weak types: a state that is read from a file has none, and the program
    that runs on from it is then that of a run from its start."""
    result: Tree = jax.tree.map(
        lambda leaf: jnp.asarray(leaf, leaf.dtype) if eqx.is_array(leaf) else leaf, tree
    )
    return result


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

    `moment` was passed to `perceive`, which returned `belief` and the task's state in `state`.
    `key` is that of the run.
    """
    _, control_key = step_keys(key, state.step)
    robot, points, time = scenario.robot, scenario.scan_points(state.task), moment.time
    driver = scenario.driver(controller)
    given = state.controller, moment.guard, moment.observed, belief, points, time
    sent = driver.decide(*given, control_key)
    pending, control = scenario.disturbances.delay(state.pending, sent.control, state.drawn)
    control, watch = driver.actuate(sent.guard, control, state.task.robot, points)
    # Only the motion has the true robot: the measurements read nothing of it but its pose.
    true_robot = scenario.disturbances.true_robot(robot, state.drawn, key, state.step)
    plant = scenario
    if true_robot is not robot:
        plant = eqx.tree_at(lambda each: each.robot, scenario, true_robot)
    task, record = plant.advance(state.task, control, moment, sent.info)
    # The last finite observation is kept: a frozen odometry repeats it, even after a loss.
    last = moment.observed if moment.measured is None else moment.measured
    observed = jnp.where(jnp.isfinite(last).all(), last, state.observed)
    after = LoopState(task, sent.memory, state.step + 1, observed, pending, state.drawn, watch)
    return after, record


@eqx.filter_jit(donate="all-except-first")
def run_chunk(
    given: tuple[Controller, Scenario, Key, Count], state: LoopState, capacity: int
) -> tuple[LoopState, Any, Count]:
    """Run a number of steps, fewer if the task is finished.

    The memory of the state is used for the next one: with a large map, copying the map and its
    fields would take longer than a step. The state that was given can not be used any more. `given`
    ends with the key of the run and the greatest number of steps, at most `capacity`. The result is
    the state, the records (the first axis has `capacity` entries) and how many are filled.
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
def copy_tree[Tree](tree: Tree) -> Tree:
    """Return a tree whose arrays have memory of their own, which `run_chunk` may use again."""
    return tree


@eqx.filter_jit
def frame_arrays(
    controller: Controller, scenario: Scenario, state: LoopState, key: Key, num_trajectories: int
) -> dict[str, Any]:
    """Return the arrays of a frame, see `Scenario.frame`; `key` is that of the run.

    The frame has `num_trajectories` rollouts; with 0 the controller is not compiled again.
    """
    # These are the keys of the coming step, so the frame shows the scan and the plan of that step.
    measure_key, control_key = step_keys(key, state.step)

    def inspect(observed: StateVector, belief: Any) -> Any:
        return controller.inspect(
            state.controller, observed, belief, key=control_key, num_trajectories=num_trajectories
        )

    moment = moment_at(scenario, state, key)
    return scenario.frame(state.task, moment, inspect if num_trajectories else None, measure_key)
