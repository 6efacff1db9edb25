"""What a mission is judged by, in a closed loop with a robot that goes ahead, come what may."""

import functools
import math
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import (
    Ackermann,
    DifferentialDrive,
    ExplorationScenario,
    InverseSensorModel,
    Lidar,
    MovingObstacles,
    OccupancyGrid,
    Perception,
    TerrainMap,
)
from jaxplore.control.base import Controller, Info, SampledPlan
from jaxplore.control.trajectory import Trajectory
from jaxplore.geometry import Chassis
from jaxplore.geometry.footprint import Rectangle
from jaxplore.maps import Ground
from jaxplore.maps.world import MovingObstacle
from jaxplore.parts import IdlenessMap
from jaxplore.parts.wheels.truth import TIPPING_TIME, TRACTION, Wheels
from jaxplore.report.drawing.colours import TARGET
from jaxplore.simulation.exploration.part_truth import Drive
from jaxplore.simulation.loop import (
    copy_tree,
    initial_loop_state,
    run_chunk,
)
from jaxplore.simulation.state import LoopState, Moment

pytestmark = pytest.mark.long

SHAPE, RESOLUTION = (30, 40), 0.2  # 8 m x 6 m
PERIOD, CAPACITY = 0.05, 40
ROBOT = DifferentialDrive(max_speed=1.0, max_acceleration=2.0, drag=0.0, radius=0.25)
CAR = Ackermann(max_speed=1.0, footprint=Rectangle(0.8, 0.2, 0.5))
AHEAD = Lidar(61, 2.5, math.radians(120.0), range_noise=0.0)
AROUND = Lidar(60, 2.0, range_noise=0.0)
BOX = ((22, 26), (18, 21))  # rows, columns: x from 3.6 to 4.2 m, y from 4.4 to 5.2 m


class Steady(Controller):
    """Gives one command."""

    command: jax.Array

    def init(self):
        return ()

    def step(self, state, observation, belief=None, *, key):
        one = jnp.ones(())
        return self.command, state, Info(self.command[None], one[None], one[None], one, one > 0)

    def inspect(self, state, observation, belief=None, *, key, num_trajectories=50):
        alone = Trajectory(jnp.stack([observation] * 2), self.command[None], {})
        return SampledPlan(alone, alone, alone.states[None], jnp.ones(1))

    def at_period(self, control_period):
        return self


def hall(has_box: bool = False) -> np.ndarray:
    world = np.full(SHAPE, 0.01)
    world[0], world[-1], world[:, 0], world[:, -1] = 0.99, 0.99, 0.99, 0.99
    if has_box:
        world[slice(*BOX[0]), slice(*BOX[1])] = 0.99
    return world


# So low and so soft that it stands on any ground: one program with those that tip over.
FLAT = Chassis(0.4, 0.4, 0.05, suspension=10.0)
# In a corner that nobody comes to.
PARKED = MovingObstacle(((7.5, 0.5), (7.5, 0.5)), 0.0, 0.1)
CORNERS = ((0.5, 5.5), (7.5, 5.5), (0.5, 0.5), (6.5, 0.5))


def scenario(
    world: np.ndarray | None = None,
    start=(1.0, 3.0, 0.0),
    *,
    elevation: np.ndarray | None = None,
    max_slope: float = 0.5,
    mover: MovingObstacle = PARKED,
    targets=CORNERS,
    robot=ROBOT,
    chassis: Chassis = FLAT,
    **more,
) -> ExplorationScenario:
    """Return one of many that differ in arrays only: they share one compiled loop."""
    world = hall() if world is None else world
    elevation = np.zeros(SHAPE) if elevation is None else elevation
    ground = Ground(elevation, RESOLUTION, max_slope=max_slope)
    terrain = TerrainMap(OccupancyGrid(world, RESOLUTION), ground)
    sensors = [AHEAD, AROUND]
    perception = Perception(
        sensors,
        RESOLUTION,
        robot.radius,
        sensor_model=InverseSensorModel.line_of_sight(),
        num_directions=4,
        node_spacing=0.2,
        ground=terrain.ground,
        parts=[IdlenessMap(20.0)],
    )
    return ExplorationScenario(
        terrain,
        robot,
        sensors,
        start,
        perception=perception,
        control_rate=1.0 / PERIOD,
        sensing_rate=0.5 / PERIOD,
        field_rate=0.25 / PERIOD,
        targets=targets,
        truths=[Wheels(chassis), *([] if mover is None else [MovingObstacles([mover])])],
        **more,
    )


class Outcome(NamedTuple):
    """A run: the state at its end, its records, and the robot's states with the start first."""

    state: LoopState
    records: tuple
    states: np.ndarray


def begin(
    given: ExplorationScenario, command=(0.0, 0.0), seed: int = 0
) -> tuple[Steady, LoopState]:
    controller = Steady(jnp.asarray(command, jnp.float32))
    return controller, initial_loop_state(controller, given, jax.random.key(seed))


def advance(controller, given: ExplorationScenario, state: LoopState, steps: int, seed: int = 0):
    key, count = jax.random.key(seed), jnp.asarray(steps, jnp.int32)
    state, rows, done = run_chunk((controller, given, key, count), copy_tree(state), CAPACITY)
    return state, jax.tree.map(lambda leaf: np.asarray(leaf)[: int(done)], rows)


def drive(given: ExplorationScenario, steps: int, command=(0.0, 0.0), seed: int = 0) -> Outcome:
    controller, state = begin(given, command, seed)
    pieces = []
    for begun in range(0, steps, CAPACITY):
        state, rows = advance(controller, given, state, min(CAPACITY, steps - begun), seed)
        pieces.append(rows)
    records = jax.tree.map(lambda *parts: np.concatenate(parts), *pieces)
    states = np.concatenate([np.asarray(given.start)[None], records.state]).astype(np.float64)
    return Outcome(state, records, states)


def is_visible(world: np.ndarray, pose, point, sensor: Lidar) -> bool:
    """Say whether a sensor sees the cell of a point, by samples 1 mm apart on the way there."""
    offset = np.asarray(point, np.float64) - pose[:2]
    distance = np.hypot(*offset)
    bearing = (math.atan2(offset[1], offset[0]) - pose[2] + math.pi) % (2 * math.pi) - math.pi
    if distance > sensor.max_range or abs(bearing) > 0.5 * sensor.field_of_view + 1e-9:
        return False
    way = pose[:2] + np.linspace(0.0, 1.0, int(1000 * distance) + 2)[:, None] * offset
    cells = np.floor(way / RESOLUTION).astype(int)
    before = cells[(cells != cells[-1]).any(axis=1)]
    return bool((world[before[:, 1], before[:, 0]] < 0.25).all())


# Targets

SPOTS = ((2.3, 3.5), (4.9, 5.3), (6.1, 3.1), (7.3, 4.1))


@pytest.fixture(scope="module")
def search() -> tuple[ExplorationScenario, Outcome]:
    """A robot that passes a box, behind which there is something to be seen."""
    given = scenario(hall(has_box=True), targets=SPOTS, target_coverage=0.5)
    return given, drive(given, 160, (1.0, 0.02))


def test_targets_count_as_seen_when_they_are_in_sight_of_the_first_sensor(search) -> None:
    _, outcome = search
    seen, expected = np.zeros(len(SPOTS), bool), []
    for step, state in enumerate(outcome.states[:-1]):
        if step % 2 == 0:
            seen |= [is_visible(hall(True), state[:3], spot, AHEAD) for spot in SPOTS]
        expected.append(seen.sum())
    np.testing.assert_array_equal(outcome.records.targets_seen, expected)
    # One after the other, and not at once.
    assert sorted(set(expected)) == [1, 2, 3, 4]


def test_the_picture_of_an_environment_has_stars_and_found_targets(search) -> None:
    given, outcome = search
    view, task = given.agent_view(None), outcome.state.task
    observed = outcome.state.observed
    moment = Moment(jnp.int32(0), jnp.float32(0.0), observed, jnp.array(False), jnp.array(False))
    trail = np.asarray(observed[:2])[None]
    is_seen = np.arange(given.num_targets) % 2 == 0
    image = view.picture(
        task._replace(judged=task.judged._replace(is_seen=jnp.asarray(is_seen))), moment, trail
    )
    side = image.shape[0] / (SHAPE[0] * RESOLUTION)
    for (x, y), found in zip(np.asarray(given.targets).tolist(), is_seen, strict=True):
        row, column = image.shape[0] - round(y * side), round(x * side)
        around = image[row - 8 : row + 9, column - 8 : column + 9]
        is_sign = (np.abs(around.astype(int) - np.asarray(TARGET)) < 12).all(axis=-1)
        # A star is filled in its middle, where a ring has only its thin check mark.
        assert is_sign.sum() > 15
        assert bool(is_sign[6:11, 6:11].sum() > 15) is not bool(found)


def test_the_run_is_over_when_all_targets_are_seen(search) -> None:
    given, outcome = search
    seen = outcome.records.targets_seen
    assert len(seen) < 160
    assert seen[-1] == len(SPOTS)
    assert (seen[:-1] < len(SPOTS)).all()
    assert int(outcome.state.task.finished) == 1
    assert not bool(given.is_unfinished(outcome.state.task))
    # The target coverage, which is not what it is out for, was reached before.
    assert (outcome.records.coverage[:-1] >= 0.5).any()


def test_idleness_is_the_time_since_the_first_sensor_saw_each_cell(search) -> None:
    given, outcome = search
    reachable = np.asarray(given.reachable)

    @jax.jit
    def seen_from(pose):
        scan = AHEAD.scan(given.world, pose, key=jax.random.key(0), ground=given.ground)
        return AHEAD.sight(given.world, scan, pose, given.ground).is_seen

    last = np.full(SHAPE, -np.inf)  # when each cell was seen last
    for step, state in enumerate(outcome.states[:-1]):
        if step % 2 == 0:
            time = PERIOD * step
            last[np.asarray(seen_from(jnp.asarray(state[:3], jnp.float32)))] = time
            idle = np.minimum(time - last, time)[reachable]
        watch = outcome.records.parts["watch"]
        assert watch.mean_idleness[step] == pytest.approx(idle.mean(), abs=1e-3)
        assert watch.worst_idleness[step] == pytest.approx(idle.max(), abs=1e-3)
    assert 0.0 < idle.mean() < idle.max()
    belief = outcome.state.task.belief
    np.testing.assert_allclose(belief.grid.crop(belief.parts["watch"]), time - last, atol=1e-3)


# What moves


def place(mover: MovingObstacle, phase: float, time: float) -> np.ndarray:
    """Return where a disc is that goes to and fro between two corners."""
    first, second = np.array(mover.path)
    length = np.hypot(*(second - first))
    rest = (phase * 2 * length + mover.speed * time) % (2 * length)
    return first + (second - first) * min(rest, 2 * length - rest) / length


CROSSING = MovingObstacle(((1.5, 4.7), (6.5, 4.7)), 1.0, 0.3)


class Watched(NamedTuple):
    """A run past which something moves, seen at each scan."""

    state: LoopState
    phase: float
    tracks: list
    times: list[float]


@pytest.fixture(scope="module")
def watched() -> Watched:
    given = scenario(start=(4.0, 3.7, math.pi / 2), mover=CROSSING)
    controller, state = begin(given)
    tracks, times = [], []
    for scan in range(100):
        state, _ = advance(controller, given, state, 1 if scan == 0 else 2)
        tracks.append(jax.tree.map(np.asarray, state.task.belief.obstacles))
        times.append(2 * scan * PERIOD)
    return Watched(state, float(state.task.truths["moving_obstacles"][0]), tracks, times)


POSE = np.array([4.0, 3.7, math.pi / 2])


def test_tracks_follow_what_is_in_sight(watched) -> None:
    seen, errors = [], []
    for track, time in zip(watched.tracks, watched.times, strict=True):
        there = place(CROSSING, watched.phase, time)
        in_sight = any(is_visible(hall(), POSE, there, sensor) for sensor in (AHEAD, AROUND))
        seen.append(in_sight)
        assert (track.age[0] == 0.0) == in_sight
        assert bool(track.is_known[0]) == any(seen)
        if in_sight:
            errors.append(track.centres[0] - there)
            np.testing.assert_allclose(track.covariance[0], 0.05**2 * np.eye(2), rtol=1e-6)
            assert np.abs(np.abs(track.velocities[0]) - [1.0, 0.0]).max() < 4 * 0.1
    assert 20 < sum(seen) < 100
    assert np.abs(errors).max() < 4 * 0.05
    # They are measured, not known.
    assert 0.02 < np.std(errors) < 0.1


def test_out_of_sight_tracks_go_on_and_grow_older(watched) -> None:
    known = [bool(track.is_known[0]) for track in watched.tracks]
    first = known.index(True)
    checked = 0
    for before, after in zip(watched.tracks[first:-1], watched.tracks[first + 1 :], strict=True):
        if after.age[0] > 0.0:
            assert after.age[0] == pytest.approx(before.age[0] + 2 * PERIOD, abs=1e-5)
            expected = before.centres[0] + 2 * PERIOD * before.velocities[0]
            np.testing.assert_allclose(after.centres[0], expected, atol=1e-4)
            checked += 1
    assert checked > 5


def test_what_moves_leaves_no_ghosts_in_the_map(watched) -> None:
    grid = watched.state.task.belief.grid.unpad()
    is_free = hall() < 0.25
    assert not (np.asarray(grid.is_occupied) & is_free).any()
    # What it passed in sight of the robot is known to be free by now.
    assert np.asarray(grid.is_free)[23, 13:27].all()
    # And the wall, seen across its way, is known.
    outline = scenario(start=(4.0, 3.7, math.pi / 2), mover=PARKED)
    still = drive(outline, 199).state.task.belief.grid.unpad()
    assert (np.asarray(still.is_occupied) & ~is_free).sum() > 0
    np.testing.assert_array_equal(grid.is_occupied & ~is_free, still.is_occupied & ~is_free)


def test_what_runs_into_a_standing_robot_is_a_collision() -> None:
    mover = MovingObstacle(((1.5, 3.2), (6.5, 3.2)), 1.0, 0.3)
    outcome = drive(scenario(start=(4.0, 3.0, 0.3), mover=mover), 200)
    phase = float(outcome.state.task.truths["moving_obstacles"][0])
    away = [np.hypot(*(place(mover, phase, PERIOD * (k + 1)) - (4.0, 3.0))) for k in range(200)]
    gap = np.array(away) - 0.3 - 0.25
    assert np.abs(gap).min() > 1e-4
    np.testing.assert_array_equal(outcome.records.is_collision, gap < 0.0)
    assert 10 < (gap < 0.0).sum() < 100
    near = gap < 0.4
    np.testing.assert_allclose(outcome.records.clearance[near], gap[near], atol=1e-4)
    # It stands where it stood.
    np.testing.assert_array_equal(outcome.records.state[:, :2], [[4.0, 3.0]] * 200)


def test_where_it_begins_depends_on_the_key_alone() -> None:
    given = scenario(start=(4.0, 3.0, 0.3), mover=CROSSING)
    first, again, other = (drive(given, 6, (1.0, 0.5), seed) for seed in (3, 3, 4))
    for one, two in zip(jax.tree.leaves(first), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(one, two)
    phases = [float(each.state.task.truths["moving_obstacles"][0]) for each in (first, other)]
    assert phases[0] != phases[1]
    assert all(0.0 <= phase < 1.0 for phase in phases)
    controller, moved = begin(scenario(start=(2.0, 2.0, 1.0), mover=CROSSING), (0.3, 0.0), 3)
    assert float(moved.task.truths["moving_obstacles"][0]) == phases[0]
    found = [
        float(begin(given, seed=seed)[1].task.truths["moving_obstacles"][0]) for seed in range(12)
    ]
    assert min(found) < 0.3
    assert max(found) > 0.7
    assert controller.command.shape == (2,)


# Ground, footprint, and the end


def ramp() -> np.ndarray:
    """Return ground that rises by 1 m/m for 0.6 m, from x = 4 m on."""
    x = (np.arange(40) + 0.5) * RESOLUTION
    return np.tile(np.clip(x - 4.0, 0.0, 0.6), (30, 1))


def touches(closed: np.ndarray, position: np.ndarray, radius: float) -> float:
    """Return how far a disc is from the nearest closed cell, which is a square [m]."""
    rows, columns = np.nonzero(closed)
    low = np.stack([columns, rows], axis=-1) * RESOLUTION
    gap = np.maximum(np.maximum(low - position, position - low - RESOLUTION), 0.0)
    return float(np.hypot(*gap.T).min()) - radius


def test_steps_on_ground_that_is_too_steep_are_recorded() -> None:
    outcome = drive(scenario(start=(3.0, 3.0, 0.1), elevation=ramp()), 80, (2.0, 0.0))
    slope = np.gradient(ramp(), RESOLUTION, axis=1)
    closed = 1.0 - np.clip(slope / 0.5, 0.0, 1.0) < 0.3
    gap = np.array([touches(closed, state[:2], 0.25) for state in outcome.states[1:]])
    assert np.abs(gap).min() > 1e-5
    np.testing.assert_array_equal(outcome.records.is_untraversable, gap < 0.0)
    assert 10 < (gap < 0.0).sum() < 70
    # It gets there: such ground is no wall.
    assert outcome.states[-1, 0] > 5.0
    assert not outcome.records.is_collision.any()


def on_wheels(elevation: np.ndarray, command=(0.0, 0.0), *, height: float = 0.25):
    """Drive 20 steps on the wheels of a square of 0.4 m, heading along x."""
    chassis = Chassis(0.4, 0.4, height, suspension=0.05)
    start = (3.0, 3.0, 0.0)
    given = scenario(start=start, elevation=elevation, max_slope=20.0, chassis=chassis)
    return drive(given, 20, command)


def test_a_vehicle_tips_over_on_a_slope_that_is_too_steep_for_it() -> None:
    y = (np.arange(30)[:, None] + 0.5) * RESOLUTION * np.ones((1, 40))
    # 2 h / W times the slope: 0.8 / 1.25 of the load. It drives on.
    outcome = on_wheels(0.64 * y, (1.0, 0.0))
    wheels = outcome.records.parts["wheels"]
    np.testing.assert_allclose(wheels.load_transfer, 0.8, atol=1e-3)
    assert len(wheels.is_tipped) == 20
    assert not wheels.is_tipped.any()
    assert outcome.states[-1, 0] > 3.4
    # A higher centre of mass is without load on one side, for 0.2 s: then the run ends.
    outcome = on_wheels(0.64 * y, (1.0, 0.0), height=0.35)
    wheels = outcome.records.parts["wheels"]
    np.testing.assert_array_equal(wheels.is_tipped, [False, False, False, True])
    assert (wheels.load_transfer > 1.0).all()
    assert not bool(outcome.records.is_collision.any())


def test_it_lies_where_it_tipped_over() -> None:
    # A turn of 2 m/s^2 is too fast for a mass at 1.1 m.
    given = scenario(start=(3.0, 3.0, 0.0), chassis=Chassis(0.4, 0.4, 1.1))
    _, state = begin(given)
    (wheels,) = [each for each in given.truths if isinstance(each, Wheels)]
    tipped = wheels.init(jnp.zeros(3))._replace(tipping=jnp.asarray(TIPPING_TIME))
    moving = state.task.robot.at[3].set(1.0)
    lying = state.task._replace(truths={**state.task.truths, "wheels": tipped}, robot=moving)
    assert not bool(given.is_unfinished(lying))
    command = jnp.asarray([1.0, 2.0])
    ahead = given.robot.step(moving, command, given.control_period)
    after = wheels.drive(
        tipped, Drive(given.robot, moving, ahead, command, None, given.control_period)
    )
    np.testing.assert_allclose(after[:4], [3.0, 3.0, 0.0, 0.0], atol=1e-6)
    outcome = drive(given, 40, (1.0, 2.0))
    assert outcome.records.parts["wheels"].is_tipped[-1]
    assert len(outcome.records.parts["wheels"].is_tipped) < 40


def test_a_wheel_in_the_air_takes_half_of_the_way() -> None:
    x, y = np.meshgrid((np.arange(40) + 0.5) * RESOLUTION, (np.arange(30) + 0.5) * RESOLUTION)
    # A saddle: the twist of the wheels is 0.2 m times 0.2 m times its curvature, 6 or 4 cm.
    ways = []
    for twist in (0.06, 0.04):
        outcome = on_wheels(twist / 0.04 * (x - 3.0) * (y - 3.0), (0.2, 0.0))
        wheels = outcome.records.parts["wheels"]
        np.testing.assert_allclose(wheels.wheel_travel[0], twist / 0.05, rtol=1e-2)
        ways.append(np.diff(outcome.states[:, 0]))
    # The first step begins on what was known at rest.
    np.testing.assert_allclose(ways[0][1:], TRACTION * ways[1][1:], rtol=1e-3)


def test_on_level_ground_none_are() -> None:
    outcome = drive(scenario(start=(3.0, 3.0, 0.1)), 80, (2.0, 0.0))
    assert outcome.states[-1, 0] > 5.0
    assert not outcome.records.is_untraversable.any()


def test_a_rectangle_collides_with_its_corners() -> None:
    # The face of the wall is at 7.8 m; the car is 0.5 m wide and reaches 0.8 m ahead.
    yaw = 0.2
    front = 0.8 * math.cos(yaw) + 0.25 * math.sin(yaw)
    start = (5.0, 2.5, yaw)
    given = scenario(start=start, robot=CAR)
    # The motion alone: what the car perceives would be another large program.
    task = begin(scenario(start=start))[1].task._replace(robot=CAR.at_pose(*start))

    @eqx.filter_jit
    def driven_car(given, task):
        controller = Steady(jnp.asarray([1.0, 0.0]))
        control, _, info = controller.step((), given.start, key=jax.random.key(0))
        off = jnp.array(False)

        def advance(task, step):
            time = step.astype(jnp.float32) * given.control_period
            moment = Moment(step, time, task.robot, off, off)
            return given.advance(task, control, moment, info)

        return jax.lax.scan(advance, task, jnp.arange(120, dtype=jnp.int32))

    task, records = jax.tree.map(np.asarray, driven_car(given, task))
    states = np.concatenate([np.asarray(given.start)[None], records.state]).astype(np.float64)
    car = Outcome(task, records, states)
    disc = drive(scenario(start=(5.0, 2.5, yaw)), 120, (1.0, 0.0))
    for outcome, reach in ((car, front), (disc, 0.25)):
        assert outcome.records.is_collision.any()
        first = int(np.argmax(outcome.records.is_collision))
        stopped = outcome.states[first, 0]
        # One step more would have been too far; at 1 m/s that is 5 cm.
        assert 7.8 - reach - 0.055 < stopped <= 7.8 - reach + 1e-4
        assert (outcome.records.clearance >= 0.0).all()
    assert disc.states[:, 0].max() > car.states[:, 0].max() + 0.5


def test_without_a_target_coverage_there_is_no_end() -> None:
    never, once = (scenario(targets=None, target_coverage=c) for c in (None, 1.0))
    _, state = begin(never)
    progress = state.task.progress._replace(coverage=jnp.ones(()))
    covered = state.task._replace(judged=state.task.judged._replace(progress=progress))
    assert bool(never.is_unfinished(covered))
    assert not bool(once.is_unfinished(covered))
    ends = [bool(each.is_finished(covered)) for each in (never, once)]
    assert ends == [False, True]


def test_other_missions_do_not_recompile() -> None:
    given = scenario(start=(2.0, 2.0, 1.0), targets=SPOTS)
    controller, state = begin(given)
    state, _ = advance(controller, given, state, 3)
    before = run_chunk._cached._cache_size()
    advance(controller, given, state, 2)
    other = functools.partial(drive, steps=3, command=(0.5, 0.1), seed=5)
    other(scenario(hall(True), elevation=ramp(), mover=CROSSING, target_coverage=0.5))
    assert run_chunk._cached._cache_size() == before


def test_a_run_goes_on_in_what_was_compiled_for_its_beginning() -> None:
    given = scenario()
    _, state = begin(given)
    after, _ = advance(Steady(jnp.zeros(2)), given, state, 1)
    for one, other in zip(jax.tree.leaves(state), jax.tree.leaves(after), strict=True):
        assert (one.shape, one.dtype) == (other.shape, other.dtype)
        assert getattr(one, "weak_type", False) == getattr(other, "weak_type", False)
    assert eqx.tree_equal(jax.tree.structure(state), jax.tree.structure(after))
