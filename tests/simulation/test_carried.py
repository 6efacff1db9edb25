"""A robot that finds its pose on a map that it knows, and is carried away."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.control.stops import LOST
from jaxplore.localisation import Localiser, LoopCloser, ParticleFilter, ParticleLocaliser
from jaxplore.parts import Faults
from jaxplore.simulation import Localisation
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.loop import copy_tree, initial_loop_state, run_chunk
from jaxplore.simulation.run import simulate

LIDAR = jx.Lidar(num_beams=90, max_range=4.0, range_noise=0.01)
ROBOT = jx.DifferentialDrive(max_speed=1.0)
START, GOAL, ELSEWHERE = (1.0, 1.0, 0.3), (7.2, 4.8), (6.6, 1.2, 2.0)
CARRIED_AT = 2.0


def rooms() -> jx.OccupancyGrid:
    """Two rooms of 8.4 x 5.8 m with a door, and in each something else."""
    world = np.full((58, 84), 0.01, np.float32)
    world[0] = world[-1] = world[:, 0] = world[:, -1] = 0.99
    world[:34, 42] = world[46:, 42] = 0.99
    world[20:26, 10:22] = world[40:44, 26:30] = 0.99
    world[4:16, 76:80] = world[26:30, 52:58] = 0.99
    return jx.OccupancyGrid(world, 0.1)


def scenario_with(faults: Faults, **options) -> ExplorationScenario:
    known = ParticleFilter(num_particles=1000, num_beams=45, **options)
    made = ExplorationScenario(
        rooms(),
        ROBOT,
        LIDAR,
        START,
        perception=jx.Perception(LIDAR, 0.1, 0.2, num_directions=16, goal=GOAL),
        prior=rooms(),
        goal=GOAL,
        goal_radius=0.6,
        localisation=Localisation(localiser=ParticleLocaliser(known)),
    )
    return made.with_disturbances([faults]).with_guard(jx.MotionGuard())


CONTROLLER = jx.explorer(ROBOT, horizon=30, num_samples=128)
CARRIED = scenario_with(Faults(carried_at=CARRIED_AT, carried_to=ELSEWHERE))
# The same program, with a fault that comes after the end.
UNDISTURBED = scenario_with(Faults(carried_at=1e6, carried_to=ELSEWHERE))


def drive(scenario: ExplorationScenario, **options):
    return simulate(
        CONTROLLER, scenario, 1500, key=jax.random.key(4), num_trajectories=0, **options
    )


@pytest.fixture(scope="module")
def undisturbed():
    return drive(UNDISTURBED)


@pytest.fixture(scope="module")
def carried():
    return drive(CARRIED)


def test_it_drives_to_a_goal_by_its_scans_on_the_map(undisturbed) -> None:
    metrics, records = undisturbed.metrics, undisturbed.recording.records
    assert metrics.is_finished
    assert metrics.collisions == 0
    assert np.asarray(records.pose_error).max() < 0.3
    assert metrics.ate < 0.1
    assert not np.asarray(records.is_carried).any()
    assert metrics.carried_at is None
    # A known map has no loops, and its coverage says nothing.
    assert metrics.num_loops is None
    assert metrics.aligned_coverage is None
    assert metrics.map_iou > 0.98
    assert "loops" not in dict(metrics.rows())


def test_a_robot_that_was_carried_away_is_found_again(carried) -> None:
    metrics, records = carried.metrics, carried.recording.records
    steps = np.flatnonzero(records.is_carried)
    period = carried.recording.control_period
    assert len(steps) == 1
    assert metrics.carried_at == pytest.approx(CARRIED_AT, abs=1.5 * period)
    # There it stands.
    np.testing.assert_allclose(np.asarray(records.state)[steps[0], :3], ELSEWHERE, atol=1e-5)
    assert np.asarray(records.pose_error)[steps[0] + 1] > 3.0
    assert metrics.is_finished
    assert metrics.collisions == 0
    assert 0.0 < metrics.recovered_after < 10.0
    found = round((metrics.carried_at + metrics.recovered_after) / period)
    assert (np.asarray(records.pose_error)[found:] < 0.5).all()
    # The way in somebody's arms is none of its own.
    moves = np.diff(carried.recording.positions, axis=0)
    moves = np.hypot(*np.delete(moves, steps[0], axis=0).T)
    assert metrics.path_length == pytest.approx(moves.sum(), rel=1e-5)
    # What it mapped at wrong places is forgotten.
    assert metrics.map_iou > 0.95
    assert set(carried.recording.figures()) >= {"map"}
    assert dict(metrics.rows())["carried away"].startswith("after 2.0")


CHUNK = 25  # that of `simulate`, so that the loop is compiled once
AT_RATE = CONTROLLER.at_period(CARRIED.control_period)


def one_step(scenario: ExplorationScenario, state):
    given = AT_RATE, scenario, jax.random.key(0), np.array(1, np.int32)
    after, records, _ = run_chunk(given, copy_tree(state), CHUNK)
    return after, jax.tree.map(lambda rows: np.asarray(rows)[0], records)


def test_while_it_does_not_know_its_pose_it_brakes_and_maps_nothing() -> None:
    state = initial_loop_state(AT_RATE, CARRIED, jax.random.key(0))
    task = state.task
    known = task.own.place.known
    unknown = known._replace(found=known.found._replace(is_converged=jnp.array(False)))
    driving = task.robot.at[3].set(0.5)
    place = task.own.place._replace(known=unknown)
    task = task._replace(robot=driving, own=task.own._replace(place=place))
    after, record = one_step(CARRIED, state._replace(task=task))
    assert int(record.stop) == LOST
    assert float(after.task.robot[3]) < 0.5
    np.testing.assert_array_equal(
        after.task.belief.grid.probability, CARRIED.map_arrays.prior.probability
    )
    # The scan reaches the filter nevertheless, which knows the pose by it.
    assert int(after.task.own.place.known.number) == 1
    assert bool(after.task.own.place.known.is_known)
    after, record = one_step(CARRIED, after)
    assert int(record.stop) != LOST


def test_it_is_the_same_run_again_also_in_two_parts(carried) -> None:
    half = simulate(CONTROLLER, CARRIED, 90, key=jax.random.key(4), num_trajectories=0)
    whole = drive(CARRIED, resume=half)
    np.testing.assert_array_equal(whole.recording.positions, carried.recording.positions)
    np.testing.assert_array_equal(whole.recording.belief, carried.recording.belief)


@pytest.mark.parametrize(
    ("errors", "expected"),
    [
        ([4.0] * 100 + [0.1] * 200, 2.0),
        # Near the true place for half a second only.
        ([4.0] * 50 + [0.1] * 25 + [4.0] * 25 + [0.4] * 50, 2.0),
        ([0.1] * 50 + [4.0] * 10, 0.0),
        ([4.0] * 50 + [0.1] * 49, None),
        ([float("nan")] * 60 + [0.1] * 60, 1.2),
        ([0.6] * 100, None),
    ],
)
def test_the_time_to_recover_is_counted_by_hand(carried, errors, expected) -> None:
    number = 10 + len(errors)
    records = jax.tree.map(
        lambda rows: np.resize(rows, (number, *rows.shape[1:])), records_of(carried)
    )
    is_carried = np.arange(number) == 9
    records = records._replace(
        is_carried=is_carried, pose_error=np.array([0.0] * 10 + errors, np.float32)
    )
    recording = dataclasses.replace(carried.recording, records=records)
    found = recording.metrics()
    assert found.carried_at == pytest.approx(0.2)
    assert found.recovered_after == (None if expected is None else pytest.approx(expected))


def records_of(run):
    return jax.tree.map(np.asarray, run.recording.records)


def test_other_numbers_compile_nothing_again() -> None:
    state = initial_loop_state(AT_RATE, CARRIED, jax.random.key(0))
    one_step(CARRIED, state)
    before = run_chunk._cached._cache_size()
    faults = Faults(carried_at=9.0, carried_to=(2.0, 1.0, 0.0))
    one_step(scenario_with(faults, distance_std=0.1, temper=0.5), state)
    assert run_chunk._cached._cache_size() == before


def test_the_place_is_drawn_by_the_key_where_the_robot_can_drive() -> None:
    reachable, frame = CARRIED.map_arrays.reachable, CARRIED.map_arrays.world.frame
    faults = Faults(carried_at=1.0)
    keys = jax.random.split(jax.random.key(0), 400)
    drawn = jax.jit(jax.vmap(lambda key: faults.landing(reachable, frame, key)))
    places = drawn(keys)
    row, column = np.asarray(jax.jit(jax.vmap(frame.to_cell))(places[:, :2])).T
    assert np.asarray(reachable)[row, column].all()
    # In both rooms, as often as their cells.
    left = np.asarray(reachable)[:, :42].sum() / np.asarray(reachable).sum()
    assert np.mean(column < 42) == pytest.approx(left, abs=4.0 * 0.5 / 20.0)
    np.testing.assert_allclose(faults.landing(reachable, frame, keys[3]), places[3], atol=1e-6)
    assert Faults().landing(reachable, frame, keys[0]) is None


def test_from_an_unknown_start_it_finds_itself_by_scans() -> None:
    localiser = ParticleLocaliser(
        ParticleFilter(num_particles=1000, num_beams=45), is_start_known=False
    )
    grid, truth = rooms(), jnp.array([2.2, 3.6, 0.8])

    @jax.jit
    def seen(state, step):
        scan = LIDAR.scan(grid, truth, key=jax.random.fold_in(jax.random.key(1), step))
        return localiser.correct(state, (scan,), (LIDAR,))

    start = eqx.filter_jit(localiser.start)
    state = start(truth, grid, (LIDAR,), jax.random.key(2))
    assert not bool(state.is_known)
    assert float(state.uncertainty) > 1.0
    for step in range(40):
        state = seen(state, jnp.asarray(step))
        if bool(state.is_known):
            break
    assert bool(state.is_known)
    np.testing.assert_allclose(state.pose, truth, atol=0.15)
    # Between scans the pose follows the odometry.
    predicted = eqx.filter_jit(localiser.predict)
    moved = predicted(state, jnp.array([0.5, 0.0, 0.1]), jnp.array(0.5))
    yaw = float(state.pose[2])
    ahead = np.asarray(state.pose[:2]) + 0.5 * np.array([np.cos(yaw), np.sin(yaw)])
    np.testing.assert_allclose(moved.pose[:2], ahead, atol=1e-5)
    assert float(moved.way) == pytest.approx(0.5)


def test_impossible_arguments_are_refused() -> None:
    with pytest.raises(ValueError, match=r"prior is None .* accepted: the map"):
        ExplorationScenario(
            rooms(), ROBOT, LIDAR, START, localisation=Localisation(localiser=ParticleLocaliser())
        )
    for given in ({"closer": LoopCloser()}, {"most_uncertainty": 1.0}):
        with pytest.raises(ValueError, match=r"beside a ParticleLocaliser"):
            Localisation(localiser=ParticleLocaliser(), **given)
        Localisation(localiser=Localiser(), **given)
    for place in ((99.0, 1.0, 0.0), (4.25, 1.0, 0.0)):
        with pytest.raises(ValueError, match=r"carried_to is \[.*accepted: a pose at which"):
            CARRIED.with_disturbances([Faults(carried_at=1.0, carried_to=place)])
