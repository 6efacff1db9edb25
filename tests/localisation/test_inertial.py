"""Inertial odometry against closed forms, and its filter against runs of NumPy in the world."""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.localisation import (
    ErrorEstimate,
    InertialErrors,
    InertialOdometry,
    Localiser,
    Odometry,
    ParticleFilter,
    ParticleLocaliser,
    Reckoning,
)

KEY = jax.random.key(5)
NAMES = tuple(InertialOdometry.__dataclass_fields__)
CONSTANT = 1e12
"""Time constant of biases that stay the same [s]."""
RUNS, STEPS, PERIOD = 4000, 200, 0.05


@eqx.filter_jit
def measured(
    odometry: InertialOdometry, motions: jax.Array, errors: InertialErrors, keys: jax.Array
) -> tuple[jax.Array, InertialErrors]:
    """Return motions (R, T, 3) as they are measured in R runs, and the errors after them."""

    def run(errors: InertialErrors, key: jax.Array) -> tuple[jax.Array, InertialErrors]:
        def step(
            errors: InertialErrors, given: tuple[jax.Array, jax.Array]
        ) -> tuple[InertialErrors, jax.Array]:
            motion, errors = odometry.measure(given[0], jnp.asarray(PERIOD), errors, given[1])
            return errors, motion

        last, found = jax.lax.scan(step, errors, (motions, jax.random.split(key, len(motions))))
        return found, last

    return jax.vmap(run)(errors, keys)


@eqx.filter_jit
def reckoned(odometry: InertialOdometry, start: Reckoning, motions: jax.Array) -> Reckoning:
    """Return what a filter knows after measured motions (T, 3)."""

    def step(known: Reckoning, motion: jax.Array) -> tuple[Reckoning, None]:
        return odometry.predict(known, motion, jnp.asarray(PERIOD)), None

    return jax.lax.scan(step, start, motions)[0]


def placed(motions: np.ndarray) -> np.ndarray:
    """Return the poses (R, 3) that motions (R, T, 3) lead to, in double precision."""
    turns = np.cumsum(motions[..., 2], axis=1)
    before = turns - motions[..., 2]
    dx, dy = motions[..., 0], motions[..., 1]
    x = (np.cos(before) * dx - np.sin(before) * dy).sum(axis=1)
    y = (np.sin(before) * dx + np.cos(before) * dy).sum(axis=1)
    return np.stack([x, y, turns[:, -1]], axis=1)


def same_errors(velocity: list[float], acceleration: list[float], gyro: float) -> InertialErrors:
    """Return the same errors for each run."""
    parts = (velocity, acceleration, gyro)
    return InertialErrors(
        *(jnp.broadcast_to(jnp.asarray(each), (RUNS, *np.shape(each))) for each in parts)
    )


NONE = same_errors([0.0, 0.0], [0.0, 0.0], 0.0)


def at_rest(odometry: InertialOdometry) -> Reckoning:
    """Return what is known of a robot at rest at the origin."""
    return Reckoning(jnp.zeros(3), jnp.zeros((3, 3)), odometry.estimate(), jnp.zeros(()))


# A flight that speeds up, weaves and turns round more than once.
TIME = (np.arange(STEPS) + 0.5) * PERIOD
FLIGHT = PERIOD * np.stack(
    [
        np.minimum(0.3 * TIME, 1.5),
        0.4 * np.sin(1.3 * TIME),
        0.8 * np.ones_like(TIME),
    ],
    axis=1,
)
KEYS = jax.random.split(KEY, RUNS)


def test_a_robot_at_rest_drifts_as_the_closed_form_says() -> None:
    odometry = InertialOdometry(0.02, 0.0, 0.003, 0.0, CONSTANT)
    motions, errors = measured(odometry, jnp.zeros((STEPS, 3)), NONE, KEYS)
    found = placed(np.asarray(motions, float))
    t = STEPS * PERIOD
    # The noise of the velocity, integrated: q t^3 / 3, and q t for the velocity and the yaw.
    expected = np.diag([0.02**2 * t**3 / 3, 0.02**2 * t**3 / 3, 0.003**2 * t])
    spread = np.cov(np.linalg.solve(np.linalg.cholesky(expected), found.T))
    np.testing.assert_allclose(spread, np.eye(3), atol=0.12)
    assert np.asarray(errors.velocity).std() == pytest.approx(0.02 * math.sqrt(t), rel=0.05)
    # A filter that takes nothing else into account says the same.
    alone = odometry.covariance(jnp.zeros(3), jnp.asarray(t))
    np.testing.assert_allclose(alone, expected, rtol=1e-5, atol=1e-10)
    known = reckoned(odometry, at_rest(odometry), jnp.zeros((STEPS, 3)))
    np.testing.assert_allclose(known.covariance, expected, rtol=0.01, atol=1e-6)


def test_a_bias_adds_half_of_it_times_the_time_squared() -> None:
    silent = InertialOdometry(0.0, 0.05, 0.0, 0.01, CONSTANT)
    errors = same_errors([0.0, 0.0], [0.05, -0.02], 0.0)
    motions, after = measured(silent, jnp.zeros((STEPS, 3)), errors, KEYS)
    t = STEPS * PERIOD
    expected = [0.05 * t**2 / 2, -0.02 * t**2 / 2, 0.0]
    np.testing.assert_allclose(
        placed(np.asarray(motions, float))[0], expected, rtol=1e-4, atol=1e-6
    )
    np.testing.assert_allclose(after.velocity[0], [0.05 * t, -0.02 * t], rtol=1e-4)
    spread = silent.covariance(jnp.zeros(3), jnp.asarray(t))
    np.testing.assert_allclose(jnp.diagonal(spread), [6.25, 6.25, 0.01], rtol=1e-5)


def test_flying_straight_on_an_error_of_the_yaw_does_not_bend_the_way() -> None:
    """The velocity of an inertial navigator keeps its direction in the world."""
    silent = InertialOdometry(0.0, 0.0, 0.0, 0.02, CONSTANT)
    errors = same_errors([0.0, 0.0], [0.0, 0.0], 0.02)
    ahead = jnp.tile(jnp.array([2.0 * PERIOD, 0.0, 0.0]), (STEPS, 1))
    motions, _ = measured(silent, ahead, errors, KEYS)
    t = STEPS * PERIOD
    found = placed(np.asarray(motions, float))[0]
    np.testing.assert_allclose(found, [2.0 * t, 0.0, 0.02 * t], atol=1e-3)
    # A filter that knows only how great the bias may be does not doubt the position either.
    known = reckoned(silent, at_rest(silent), motions[0])
    assert np.abs(np.diagonal(known.covariance)[:2]).max() < 1e-5
    assert float(known.covariance[2, 2]) == pytest.approx((0.02 * t) ** 2, rel=1e-3)
    assert float(known.way) == pytest.approx(2.0 * t, rel=1e-4)


def strapdown(odometry: InertialOdometry, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Fly `FLIGHT` with an inertial navigator in the world, in double precision.

    Returns:
        Poses (R, 3) by the navigator, true errors (R, 5) of its velocity and its biases at the end,
        and the measured motions (T, 3) of one run.
    """
    noise, bias, drift, gyro, time = (float(getattr(odometry, name)) for name in NAMES)
    biases = rng.normal(size=(RUNS, 3)) * [bias, bias, gyro]
    kept = math.exp(-PERIOD / time)
    yaw, where = np.zeros(RUNS), np.zeros((RUNS, 2))
    true_yaw, motions = 0.0, []
    velocity = np.zeros((RUNS, 2))

    def turned(angle: np.ndarray | float, vector: np.ndarray) -> np.ndarray:
        cos, sin, (x, y) = np.cos(angle), np.sin(angle), vector.T
        return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)

    for step, motion in enumerate(FLIGHT):
        # What accelerometers feel between the mean velocities of two steps, in the true frame.
        here = turned(true_yaw, motion[None, :2] / PERIOD)
        there = here if step == 0 else before
        felt = turned(-true_yaw, here - there) if step else motion[None, :2] / PERIOD
        velocity = velocity + turned(yaw, np.broadcast_to(felt, (RUNS, 2)))
        gained = biases[:, :2] * PERIOD + noise * math.sqrt(PERIOD) * rng.normal(size=(RUNS, 2))
        moved = (velocity + turned(yaw, 0.5 * gained)) * PERIOD
        turn = motion[2] + biases[:, 2] * PERIOD + drift * math.sqrt(PERIOD) * rng.normal(size=RUNS)
        motions.append(np.append(turned(-yaw, moved)[0], turn[0]))
        where, velocity = where + moved, velocity + turned(yaw, gained)
        yaw, true_yaw, before = yaw + turn, true_yaw + motion[2], here
        new = rng.normal(size=(RUNS, 3)) * [bias, bias, gyro]
        biases = kept * biases + math.sqrt(1.0 - kept**2) * new
    error = turned(-yaw, velocity) - turned(-true_yaw, before)
    return np.column_stack([where, yaw]), np.column_stack([error, biases]), np.array(motions)


@pytest.fixture(scope="module")
def flown() -> tuple[InertialOdometry, tuple[np.ndarray, ...]]:
    odometry = InertialOdometry(0.02, 0.03, 0.004, 0.005, 20.0)
    return odometry, strapdown(odometry, np.random.default_rng(2))


def test_measured_flights_are_those_of_an_inertial_navigator_in_the_world(flown) -> None:
    odometry, (poses, errors, _) = flown
    start = jax.vmap(odometry.draw)(jax.random.split(KEY, RUNS))
    motions, after = measured(odometry, jnp.asarray(FLIGHT, jnp.float32), start, KEYS)
    found = np.column_stack(
        [placed(np.asarray(motions, float)), after.velocity, after.acceleration, after.gyro]
    )
    expected = np.column_stack([poses, errors])
    truth = placed(FLIGHT[None])[0]
    np.testing.assert_allclose(found[:, :3].mean(axis=0), truth, atol=0.06)
    root = np.linalg.cholesky(np.cov(expected.T))
    np.testing.assert_allclose(np.cov(np.linalg.solve(root, found.T)), np.eye(8), atol=0.16)


def test_the_covariance_of_the_filter_is_that_of_many_flights(flown) -> None:
    odometry, (poses, errors, motions) = flown
    known = reckoned(odometry, at_rest(odometry), jnp.asarray(motions, jnp.float32))
    assert known.errors is not None
    # Nothing was learned, so the pose is that of the navigator.
    np.testing.assert_allclose(known.pose, poses[0], atol=1e-3)
    np.testing.assert_allclose(known.errors.mean, np.zeros(5), atol=1e-6)
    expected = np.block(
        [
            [known.covariance, known.errors.cross],
            [known.errors.cross.T, known.errors.covariance],
        ]
    ).astype(float)
    # The true pose and errors around what one navigator says, as seen from its frame.
    truth = placed(FLIGHT[None])[0]
    turn = poses[0, 2] - poses[:, 2]
    cos, sin = np.cos(turn), np.sin(turn)
    away = truth - poses
    local = np.column_stack(
        [
            cos * away[:, 0] - sin * away[:, 1],
            sin * away[:, 0] + cos * away[:, 1],
            away[:, 2],
            errors,
        ]
    )
    root = np.linalg.cholesky(expected)
    np.testing.assert_allclose(np.cov(np.linalg.solve(root, local.T)), np.eye(8), atol=0.16)


def test_a_corrected_pose_corrects_the_errors_as_a_kalman_filter_does() -> None:
    rng = np.random.default_rng(4)
    root = rng.normal(size=(8, 8)) * np.array([0.1, 0.1, 0.02, 0.1, 0.1, 0.03, 0.03, 0.01])[:, None]
    joint = root @ root.T
    noise = np.diag([0.02, 0.05, 0.01]) ** 2
    measured_by = np.array([0.1, -0.05, 0.01])
    # In double precision, with the gain of the whole state.
    gain = joint[:, :3] @ np.linalg.inv(joint[:3, :3] + noise)
    mean, spread = gain @ measured_by, joint - gain @ joint[:3]
    errors = ErrorEstimate(
        *(jnp.asarray(each, jnp.float32) for each in (np.zeros(5), joint[3:, 3:], joint[:3, 3:]))
    )
    prior = jnp.array([2.0, -1.0, 3.1])
    found = errors.correct(
        prior,
        jnp.asarray(joint[:3, :3], jnp.float32),
        # The yaw may be counted otherwise.
        prior + jnp.asarray(mean[:3] + np.array([0.0, 0.0, -2.0 * math.pi]), jnp.float32),
        jnp.asarray(spread[:3, :3], jnp.float32),
    )
    np.testing.assert_allclose(found.mean, mean[3:], rtol=2e-3, atol=1e-5)
    np.testing.assert_allclose(found.covariance, spread[3:, 3:], rtol=2e-3, atol=2e-6)
    np.testing.assert_allclose(found.cross, spread[:3, 3:], rtol=2e-3, atol=2e-6)
    # A covariance that cannot be inverted teaches nothing.
    same = errors.correct(prior, jnp.zeros((3, 3)), prior, jnp.zeros((3, 3)))
    np.testing.assert_array_equal(same.mean, errors.mean)
    np.testing.assert_array_equal(same.covariance, errors.covariance)
    np.testing.assert_array_equal(same.cross, jnp.zeros((3, 5)))


def test_poses_from_time_to_time_teach_the_velocity_and_the_biases() -> None:
    """A filter that is told the pose is right about its errors, and as sure as it should be."""
    odometry = InertialOdometry(0.02, 0.05, 0.0017, 0.01, 30.0)
    std = jnp.array([0.01, 0.01, 0.005])

    @eqx.filter_jit
    def fly(keys: jax.Array) -> tuple[jax.Array, jax.Array]:
        def run(key: jax.Array) -> tuple[jax.Array, jax.Array]:
            drawn, noisy, told = jax.random.split(key, 3)
            motions, after = measured(
                odometry,
                jnp.asarray(FLIGHT, jnp.float32),
                jax.tree.map(lambda each: each[None], odometry.draw(drawn)),
                noisy[None],
            )

            def step(carry, given):
                known, true = carry
                motion, exact, key, is_told = given
                known = odometry.predict(known, motion, jnp.asarray(PERIOD))
                true = true + jnp.array([exact[0], exact[1], exact[2]])
                spread = known.covariance
                gain = spread @ jnp.linalg.inv(spread + jnp.diag(std**2))
                seen = true + std * jax.random.normal(key, (3,))
                pose = known.pose + gain @ (seen - known.pose)
                better = known._replace(
                    pose=pose,
                    covariance=spread - gain @ spread,
                    errors=known.errors.correct(known.pose, spread, pose, spread - gain @ spread),
                )
                known = jax.tree.map(lambda new, old: jnp.where(is_told, new, old), better, known)
                return (known, true), None

            yaw = np.cumsum(FLIGHT[:, 2]) - FLIGHT[:, 2]
            world = np.stack(
                [
                    np.cos(yaw) * FLIGHT[:, 0] - np.sin(yaw) * FLIGHT[:, 1],
                    np.sin(yaw) * FLIGHT[:, 0] + np.cos(yaw) * FLIGHT[:, 1],
                    FLIGHT[:, 2],
                ],
                axis=1,
            )
            given = (
                motions[0],
                jnp.asarray(world, jnp.float32),
                jax.random.split(told, STEPS),
                jnp.arange(STEPS) % 4 == 3,
            )
            (known, _), _ = jax.lax.scan(step, (at_rest(odometry), jnp.zeros(3)), given)
            true = jnp.concatenate([after.velocity[0], after.acceleration[0], after.gyro[0][None]])
            return known.errors.mean - true, known.errors.covariance

        return jax.vmap(run)(keys)

    away, spread = (np.asarray(each, float) for each in fly(jax.random.split(KEY, 500)))
    # Far better than what was known at the start: 0.05 m/s^2 and 0.01 rad/s of biases.
    assert np.sqrt((away[:, :2] ** 2).mean()) < 0.03
    assert np.sqrt((away[:, 2:4] ** 2).mean()) < 0.025
    assert np.sqrt((away[:, 4] ** 2).mean()) < 0.004
    squared = np.einsum("ri,rij,rj->r", away, np.linalg.inv(spread), away)
    # The mean of a chi-squared variable of five degrees, with its standard error of 0.14.
    assert squared.mean() == pytest.approx(5.0, abs=0.5)


def test_wheels_estimate_nothing() -> None:
    wheels = Odometry(0.05, 0.03)
    assert wheels.estimate() is None
    errors = wheels.draw(KEY)
    motion, after = wheels.measure(jnp.array([0.3, 0.1, 0.2]), jnp.asarray(0.1), errors, KEY)
    assert after is errors
    assert wheels.velocity_error(errors, None) is None
    known = wheels.predict(
        Reckoning(jnp.zeros(3), jnp.zeros((3, 3)), None, jnp.ones(())), motion, jnp.asarray(0.1)
    )
    np.testing.assert_array_equal(known.pose, motion)
    np.testing.assert_array_equal(known.covariance, wheels.covariance(motion, jnp.asarray(0.1)))
    assert known.errors is None
    assert float(known.way) == pytest.approx(1.0 + float(jnp.hypot(motion[0], motion[1])))


def test_errors_are_drawn_with_their_standard_deviations() -> None:
    odometry = InertialOdometry(acceleration_bias=0.3, gyro_bias=0.02)
    drawn = jax.vmap(odometry.draw)(jax.random.split(KEY, 4000))
    np.testing.assert_array_equal(drawn.velocity, np.zeros((4000, 2)))
    np.testing.assert_allclose(drawn.acceleration.std(axis=0), [0.3, 0.3], rtol=0.06)
    assert float(drawn.gyro.std()) == pytest.approx(0.02, rel=0.06)
    assert all(float(jnp.abs(each).max()) == 0.0 for each in odometry.draw(None))


def test_it_is_an_odometry_of_each_estimator() -> None:
    odometry = InertialOdometry()
    filtering = ParticleLocaliser(ParticleFilter(odometry))
    for estimator in (Localiser(odometry), filtering):
        assert estimator.expected_odometry is odometry


def test_other_numbers_do_not_recompile(traced: Callable[..., int]) -> None:
    def step(odometry: InertialOdometry, key: jax.Array) -> Reckoning:
        motion, _ = odometry.measure(
            jnp.array([0.1, 0.0, 0.1]), jnp.asarray(0.1), odometry.draw(key), key
        )
        return odometry.predict(at_rest(odometry), motion, jnp.asarray(0.1))

    assert traced(step, [(InertialOdometry(**{name: 0.1}), KEY) for name in NAMES]) == 1
