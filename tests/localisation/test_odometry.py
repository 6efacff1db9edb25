"""Odometry with errors: their mean and spread against the formula."""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxplore.localisation import Odometry, OdometryBias

KEY = jax.random.key(3)
NAMES = tuple(Odometry.__dataclass_fields__)
NOISY = Odometry(0.05, 0.03, 0.07, 0.04)
BIAS = OdometryBias(*(jnp.asarray(each) for each in (0.03, -0.05, 0.02, 0.01)))
MOTION = jnp.array([0.6, -0.8, -0.5])


@eqx.filter_jit
def measured(
    odometry: Odometry, motion: jax.Array, elapsed: jax.Array, bias: OdometryBias, keys: jax.Array
) -> jax.Array:
    """Return one measurement for each key."""
    return jax.vmap(odometry.measure, (None, None, None, 0))(motion, elapsed, bias, keys)[0]


def spread(errors: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the covariance of errors relative to that which is expected: the identity."""
    return np.cov(np.linalg.solve(np.linalg.cholesky(covariance), errors.T))


def test_measurements_have_the_mean_and_the_spread_of_the_formula() -> None:
    found = np.asarray(
        measured(NOISY, MOTION, jnp.asarray(2.0), BIAS, jax.random.split(KEY, 20_000)), float
    )
    # The motion is 1 m long, turns by 0.5 rad and takes 2 s.
    mean = [1.03 * 0.6, -1.03 * 0.8, -0.95 * 0.5 + 0.02 + 0.01 * 2.0]
    position, yaw = 0.05**2 + 0.04**2 * 0.5, 0.03**2 + 0.07**2 * 0.5
    expected = np.diag([position, position, yaw])
    # Five standard errors.
    np.testing.assert_allclose(found.mean(axis=0), mean, atol=5 * math.sqrt(yaw / 20_000))
    np.testing.assert_allclose(spread(found, expected), np.eye(3), atol=0.05)
    np.testing.assert_allclose(NOISY.covariance(MOTION, jnp.asarray(2.0)), expected, rtol=1e-5)


def test_the_error_of_a_drive_does_not_depend_on_the_rate() -> None:
    """A hundred small motions straight on have the noise of a large one."""
    large = jnp.array([2.0, 0.0, 0.0])
    keys = jax.random.split(KEY, (100, 2000))
    none, elapsed = OdometryBias.none(), jnp.asarray(0.01)
    small = [np.asarray(measured(NOISY, large / 100, elapsed, none, each)) for each in keys]
    errors = np.sum(small, axis=0) - np.asarray(large)
    covariance = np.asarray(NOISY.covariance(large, jnp.asarray(1.0)), float)
    np.testing.assert_allclose(spread(errors, covariance), np.eye(3), atol=0.16)


def test_errors_of_a_run_are_drawn_with_their_standard_deviations() -> None:
    odometry = Odometry(0.0, 0.0, 0.0, 0.0, 0.02, 0.03, 0.04, 0.05)
    drawn = np.stack(jax.vmap(odometry.draw)(jax.random.split(KEY, 5000)), axis=1)
    expected = np.diag([0.02, 0.03, 0.04, 0.05]) ** 2
    np.testing.assert_allclose(spread(drawn, expected), np.eye(4), atol=0.1)
    assert np.abs(drawn.mean(axis=0)).max() < 5 * 0.05 / math.sqrt(5000)
    assert all(float(each) == 0.0 for each in odometry.draw(None))
    # Without noise a bias alone is left, and a filter takes it for noise.
    found, _ = odometry.measure(MOTION, jnp.asarray(2.0), BIAS, KEY)
    np.testing.assert_allclose(found, [0.618, -0.824, -0.435], rtol=1e-5)
    yaw = 0.03**2 * 0.5 + 0.04**2 + 0.05**2 * 2.0
    covariance = odometry.covariance(MOTION, jnp.asarray(2.0))
    np.testing.assert_allclose(jnp.diagonal(covariance), [0.02**2, 0.02**2, yaw], rtol=1e-5)


def test_a_robot_that_stands_still_measures_nothing_but_its_gyroscope() -> None:
    still, _ = NOISY.measure(jnp.zeros(3), jnp.asarray(2.0), BIAS, KEY)
    np.testing.assert_allclose(still, [0.0, 0.0, 0.02], atol=1e-7)


def test_other_numbers_do_not_recompile(traced: Callable[..., int]) -> None:
    def measure(odometry: Odometry, key: jax.Array) -> jax.Array:
        return odometry.measure(MOTION, jnp.asarray(1.0), odometry.draw(key), key)[0]

    calls = [(Odometry(**{name: 0.1}), KEY) for name in NAMES]
    assert traced(measure, calls) == 1
