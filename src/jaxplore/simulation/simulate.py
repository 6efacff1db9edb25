"""Runs the closed loop chunk by chunk."""

import functools
import time
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore import _checks
from jaxplore._types import Count, Key
from jaxplore.control.base import Controller, SampledPlan
from jaxplore.geometry.footprint import Footprint, Rectangle
from jaxplore.simulation.chunks import CHUNK_SECONDS, Watched, watch
from jaxplore.simulation.exploration.closed_loop import (
    LoopState,
    initial_loop_state,
    is_unfinished,
    robot_pose,
    run_chunk,
    scan_all,
    world_at,
)
from jaxplore.simulation.exploration.record import Record
from jaxplore.simulation.exploration.scenario import Scenario
from jaxplore.simulation.recording import Frame, Recording

NUM_TRAJECTORIES = 60
"""Rollouts in each look."""


class Progress(NamedTuple):
    """How far a run is: simulated `time` and `time_limit` [s], `coverage`, and wall-clock
    `seconds` since the loop was compiled."""

    time: float
    time_limit: float
    coverage: float
    seconds: float


def record_run(
    controller: Controller,
    scenario: Scenario,
    num_steps: int,
    *,
    key: Key,
    on_progress: Callable[[Progress], None] = lambda _: None,
    num_trajectories: int = NUM_TRAJECTORIES,
) -> Recording:
    """Simulate until the target coverage is reached or the steps are done.

    Ctrl-C ends the run after the current chunk; what was done is returned.

    Args:
        controller: decides.
        scenario: where and how.
        num_steps: at most, in control periods.
        key: the same key gives the same run.
        on_progress: called after each chunk.
        num_trajectories: rollouts in each look at the run; with 0 there is no plan either, and the
            controller need not be compiled a second time, to look into it.

    Raises:
        ValueError: a number of steps < 1, or of rollouts < 0.
    """
    limit = _checks.positive_int("num_steps", num_steps)
    if num_trajectories < 0:
        raise ValueError(f"num_trajectories is {num_trajectories}; accepted: a whole number >= 0")
    period = period_of(scenario)
    controller = controller.at_period(scenario.control_period)
    began = time.perf_counter()
    state = initial_loop_state(controller, scenario, key)
    chunk = max(1, round(CHUNK_SECONDS / period))

    def run(current: LoopState, steps: Count) -> tuple[LoopState, Record, Count]:
        return run_chunk(controller, scenario, current, key, steps, chunk)

    def look(current: LoopState, step: int) -> Frame:
        seen = look_at(controller, scenario, current, key, num_trajectories)
        return frame_of(seen, step, step * period)

    def report(current: LoopState, total: int, seconds: float) -> None:
        coverage = float(current.progress.coverage)
        on_progress(Progress(total * period, limit * period, coverage, seconds))

    done = watch(
        run,
        functools.partial(is_unfinished, scenario),
        look,
        state,
        began=began,
        limit=limit,
        chunk=chunk,
        on_chunk=report,
    )
    return recording_of(controller, scenario, state, done)


def recording_of(
    controller: Controller,
    scenario: Scenario,
    before: LoopState,
    done: Watched[LoopState, Record, Frame],
) -> Recording:
    """Return a run as NumPy arrays, with what is needed to judge and draw it.

    Args:
        controller: that decided.
        scenario: where and how.
        before: the state before the first step.
        done: the loop that was run.
    """
    state, belief = done.state, done.state.belief
    return Recording(
        records=done.records,
        frames=done.frames,
        timing=done.timing,
        control_period=period_of(scenario),
        world=np.asarray(scenario.world.probability),
        belief=np.asarray(belief.grid.probability),
        reachable=np.asarray(scenario.reachable),
        origin=np.asarray(scenario.world.frame.origin),
        resolution=scenario.world.resolution,
        field_origin=np.asarray(belief.information.frame.origin),
        field_resolution=belief.information.frame.resolution,
        start=np.asarray(scenario.start),
        initial_coverage=float(before.progress.coverage),
        initial_entropy=float(before.progress.entropy),
        initial_unknown=float(before.progress.unknown),
        goal=None if scenario.goal is None else np.asarray(scenario.goal),
        control_half_range=np.asarray(
            0.5 * (scenario.robot.control_max - scenario.robot.control_min)
        ),
        finished_step=done.num_steps - int(state.finished) + 1 if int(state.finished) else None,
        state_names=scenario.robot.state_names,
        robot_radius=float(scenario.robot.radius),
        target_coverage=None
        if float(scenario.target_coverage) > 1.0
        else (float(scenario.target_coverage)),
        is_interrupted=done.is_interrupted,
        footprint=outline_of(scenario.robot.footprint),
        targets=np.asarray(scenario.targets),
        elevation=None if scenario.ground is None else np.asarray(scenario.ground.elevation),
        traversable=(
            None if scenario.ground is None else np.asarray(scenario.ground.is_traversable)
        ),
        idleness=None if belief.idleness is None else np.asarray(belief.idleness),
        mover_radii=(
            np.zeros(0) if scenario.movers is None else np.asarray(scenario.movers.radius)
        ),
        member_names=controller.member_names,
    )


def period_of(scenario: Scenario) -> float:
    """Return the control period [s]: 0.02, not the nearest float32."""
    return round(float(scenario.control_period), 7)


class Look(NamedTuple):
    """A frame's arrays while they are still on the device."""

    state: Array
    probability: Array
    information: Array
    scan: Array
    samples: Array
    weights: Array
    plan: Array
    heading: Array
    reference: Array
    movers: Array
    terms: dict[str, Array]


@eqx.filter_jit
def look_at(
    controller: Controller, scenario: Scenario, state: LoopState, key: Key, num_trajectories: int
) -> Look:
    """Return what is to be seen of a run after a step; see `record_run`."""
    scan_key, plan_key = jax.random.split(jax.random.fold_in(key, state.step))
    pose = robot_pose(scenario.robot, state.robot)
    time = scenario.control_period * state.step.astype(jnp.float32)
    world = world_at(scenario, state.step)
    # Of the sensor that leads: what it looks at is where the robot learns.
    scan, *_ = scan_all(scenario, world, pose, state.movers, time, scan_key)
    angles = pose[2] + jnp.asarray(scenario.sensors[0].beam_angles)
    ends = pose[:2] + scan.ranges[:, None] * jnp.stack([jnp.cos(angles), jnp.sin(angles)], axis=-1)
    look = Look(
        state=state.robot,
        probability=jnp.round(255.0 * state.belief.grid.probability).astype(jnp.uint8),
        information=state.belief.information.total,
        scan=ends,
        samples=jnp.zeros((0, 1, 2)),
        weights=jnp.zeros(0),
        plan=jnp.zeros((0, 2)),
        heading=pose[2],
        reference=jnp.zeros((0, 2)),
        movers=jnp.zeros((0, 2)) if state.movers is None else state.movers.at(time).positions,
        terms={},
    )
    if not num_trajectories:
        return look
    plan: SampledPlan = controller.inspect(
        state.controller,
        state.robot,
        state.belief,
        key=plan_key,
        num_trajectories=num_trajectories,
    )
    position = jax.vmap(scenario.robot.position)
    return look._replace(
        samples=jax.vmap(position)(plan.samples),
        weights=plan.weights,
        plan=position(plan.nominal.states),
        reference=look.reference if plan.reference is None else plan.reference[:, :2],
        terms=plan.nominal.terms,
    )


def frame_of(look: Look, step: int, seconds: float) -> Frame:
    """Return a look as NumPy arrays, after so many steps and seconds."""
    arrays = look._asdict()
    terms = {name: float(value) for name, value in arrays.pop("terms").items()}
    heading = float(arrays.pop("heading"))
    kept = {name: np.asarray(value) for name, value in arrays.items()}
    return Frame(step=step, time=seconds, terms=terms, heading=heading, **kept)


def outline_of(footprint: Footprint) -> np.ndarray:
    """Return the corners (4, 2) of a rectangle in the robot's frame [m]; none of another robot."""
    if not isinstance(footprint, Rectangle):
        return np.zeros((0, 2))
    front, rear, half = (
        float(footprint.front),
        -float(footprint.rear),
        0.5 * float(footprint.width),
    )
    return np.array([[front, half], [rear, half], [rear, -half], [front, -half]])
