"""A robot that finds its own pose: what it knows, what the judge knows, and loops that close."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.control.base import Info
from jaxplore.geometry.motion import between, compose
from jaxplore.localisation import Localiser, LoopCloser, Odometry
from jaxplore.localisation.localiser import SPARE, is_nearly_full, thin_scans
from jaxplore.robot.localisation import Localisation, correct_state
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.loop import initial_loop_state
from jaxplore.simulation.run import simulate
from jaxplore.simulation.state import Moment

pytestmark = pytest.mark.long

LIDAR = jx.Lidar(num_beams=180, max_range=3.0, range_noise=0.01)
ROBOT = jx.DifferentialDrive(max_speed=1.0)
ODOMETRY = Odometry(turn_per_distance=0.03, turn_per_metre=0.05)
CAPACITY = 200 + SPARE


def hall() -> jx.OccupancyGrid:
    """A hall of 12 x 9 m with pilasters and a block in the middle, around which a loop leads."""
    world = np.zeros((90, 120), np.float32)
    world[0], world[-1], world[:, 0], world[:, -1] = 1.0, 1.0, 1.0, 1.0
    world[30:60, 35:85] = 1.0
    for column in range(15, 110, 22):
        world[1:4, column : column + 4] = world[86:89, column + 7 : column + 10] = 1.0
    world[24:28, 1:4] = world[61:66, 116:119] = 1.0
    return jx.OccupancyGrid(world, 0.1)


def scenario_with(localisation: Localisation | None) -> ExplorationScenario:
    perception = jx.Perception(LIDAR, 0.1, 0.2, num_directions=16)
    return ExplorationScenario(
        hall(),
        ROBOT,
        LIDAR,
        (1.8, 4.5, 0.5),
        perception=perception,
        target_coverage=0.99,
        localisation=localisation,
    ).with_guard(jx.MotionGuard())


SCENARIO = scenario_with(
    Localisation(
        localiser=Localiser(ODOMETRY, memory=8.0, spacing=0.2, capacity=CAPACITY),
        closer=LoopCloser(2.0),
    )
)
CONTROLLER = jx.explorer(ROBOT, horizon=30, num_samples=128)


@pytest.fixture(scope="module")
def run():
    return simulate(CONTROLLER, SCENARIO, 2200, key=jax.random.key(3), num_trajectories=0)


def test_scans_correct_what_the_odometry_loses(run) -> None:
    metrics = run.metrics
    assert metrics.is_finished
    assert metrics.collisions == 0
    # The odometry alone is lost after some metres; the map is that of the true poses.
    assert metrics.odometry_ate > 0.3
    assert metrics.ate < 0.05
    assert metrics.map_iou > 0.9
    assert metrics.double_walls < 0.02
    assert metrics.aligned_coverage > 0.95
    assert np.asarray(run.recording.records.pose_error).max() < 0.3
    assert set(run.recording.figures()) == {"map", "coverage"}
    names = {"pose_error", "uncertainty", "true_poses", "estimated_poses", "reference"}
    assert names <= set(run.recording.arrays())


def test_it_is_the_same_run_again_also_in_two_parts(run) -> None:
    half = simulate(CONTROLLER, SCENARIO, 333, key=jax.random.key(3), num_trajectories=0)
    whole = simulate(
        CONTROLLER, SCENARIO, 2200, key=jax.random.key(3), num_trajectories=0, resume=half
    )
    np.testing.assert_array_equal(whole.recording.belief, run.recording.belief)
    np.testing.assert_array_equal(whole.recording.positions, run.recording.positions)
    ends = (each.recording.localisation for each in (whole, run))
    np.testing.assert_array_equal(*(each.poses for each in ends))


def with_known(task, known):
    """Return the state of a robot that knows something else of its pose."""
    place = task.own.place._replace(known=known)
    return task._replace(own=task.own._replace(place=place))


@jax.jit
def perceived(state, moment, key):
    """Return where the robot is and what it maps; fields are not computed then."""
    after, belief = SCENARIO.perceive(state, moment, key)
    return after.own.place.known, after.judged.track.reference, belief.pose, belief.grid


def test_the_robot_maps_where_it_takes_itself_to_be() -> None:
    """Of the true pose nothing reaches the belief but the scans."""
    loop = initial_loop_state(CONTROLLER, SCENARIO, jax.random.key(0))
    task = loop.task
    estimate = jnp.array([2.3, 4.1, 0.9])
    task = with_known(task, task.own.place.known._replace(pose=estimate))
    measured = SCENARIO.measure_state(task)
    np.testing.assert_allclose(ROBOT.pose(measured), estimate)
    guard = SCENARIO.guard.init(ROBOT, SCENARIO.start)
    nothing = jnp.array(False)
    zero = jnp.zeros((), jnp.int32)
    moment = Moment(zero, jnp.zeros(()), measured, nothing, nothing, measured, guard)
    known, reference, pose, grid = perceived(task, moment, jax.random.key(1))
    # Nothing is known that the scan could correct the pose with: it stays.
    np.testing.assert_allclose(known.pose, estimate, atol=1e-6)
    np.testing.assert_allclose(pose, estimate, atol=1e-6)
    # The same scan at the true pose is the judge's map.
    truth = ROBOT.pose(task.robot)
    scan = known.scans.scan(zero, SCENARIO.sensors)[0]
    for pose, found in ((estimate, grid), (truth, reference)):
        values = found.probability if hasattr(found, "probability") else found
        ends = pose[:2] + scan.ranges[:, None] * 0.9 * jnp.stack(
            [jnp.cos(pose[2] + LIDAR.beam_angles), jnp.sin(pose[2] + LIDAR.beam_angles)], axis=1
        )
        cells = np.asarray(jax.vmap(grid.frame.to_cell)(ends))
        inside = (cells >= 0).all(axis=1) & (cells < np.array([90, 120])).all(axis=1)
        free = np.asarray(values)[tuple(cells[inside].T)] < 0.25
        assert free.mean() > 0.95


def test_the_drift_of_a_run_is_drawn_by_its_key() -> None:
    drawn = [
        initial_loop_state(CONTROLLER, SCENARIO, jax.random.key(seed)).task.odometer.errors
        for seed in (0, 0, 1)
    ]
    assert drawn[0].turn_per_metre == drawn[1].turn_per_metre != drawn[2].turn_per_metre
    assert drawn[0].scale == 0.0


def test_a_closed_loop_moves_the_map_the_robot_and_what_its_guard_expects(run) -> None:
    state = run.checkpoint.loop.state
    known = state.task.own.place.known
    number, poses, last = int(known.scans.number), known.scans.poses, known.scans.last
    # Say where the last scan was taken relative to the first, and bend the way between them.
    exact = between(poses[0], poses[last])
    closures = known.closures.with_loop(
        jnp.zeros((), jnp.int32), last, exact, jnp.diag(jnp.array([1e-6, 1e-6, 1e-6]))
    )
    known = known._replace(closures=closures._replace(examined=jnp.asarray(number, jnp.int32)))
    bent = poses.at[:number, 1].add(jnp.linspace(0.0, 0.6, number))
    shifted = compose(bent[last], between(poses[last], known.pose))
    changed = known._replace(scans=known.scans._replace(poses=bent), pose=shifted)
    task = with_known(state.task, changed)
    bent_state = state._replace(
        task=task,
        observed=correct_state(ROBOT, state.observed, known.pose, shifted),
        guard=state.guard._replace(
            expected=correct_state(ROBOT, state.guard.expected, known.pose, shifted)
        ),
    )
    after = SCENARIO.update_on_host(bent_state)
    found = after.task.own.place.known
    assert np.abs(np.asarray(found.scans.poses - bent)[:number, :2]).max() > 0.1
    # The loops fit again: the errors along the way are those of before.
    np.testing.assert_allclose(found.scans.poses[:number], poses[:number], atol=0.05)
    # The state that the robot observes and the one that its guard expects move with its pose.
    for new, old in (
        (after.observed, state.observed),
        (after.guard.expected, state.guard.expected),
    ):
        np.testing.assert_allclose(
            between(found.pose, ROBOT.pose(new)), between(known.pose, ROBOT.pose(old)), atol=1e-4
        )
    # The map was made anew from the stored scans: its walls are those of the run's map.
    walls = [np.asarray(each.task.belief.grid.probability) > 0.65 for each in (after, state)]
    assert (walls[0] & walls[1]).sum() > 0.5 * walls[1].sum()
    assert np.isfinite(np.asarray(after.task.belief.guidance(found.pose[:2])))


def test_half_of_the_scans_can_be_left_out(run) -> None:
    known = run.checkpoint.loop.state.task.own.place.known
    number = int(known.scans.number)
    assert not is_nearly_full(known)
    assert is_nearly_full(
        known._replace(scans=known.scans._replace(number=jnp.asarray(CAPACITY - 3, jnp.int32)))
    )
    fewer = thin_scans(known)
    left = int(fewer.scans.number)
    assert left == (number + 1) // 2
    np.testing.assert_array_equal(fewer.scans.poses[:left], known.scans.poses[:number:2])
    np.testing.assert_array_equal(fewer.scans.ranges[:left], known.scans.ranges[:number:2])
    both = jax.vmap(compose)(known.scans.motions[1:-1:2], known.scans.motions[2::2])
    np.testing.assert_allclose(fewer.scans.motions[1:left], both[: left - 1], atol=1e-6)
    covariances = np.asarray(known.scans.covariances, float)
    for k in range(1, left):
        # A turn of the first motion moves the end of the second by its lever.
        dx, dy, _ = np.asarray(known.scans.motions, float)[2 * k]
        turn = float(known.scans.motions[2 * k - 1][2])
        cos, sin = np.cos(turn), np.sin(turn)
        turned = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        lever = np.eye(3)
        lever[:2, 2] = -sin * dx - cos * dy, cos * dx - sin * dy
        expected = lever @ covariances[2 * k - 1] @ lever.T
        expected += turned @ covariances[2 * k] @ turned.T
        np.testing.assert_allclose(fewer.scans.covariances[k], expected, rtol=1e-3, atol=1e-8)
    # Where a loop was measured without error, so is that of the scans that are left.
    loops = int(known.closures.number)
    exact = jax.vmap(lambda pair: between(*known.scans.poses[pair]))(known.closures.pairs)
    fewer = thin_scans(known._replace(closures=known.closures._replace(motions=exact)))
    expected = jax.vmap(lambda pair: between(*fewer.scans.poses[pair]))(fewer.closures.pairs)
    np.testing.assert_allclose(fewer.closures.motions[:loops], expected[:loops], atol=1e-5)


def test_other_numbers_compile_nothing_again(run) -> None:
    traced = []

    @eqx.filter_jit
    def step(scenario, state, moment):
        traced.append(1)
        return scenario.advance(state, jnp.zeros(2), moment, info)[0].own.place.known.pose

    nothing = jnp.zeros(())
    info = Info(jnp.zeros((1, 2)), nothing[None], nothing[None], nothing, jnp.array(True), None)
    state = initial_loop_state(CONTROLLER, SCENARIO, jax.random.key(0))
    guard = SCENARIO.guard.init(ROBOT, SCENARIO.start)
    moment = Moment(
        jnp.zeros((), jnp.int32),
        nothing,
        SCENARIO.start,
        jnp.array(False),
        jnp.array(False),
        SCENARIO.start,
        guard,
    )
    for noise in (0.05, 0.01):
        other = scenario_with(
            Localisation(
                localiser=Localiser(
                    Odometry(distance_noise=noise), memory=9.0 * noise, capacity=CAPACITY
                ),
                closer=LoopCloser(1.0 + noise),
            )
        )
        step(other, state.task, moment)
    assert len(traced) == 1
