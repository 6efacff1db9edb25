"""The compiled steps of a pilot: its start, mapping, fields, and the plan with its check."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore._types import (
    ControlVector,
    Count,
    Flag,
    GridMask,
    Key,
    Pose,
    Position,
    Scalar,
    StateVector,
)
from jaxplore.belief.belief import Belief
from jaxplore.belief.part import Part
from jaxplore.belief.perception import Perception
from jaxplore.belief.tracks import ObstacleTracker
from jaxplore.control.base import Controller
from jaxplore.control.guard import MotionGuard, ScanPoints
from jaxplore.control.latency import predict_state
from jaxplore.control.stops import Evidence, StopState, next_stop
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.motion import Matrix
from jaxplore.localisation.localiser import Localiser, LocaliserState
from jaxplore.localisation.particle_localiser import ParticleLocaliser, ParticleState
from jaxplore.localisation.place_search import Places, share_at_walls
from jaxplore.localisation.place_search import search_places as search_map
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.robot.decision import Driver
from jaxplore.robot.localisation import Localisation, Motions, PoseKnowledge, correct_state
from jaxplore.robot.robot import Measurement, Robot, RobotState, Sight
from jaxplore.sensing.base import Sensor
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


class MapInputs(NamedTuple):
    """A scan that is to be mapped, and the pose of the lidar by the odometry [m, m, rad].

    `elapsed` is the time since the scan before [s]. `motions` says how the lidar may have moved
    meanwhile; None if the odometry tells the pose.
    """

    pose: Pose
    scan: Scan
    elapsed: Scalar
    motions: Motions | None


@eqx.filter_jit
def initial(scenario: ExplorationScenario, key: Key | None = None) -> ExplorationState:
    """Return the state before the first scan. Without a program it takes seconds."""
    return scenario.init(key)[0]


@eqx.filter_jit
def map_scan(robot: Robot, own: RobotState, inputs: MapInputs) -> tuple[RobotState, GridMask]:
    """Let a robot map a scan, see `Robot.map_scans`.

    Return what it knows after, and the cells (H, W) that are known to be free.
    """
    pose, scan, elapsed, motions = inputs
    measured = _make_measurement(pose, scan, elapsed, is_scan_due=True)._replace(motions=motions)
    own, sight = robot.examine(own, measured)
    own, _ = robot.map_scans(own, measured, sight)
    return own, own.belief.grid.is_free


def _make_measurement(pose: Pose, scan: Scan, elapsed: Scalar, *, is_scan_due: bool) -> Measurement:
    """Return what a robot measures when either its scan or its fields are due."""
    due, none = jnp.array(True), jnp.array(False)
    flags = (due, elapsed, none, elapsed) if is_scan_due else (none, elapsed, due, elapsed)
    return Measurement(pose, none, (scan,), *flags, elapsed, time=None)


@eqx.filter_jit
def locate_parts(
    perception: Perception, belief: Belief, origin: Position
) -> tuple[Belief, GridMask | None]:
    """Return what a robot knows before its first scan, with the places of its parts where the
    coordinates of its map begin at `origin` (2,) of those of the poses, see `Part.locate`.

    The second result are the cells (H, W) that the robot must not enter; None without any.
    """
    known = {
        part.name: part.locate(belief.parts[part.name], belief.grid, origin)
        for part in perception.parts
        if part.name in belief.parts
    }
    located = perception.with_map(belief.with_parts(known), belief.grid)
    return located, perception.find_forbidden(located)


@eqx.filter_jit
def look(part: Part, belief: Belief, measured: Scalar, time: Scalar) -> Belief:
    """Return what a robot knows after a measurement by the instrument of a part at a time [s]."""
    return belief.with_parts({part.name: part.look(belief.parts[part.name], measured, time)})


@eqx.filter_jit
def search_places(
    given: tuple[ParticleLocaliser, Sensor],
    state: ParticleState,
    scan: Scan,
    expected: Float[Array, "E 3"],
) -> Places:
    """Return where a scan fits on the known map of a state, see `place_search.search_places`."""
    localiser, sensor = given
    seen = scan.points(sensor), scan.is_return
    return search_map(localiser.filter, state.field, *seen, sensor.max_range, expected)


class Followed(NamedTuple):
    """A robot that looks for itself, after a scan.

    Args:
        state: what it knows.
        share: share of the ends of beams that are at known walls from there.
        numbers: (5,) the pose, `share`, and whether the filter knows the pose, in one array.
    """

    state: ParticleState
    numbers: Float[Array, "5"]


@eqx.filter_jit
def follow_place(
    given: tuple[Localisation, Sensor], state: ParticleState, motions: Motions, scan: Scan
) -> Followed:
    """Return what a robot that looks for itself knows after a scan, see `Localisation.follow`."""
    localisation, sensor = given
    localiser = localisation.localiser
    assert isinstance(localiser, ParticleLocaliser)
    _, place = localisation.follow(PoseKnowledge(state, None), motions, (scan,), (sensor,))
    after = place.known
    assert isinstance(after, ParticleState)
    points = scan.points(sensor)
    share = share_at_walls(localiser.filter, after.field, after.pose, points, scan.is_return)
    told = jnp.stack([share, after.is_known.astype(jnp.float32)])
    return Followed(after, jnp.concatenate([after.pose, told]))


@eqx.filter_jit
def start_around(
    localiser: ParticleLocaliser, state: ParticleState, pose: Pose, stds: Float[Array, "2"]
) -> ParticleState:
    """Return the state of a robot that is told where it is, as `ParticleLocaliser` does."""
    return localiser.start_around(state, pose, stds[0], stds[1])


@eqx.filter_jit
def start_at(
    given: tuple[Localiser, Sensor], state: LocaliserState, pose: Pose, covariance: Matrix
) -> LocaliserState:
    """Return the state of a robot that has found itself, see `Localiser.start_at`."""
    localiser, sensor = given
    return localiser.start_at(state, pose, covariance, (sensor,))


@eqx.filter_jit
def with_map(perception: Perception, belief: Belief, grid: OccupancyGrid) -> Belief:
    """Return a belief with another map, see `Perception.with_map`."""
    return perception.with_map(belief, grid)


@eqx.filter_jit
def free_cells(belief: Belief) -> GridMask:
    """Return the cells (H, W) of a map that are known to be free."""
    return belief.grid.is_free


@eqx.filter_jit
def update_fields(
    robot: Robot, own: RobotState, pose: Pose, elapsed: Scalar
) -> tuple[RobotState, Scalar]:
    """Let a robot update its fields, see `Robot.update_fields`.

    `pose` is where it takes itself to be, and `elapsed` the time since the last update [s]. Return
    what it knows after, and the cost-to-go of the guidance field there [m].
    """
    beams = robot.sensors[0].num_beams
    blank = Scan(jnp.zeros(beams), jnp.zeros(beams, bool))
    measured = _make_measurement(pose, blank, elapsed, is_scan_due=False)
    own = robot.update_fields(own, measured, Sight.at(pose))
    return own, own.belief.guidance(pose[:2])


def apply_correction(
    robot: Dynamics, state: np.ndarray, before: np.ndarray, after: np.ndarray
) -> np.ndarray:
    """Return a state (nx,) moved by what corrects a pose (3,) from `before` to `after`."""
    given = (each.astype(np.float32) for each in (state, before, after))
    return np.asarray(_apply_correction(robot, *jax.device_put(tuple(given))))


@eqx.filter_jit
def _apply_correction(
    robot: Dynamics, state: StateVector, before: Pose, after: Pose
) -> StateVector:
    return correct_state(robot, state, before, after)


@jax.jit
def judge(state: StopState, numbers: Float[Array, " E"], max_frozen: Scalar) -> StopState:
    """Return whether the robot is stopped, see `next_stop`.

    `numbers` are the fields of `Evidence`, flags as 0 or 1: one array is one transfer.
    """
    named = dict(zip(Evidence._fields, numbers, strict=True))
    flags = {name: each > 0.5 for name, each in named.items() if name.startswith("is_")}
    return next_stop(state, Evidence(**{**named, **flags}), max_frozen)


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
    guard: MotionGuard,
    tracker: ObstacleTracker | None,
    memory: Any,
    belief: Any,
    inputs: PlanInputs,
    period: Scalar,
    key: Key,
) -> Planned:
    """Predict the state in which a command takes effect, and plan from there, see `Driver.plan`.

    The model `robot` predicts the state. `tracker` tracks moving obstacles; None if nothing moves.
    """
    # The command takes effect later than it is computed, so the plan begins where the robot will be
    # then.
    key = jax.random.fold_in(key, inputs.number)
    start = predict_state(robot, inputs.state, inputs.sent, inputs.durations)
    start = _with_commanded_speeds(robot, start, inputs.expected)
    adapted = controller.at_period(inputs.elapsed)
    points, is_point = inputs.points, inputs.is_point
    speeds = jnp.zeros(points.shape[0])
    if tracker is not None and belief.tracks is not None and belief.obstacles is not None:
        # A point that neither a wall nor a track explains may be somebody who was not seen before.
        speeds = tracker.possible_speeds(belief.tracks, belief.clearance, points, is_point)
        later = belief.obstacles.advance(inputs.since_map)
        belief = dataclasses.replace(belief, obstacles=later)
    none = jnp.zeros(())
    scan = ScanPoints(points, is_point, none, none, none, speeds)
    driver = Driver(robot, adapted, guard, period)
    checked, memory, info = driver.plan(memory, start, belief, scan, inputs.age, key)
    controls = _resample_plan(controller, info.controls, checked.control, period)

    def step(at: StateVector, each: ControlVector) -> tuple[StateVector, tuple[Array, Array]]:
        after = robot.step(at, each, period)
        return after, (after, robot.twist(after, each))

    # The base is sent twists, which depend on the state, and the next call begins at the state
    # predicted here.
    _, (states, twists) = jax.lax.scan(step, start, controls)
    is_finite = (
        info.is_finite
        & jnp.isfinite(start).all()
        & jnp.isfinite(twists).all()
        & jnp.isfinite(checked.control).all()
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


def _resample_plan(
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
    state: StateVector,
    belief: Belief,
    scan: Scan,
    key: Key,
    num_trajectories: int,
) -> dict[str, Any]:
    """Return the arrays of an `ExplorationFrame` with the plan of the coming step."""
    planned = None
    if num_trajectories:
        planned = controller.inspect(
            memory, state, belief, key=key, num_trajectories=num_trajectories
        )
    seen = (scenario.robot, scenario.sensors[0], state, belief)
    return frame_arrays(*seen, scan, None, planned, scenario.truths, {})
