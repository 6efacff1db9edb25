"""The closed loop: sense, update the belief, plan, move; one compiled loop, nothing in between.

Between steps nothing returns to Python: see `jaxplore.simulation.chunks`.
"""

import dataclasses
import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore._types import Count, Flag, Key, Pose, Scalar, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.belief.tracks import Tracks
from jaxplore.belief.zones import unknown_fraction
from jaxplore.control.base import Controller
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.base import Scan
from jaxplore.simulation.chunks import loop
from jaxplore.simulation.exploration.collision import discs_clearance, footprint_clearance
from jaxplore.simulation.exploration.moving_obstacles import MovingObstacles
from jaxplore.simulation.exploration.record import Progress, Record, blank_records
from jaxplore.simulation.exploration.scenario import Scenario

MOVERS = 2**31 - 1
"""Sets the randomness of what moves apart from that of the steps."""


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
        is_seen: (M,) which targets have been seen.
        movers: what moves, as it began.
    """

    robot: StateVector
    belief: Belief
    controller: Any
    step: Count
    progress: Progress
    finished: Count
    observed: StateVector
    pending: Float[Array, "D nu"]
    is_seen: Bool[Array, " M"]
    movers: MovingObstacles | None


def initial_loop_state(
    controller: Controller, scenario: Scenario, key: Key | None = None
) -> LoopState:
    """Return the state before the first step: what is known beforehand, and that the robot stands
    free. Where what moves begins depends on the key; without, it is as the scenario has it."""
    # Two programs: what is known beforehand is compiled once for all controllers.
    before = _before_control(scenario, key if scenario.movers is not None else None)
    return before._replace(controller=_initial_memory(controller))


@eqx.filter_jit
def _initial_memory(controller: Controller) -> Any:
    return controller.init()


@eqx.filter_jit
def _before_control(scenario: Scenario, key: Key | None) -> LoopState:
    """Return the state before the first step but for the controller's memory."""
    belief = scenario.perception.init(scenario.prior, robot_pose(scenario.robot, scenario.start))
    movers = scenario.movers
    if movers is not None:
        if key is not None:
            phases = jax.random.uniform(jax.random.fold_in(key, MOVERS), movers.phase.shape)
            movers = eqx.tree_at(lambda some: some.phase, movers, phases)
        belief = dataclasses.replace(belief, tracks=Tracks.unseen(movers.radius))
    delay = 0 if scenario.faults is None else scenario.faults.control_delay
    robot = scenario.robot
    return LoopState(
        robot=scenario.start,
        belief=belief,
        controller=(),
        step=jnp.zeros((), jnp.int32),
        progress=_progress(scenario, belief, jnp.zeros(())),
        finished=jnp.zeros((), jnp.int32),
        observed=scenario.start,
        pending=jnp.broadcast_to(robot.default_control, (delay, robot.control_size)),
        is_seen=jnp.zeros(scenario.num_targets, bool),
        movers=movers,
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
    period = scenario.control_period
    time = period * state.step.astype(jnp.float32)
    if faults is not None:
        is_blind, is_faulty = faults.is_blind(time), faults.is_active(time)
        observed = faults.observe(state.robot, state.observed, time, period)
    # The map is made with the pose that the robot takes for its own, the scan where it really is.
    pose = robot_pose(scenario.robot, observed)
    is_placed = jnp.isfinite(pose).all()

    def sense(belief: Belief, _: Progress, is_seen: Array) -> tuple[Belief, Progress, Array]:
        at = robot_pose(scenario.robot, state.robot)
        scans = scan_all(scenario, world, at, state.movers, time, scan_key)
        since = period * scenario.steps_per_scan.astype(jnp.float32)
        belief = perception.observe(belief, scans, pose, since)
        if scenario.num_targets > 0:
            is_seen |= scenario.sensors[0].sees(world, at, scenario.targets, scenario.ground)
        if state.movers is not None:
            belief = _tracked(scenario, world, belief, at, state.movers, time, scan_key)
        return belief, _progress(scenario, belief, time), is_seen

    belief = state.belief
    if belief.tracks is not None:
        belief = dataclasses.replace(belief, tracks=_unmeasured(belief.tracks, period))
    # The clock decides first, alone: it is the same for all runs of a batch, which so sense and
    # derive no more often than one does.
    belief, progress, is_seen = jax.lax.cond(
        state.step % scenario.steps_per_scan == 0,
        lambda *known: jax.lax.cond(~is_blind & is_placed, sense, _same, *known),
        _same,
        belief,
        state.progress,
        state.is_seen,
    )
    # One step ahead of what a controller does at the same rate, a strategy for example: that reads
    # fresh fields, and no single step has to pay for both.
    every = scenario.steps_per_field
    elapsed = scenario.control_period * every.astype(jnp.float32)

    def derive(current: Belief) -> tuple[Belief]:
        return (perception.update_fields(current, pose, elapsed),)

    (belief,) = jax.lax.cond(
        (state.step % every == every - 1) | (state.step == 0),
        lambda current: jax.lax.cond(is_placed, derive, _same, current),
        _same,
        belief,
    )
    control, controller_state, info = controller.step(
        state.controller, observed, belief, key=control_key
    )
    pending = state.pending
    if faults is not None:
        pending, control = faults.delay(pending, control)
    model = scenario.robot
    moved = model.step(state.robot, control, period)
    solid, frame, footprint = ~world.is_free, world.frame, model.footprint
    reach = scenario.clearance_reach

    def clearance(robot: Array) -> Array:
        position, heading = model.position(robot), model.heading(robot)
        room = footprint_clearance(solid, frame, position, heading, footprint, reach)
        if state.movers is None:
            return room
        there = state.movers.at(time + period).positions
        gap = discs_clearance(there, state.movers.radius, position, heading, footprint)
        return jnp.minimum(room, gap)

    def is_untraversable(robot: Array) -> Array:
        if scenario.ground is None:
            return jnp.array(False)
        position, heading = model.position(robot), model.heading(robot)
        closed = ~scenario.ground.is_traversable
        return footprint_clearance(closed, frame, position, heading, footprint, reach) < 0.0

    is_finite = jnp.all(jnp.isfinite(moved))
    is_collision = is_finite & (clearance(moved) < 0.0)
    blocked = scenario.robot.blocked(state.robot, moved)
    robot = jnp.where(is_collision, blocked, jnp.where(is_finite, moved, state.robot))
    # What the controller is told while it is frozen is what it was told last, unless that was lost.
    told = jnp.where(jnp.isfinite(observed).all(), observed, state.observed)
    is_over = _is_finished(scenario, robot, progress, is_seen) | (state.finished > 0)
    record = Record(
        state=robot,
        control=control,
        coverage=progress.coverage,
        entropy=progress.entropy,
        unknown=progress.unknown,
        clearance=clearance(robot),
        is_collision=is_collision,
        is_untraversable=is_untraversable(robot),
        effective_sample_size=info.effective_sample_size,
        is_finite=info.is_finite,
        is_faulty=is_faulty,
        members=info.members,
        targets_seen=jnp.sum(is_seen, dtype=jnp.int32),
        mean_idleness=progress.mean_idleness,
        worst_idleness=progress.worst_idleness,
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
        is_seen=is_seen,
        movers=state.movers,
    )
    return after, record


def _same[*T](*unchanged: *T) -> tuple[*T]:
    return unchanged


def _is_finished(
    scenario: Scenario, robot: StateVector, progress: Progress, is_seen: Bool[Array, " M"]
) -> Flag:
    is_covered = progress.coverage >= scenario.target_coverage
    if scenario.num_targets > 0:
        is_covered = jnp.all(is_seen)
    if scenario.goal is None:
        return is_covered
    offset = scenario.robot.position(robot) - scenario.goal
    is_there = jnp.sum(offset * offset) < scenario.goal_radius**2
    if scenario.num_targets == 0:
        is_covered |= progress.unknown < scenario.max_unknown
    return is_there & is_covered


def is_unfinished(scenario: Scenario, state: LoopState) -> Flag:
    """Say whether the loop goes on: until the end, and for the hovering after it.

    A scenario without a goal that is covered beforehand takes no step.
    """
    is_over = state.finished > scenario.hover_steps
    if scenario.goal is None and scenario.num_targets == 0:
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
    return loop(
        lambda current: closed_loop_step(controller, scenario, current, key),
        functools.partial(is_unfinished, scenario),
        state,
        blank_records(controller, scenario.robot, capacity),
        num_steps,
    )


def scan_all(
    scenario: Scenario,
    world: OccupancyGrid,
    pose: Pose,
    movers: MovingObstacles | None,
    time: Scalar,
    key: Key,
) -> tuple[Scan, ...]:
    """Return what each sensor measures from a pose at a time."""
    discs = None if movers is None else movers.discs(time)
    keys = [key, *(jax.random.fold_in(key, k) for k in range(1, len(scenario.sensors)))]
    return tuple(
        sensor.scan(world, pose, key=each, ground=scenario.ground, movers=discs)
        for sensor, each in zip(scenario.sensors, keys, strict=True)
    )


def _tracked(
    scenario: Scenario,
    world: OccupancyGrid,
    belief: Belief,
    pose: Pose,
    movers: MovingObstacles,
    time: Scalar,
    key: Key,
) -> Belief:
    """Return the belief with what the tracker measures of those in sight of some sensor."""
    assert belief.tracks is not None
    now = movers.at(time)
    position_std, velocity_std = scenario.tracking_noise
    keys = jax.random.split(jax.random.fold_in(key, MOVERS), 2)
    in_sight = [
        sensor.sees(world, pose, now.positions, scenario.ground) for sensor in scenario.sensors
    ]
    tracks = belief.tracks.update(
        now.positions + position_std * jax.random.normal(keys[0], now.positions.shape),
        now.velocities + velocity_std * jax.random.normal(keys[1], now.velocities.shape),
        functools.reduce(jnp.logical_or, in_sight),
        position_std,
        jnp.zeros(()),
    )
    return dataclasses.replace(belief, tracks=tracks)


def _unmeasured(tracks: Tracks, elapsed: Scalar) -> Tracks:
    """Return what is known after a time without a measurement."""
    nothing = jnp.zeros_like(tracks.is_known)
    return tracks.update(tracks.positions, tracks.velocities, nothing, jnp.zeros(()), elapsed)


def world_at(scenario: Scenario, step: Count) -> OccupancyGrid:
    """Return the world after so many steps, with the walls that have appeared."""
    if scenario.faults is None:
        return scenario.world
    return scenario.faults.world(scenario.world, scenario.control_period * step.astype(jnp.float32))


def robot_pose(robot: Dynamics, state: StateVector) -> Pose:
    """Return the pose (x, y, yaw) [m, m, rad] of a state."""
    return jnp.concatenate([robot.position(state), robot.heading(state)[None]])


def _progress(scenario: Scenario, belief: Belief, time: Scalar) -> Progress:
    """Return how much is known of the reachable cells, and of all, and how recently."""
    reachable = scenario.reachable
    known = jnp.sum(belief.grid.is_free & reachable, dtype=jnp.float32)
    mean, worst = jnp.zeros(()), jnp.zeros(())
    if belief.idleness is not None:
        idle = jnp.where(reachable, jnp.minimum(belief.idleness, time), 0.0)
        mean, worst = jnp.sum(idle) / jnp.sum(reachable, dtype=jnp.float32), jnp.max(idle)
    return Progress(
        coverage=known / jnp.sum(reachable, dtype=jnp.float32),
        entropy=jnp.sum(jnp.where(reachable, belief.grid.entropy, 0.0)),
        unknown=unknown_fraction(belief.grid),
        mean_idleness=mean,
        worst_idleness=worst,
    )
