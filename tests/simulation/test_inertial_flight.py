"""A quadrotor that knows its pose by an IMU and its scans only."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxplore as jx
from jaxplore.geometry.motion import between, compose
from jaxplore.localisation import InertialOdometry, Localiser, ParticleFilter, ParticleLocaliser
from jaxplore.robot.localisation import Localisation, correct_state
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.loop import initial_loop_state
from jaxplore.simulation.run import simulate

pytestmark = pytest.mark.long

LIDAR = jx.Lidar(num_beams=90, max_range=4.0, range_noise=0.01)
ROBOT = jx.Quadrotor()
# Ten times as biased as by default: the IMU is lost within seconds.
IMU = InertialOdometry(acceleration_noise=0.05, acceleration_bias=0.5)
START = (2.0, 2.0, 0.4)


def rooms() -> jx.OccupancyGrid:
    """A room of 9 m x 6 m with a block and two pilasters, and three more behind doors.

    Its length makes the flight long enough for the IMU alone to get lost.
    """
    world = np.full((60, 270), 0.01, np.float32)
    world[0] = world[-1] = world[:, 0] = world[:, -1] = 0.99
    world[:40, 90] = world[52:, 90] = world[:10, 145] = world[22:, 145] = 0.99
    world[:36, 200] = world[48:, 200] = 0.99
    world[10:18, 110:116] = world[40:48, 170:180] = world[20:30, 230:240] = 0.99
    world[26:36, 40:52] = 0.99
    world[:8, 60:66] = world[48:, 20:32] = 0.99
    return jx.OccupancyGrid(world, 0.1)


WORLD = rooms()
SCENARIO = ExplorationScenario(
    WORLD,
    ROBOT,
    LIDAR,
    START,
    perception=jx.Perception(LIDAR, 0.1, 0.3, num_directions=16),
    target_coverage=0.97,
    localisation=Localisation(localiser=Localiser(IMU, capacity=300)),
).with_guard(jx.MotionGuard())
CONTROLLER = jx.explorer(ROBOT, horizon=30, num_samples=128)


@pytest.fixture(scope="module")
def run():
    return simulate(CONTROLLER, SCENARIO, 1500, key=jax.random.key(1), num_trajectories=0)


def test_it_explores_by_what_scans_make_of_the_imu(run) -> None:
    metrics, records = run.metrics, run.recording.records
    assert metrics.is_finished
    assert metrics.collisions == 0
    # The IMU alone is metres off before the end.
    assert metrics.odometry_ate > 1.0
    assert metrics.ate < 0.05
    assert metrics.map_iou > 0.9
    assert np.asarray(records.pose_error).max() < 0.3


def test_it_learns_the_velocity_and_the_biases(run) -> None:
    task = run.checkpoint.loop.state.task
    known, true = task.own.place.known.errors, task.odometer.errors
    wrong = np.concatenate([known.mean[:2] - true.velocity, known.mean[2:4] - true.acceleration])
    stds = np.sqrt(np.diagonal(known.covariance))[:4]
    # Of a velocity error of more than a metre a second and of biases of 0.5 m/s^2 as good as
    # nothing is left, and the filter knows how much.
    assert np.abs(true.velocity).max() > 1.0
    assert stds[:2].max() < 0.1
    assert stds[2:].max() < 0.1
    assert np.abs(wrong / stds).max() < 4.0


def test_it_observes_the_velocity_that_it_knows() -> None:
    """The true velocity with what is left of the error, in the frame of the estimated yaw."""
    task = initial_loop_state(CONTROLLER, SCENARIO, jax.random.key(0)).task
    known, odometer = task.own.place.known, task.odometer
    errors = known.errors._replace(mean=jnp.array([0.3, -0.1, 0.0, 0.0, 0.0]))
    estimate = jnp.array([2.2, 1.9, 1.1])
    place = task.own.place._replace(known=known._replace(pose=estimate, errors=errors))
    velocity = odometer.errors._replace(velocity=jnp.array([0.5, 0.1]))
    task = task._replace(
        own=task.own._replace(place=place), odometer=odometer._replace(errors=velocity)
    )
    state = task.robot.at[3:6].set(jnp.array([1.0, 0.2, -0.3]))
    found = np.asarray(SCENARIO.measure_state(task._replace(robot=state)), float)
    np.testing.assert_allclose(ROBOT.pose(jnp.asarray(found, jnp.float32)), estimate, atol=1e-5)
    turned = np.exp(1j * (1.1 - 0.4)) * (1.0 + 0.2j) + np.exp(1.1j) * (0.2 + 0.2j)
    np.testing.assert_allclose(found[3] + 1j * found[4], turned, atol=1e-5)
    assert found[5] == pytest.approx(-0.3)
    # A closed loop turns the velocity with the pose.
    before, after = jnp.array([0.0, 0.0, 0.2]), jnp.array([1.0, 1.0, -0.3])
    moved = np.asarray(correct_state(ROBOT, state, before, after), float)
    np.testing.assert_allclose(moved[3] + 1j * moved[4], np.exp(-0.5j) * (1.0 + 0.2j), atol=1e-5)
    np.testing.assert_allclose(
        between(after, ROBOT.pose(jnp.asarray(moved, jnp.float32))),
        between(before, ROBOT.pose(state)),
        atol=1e-5,
    )


# A flight around the block, twice, with its nose ahead.
TIME = 0.05 * np.arange(800, dtype=np.float32)
ANGLE = 2 * np.pi * TIME / 20.0
WAY = np.stack(
    [
        4.5 - 2.6 * np.cos(ANGLE),
        3.1 - 1.6 * np.sin(ANGLE),
        np.unwrap(np.arctan2(-1.6 * np.cos(ANGLE), 2.6 * np.sin(ANGLE))),
    ],
    axis=1,
).astype(np.float32)


@eqx.filter_jit
def flown(estimator, key: jax.Array):
    """Fly along `WAY`; return estimated poses, and those by the IMU alone."""
    drawn, started = jax.random.split(key)
    known = estimator.start(jnp.asarray(WAY[0]), WORLD, (LIDAR,), started)

    def step(carry, given):
        known, errors, alone = carry
        before, after, index = given
        moving, seeing = jax.random.split(jax.random.fold_in(key, index))
        motion, errors = IMU.measure(between(before, after), jnp.asarray(0.05), errors, moving)
        known = estimator.predict(known, motion, jnp.asarray(0.05))
        known = jax.lax.cond(
            index % 4 == 3,
            lambda each: estimator.correct(each, (LIDAR.scan(WORLD, after, key=seeing),), (LIDAR,)),
            lambda each: each,
            known,
        )
        alone = compose(alone, motion)
        return (known, errors, alone), (known.pose, alone, known.errors.mean[:2] - errors.velocity)

    # It speeds up from rest where it begins: the velocity is known there.
    start = known, IMU.draw(drawn), jnp.asarray(WAY[0])
    given = jnp.asarray(WAY[:-1]), jnp.asarray(WAY[1:]), jnp.arange(len(WAY) - 1)
    return jax.lax.scan(step, start, given)[1]


@pytest.mark.parametrize(
    ("estimator", "error", "speed"),
    [
        (Localiser(IMU, capacity=300), 0.05, 0.05),
        (ParticleLocaliser(ParticleFilter(IMU, 1000, 45), capacity=300), 0.2, 0.3),
    ],
)
def test_each_estimator_holds_the_imu(estimator, error: float, speed: float) -> None:
    poses, alone, wrong = (np.asarray(each) for each in flown(estimator, jax.random.key(7)))
    away = np.hypot(*(poses - WAY[1:])[:, :2].T)
    lost = np.hypot(*(alone - WAY[1:])[:, :2].T)
    assert lost[-1] > 5.0
    assert np.sqrt((away**2).mean()) < error
    assert np.sqrt((wrong[100:] ** 2).mean()) < speed
