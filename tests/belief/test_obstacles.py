"""Prediction of obstacles, against integration, finite differences and many draws."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from jaxplore.belief import Obstacles
from jaxplore.belief.obstacles import FAR
from jaxplore.geometry import Outlines

SQUARE = np.array([[1.0, 1.0], [2.0, 1.0], [2.0, 2.0], [1.0, 2.0]])
SPEED = st.floats(-3, 3, width=32)
SHORT = st.floats(0, 2, width=32)
RATE = st.one_of(st.floats(-2, 2, width=32), st.floats(-(2.0**-10), 2.0**-10, width=32))


@jax.jit
def later(obstacles: Obstacles, elapsed):
    """Return obstacles a time later, of which none was measured."""
    return obstacles.advance(elapsed)


@jax.jit
def predicted(obstacles: Obstacles, t):
    return obstacles.predict(t), obstacles.predict_centres(t), obstacles.predict_covariance(t)


def one(velocity, turn_rate, **certainty) -> Obstacles:
    return Obstacles(Outlines.polygons([SQUARE]), [velocity], turn_rate, **certainty)


@given(velocity=st.tuples(SPEED, SPEED), turn_rate=RATE, t=st.floats(0, 4, width=32))
def test_they_go_on_as_integrated(velocity, turn_rate, t) -> None:
    def rate(_, state):
        _, _, vx, vy = state
        return [vx, vy, -turn_rate * vy, turn_rate * vx]

    start = [1.5, 1.5, *velocity]
    end = solve_ivp(rate, (0.0, t), start, rtol=1e-9, atol=1e-9).y[:2, -1] if t > 0 else start[:2]
    outlines, centres, _ = predicted(one(velocity, turn_rate), jnp.asarray(t))
    np.testing.assert_allclose(centres[0], end, atol=2e-5)
    angle = turn_rate * t
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    expected = (SQUARE - 1.5) @ rotation.T + end
    np.testing.assert_allclose(outlines.corners[0], expected, atol=3e-5)


@pytest.mark.parametrize("turn_rate", [0.0, 1e-4, 0.15, -0.7, 2.0])
def test_the_covariance_is_that_of_small_errors(turn_rate: float) -> None:
    """By central differences in float64 of the closed form with complex numbers."""
    velocity, t, deviations = 1.2 - 0.5j, 2.5, (0.1, 0.2, 0.3)

    def centre(v: complex, w: float) -> complex:
        return v * (np.exp(1j * w * t) - 1.0) / (1j * w)

    h = 1e-3
    w = turn_rate if abs(turn_rate) > 1e-6 else 1e-9
    slope = (
        (centre(velocity, w + h) - centre(velocity, w - h)) / (2 * h)
        if abs(turn_rate) > 1e-2
        else velocity * (1j * t**2 / 2 - w * t**3 / 3)
    )
    along = np.array([slope.real, slope.imag])
    std, growth, turn_growth = deviations
    expected = (std**2 + (growth * t) ** 2) * np.eye(2) + turn_growth**2 * np.outer(along, along)
    obstacle = one(
        [velocity.real, velocity.imag],
        turn_rate,
        std=std,
        growth=growth,
        turn_growth=turn_growth,
    )
    found = predicted(obstacle, jnp.asarray(t))[2][0]
    np.testing.assert_allclose(found, expected, rtol=2e-4, atol=1e-6)


@given(velocity=st.tuples(SPEED, SPEED), turn_rate=RATE, elapsed=SHORT, t=SHORT)
def test_time_that_goes_by_changes_no_prediction(velocity, turn_rate, elapsed, t) -> None:
    obstacle = one(velocity, turn_rate, std=0.1, growth=0.2, turn_growth=0.3)
    expected = predicted(obstacle, jnp.asarray(elapsed + t))
    found = predicted(later(obstacle, jnp.asarray(elapsed)), jnp.asarray(t))
    for one_, other in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(one_, other, rtol=1e-3, atol=1e-3)


def test_the_deviation_is_that_of_the_longest_axis() -> None:
    obstacle = one([1.0, 0.5], 0.3, covariance=[[0.04, 0.01], [0.01, 0.02]], turn_growth=0.1)
    covariance = np.asarray(predicted(obstacle, jnp.asarray(1.5))[2][0], np.float64)
    expected = np.sqrt(np.linalg.eigvalsh(covariance)[-1])
    assert float(obstacle.deviation(jnp.asarray(1.5))[0]) == pytest.approx(expected, rel=1e-5)


def test_the_extent_is_the_radius_of_the_circle_that_holds_the_outline() -> None:
    both = one([0.0, 0.0], 0.0) + Obstacles(Outlines.discs([[3.0, 4.0]], 1.5))
    np.testing.assert_allclose(both.extents, [np.sqrt(0.5), 1.5], rtol=1e-6)


def test_what_is_not_known_is_predicted_out_of_reach() -> None:
    two = Outlines.polygons([SQUARE, SQUARE], [0.1, 0.2])
    some = Obstacles(two, [[1.0, 0.0], [0.0, 1.0]], std=1.0, is_known=np.array([True, False]))
    outlines, centres, covariance = predicted(some, jnp.asarray(1.0))
    np.testing.assert_allclose(centres[0], [2.5, 1.5])
    assert (np.asarray(centres[1]) >= FAR).all()
    assert (np.asarray(outlines.corners[1]) >= FAR).all()
    np.testing.assert_array_equal(outlines.radii, np.float32([0.1, 0.0]))
    assert not np.any(covariance[1])
    assert float(some.extents[1]) == float(some.deviation(jnp.zeros(()))[1]) == 0.0


def test_a_measured_outline_keeps_its_shape_and_has_turned() -> None:
    obstacle = one([1.0, 0.0], np.pi / 2)
    place, seen = jnp.asarray([[5.0, 6.0]]), jnp.asarray([True])
    after = obstacle.update(place, jnp.zeros((1, 2)), seen, jnp.asarray(0.1), jnp.asarray(1.0))
    np.testing.assert_array_equal(after.centres, place)
    turned = np.array([[5.5, 5.5], [5.5, 6.5], [4.5, 6.5], [4.5, 5.5]])
    np.testing.assert_allclose(after.outlines.corners[0], turned, atol=1e-6)
    np.testing.assert_allclose(after.covariance[0], 0.01 * np.eye(2), rtol=1e-6)


@pytest.mark.parametrize("elapsed", [0.0, 0.8])
def test_draws_are_spread_as_predicted(elapsed: float) -> None:
    obstacle = one(
        [1.0, 0.5], 0.3, covariance=[[0.04, 0.01], [0.01, 0.02]], growth=0.1, turn_growth=0.05
    )
    obstacle = later(obstacle, jnp.asarray(elapsed))
    t = jnp.asarray(1.5 - elapsed)
    keys = jax.random.split(jax.random.key(0), 20000)
    centres = jax.jit(jax.vmap(lambda key: obstacle.sample(key).predict_centres(t)[0]))(keys)
    _, expected, covariance = predicted(obstacle, t)
    np.testing.assert_allclose(np.mean(centres, axis=0), expected[0], atol=5e-3)
    np.testing.assert_allclose(np.cov(np.asarray(centres).T), covariance[0], atol=2e-3)


def test_a_draw_is_known_exactly_and_keeps_its_shape() -> None:
    obstacle = one([1.0, 0.5], 0.3, std=0.5)
    drawn = obstacle.sample(jax.random.key(1))
    assert not np.any(drawn.covariance)
    assert not np.any(drawn.growth)
    moved = np.asarray(drawn.centres - obstacle.centres)
    assert np.abs(moved).max() > 0.01
    np.testing.assert_allclose(drawn.outlines.corners[0] - moved[0], SQUARE, atol=1e-6)
    still = Obstacles(Outlines.discs([[3.0, 4.0]], 1.0)).sample(jax.random.key(2))
    np.testing.assert_array_equal(still.centres, [[3.0, 4.0]])


@pytest.mark.parametrize(
    ("given_", "named"),
    [
        ({"velocities": [[1.0, 2.0], [3.0, 4.0]]}, "velocities"),
        ({"turn_rates": [1.0, 2.0]}, "turn_rates"),
        ({"centres": [1.0, 2.0]}, "centres"),
        ({"std": 1.0, "covariance": np.eye(2)}, "std"),
        ({"covariance": [[1.0, 2.0], [2.0, 1.0]]}, "covariance"),
        ({"is_known": np.array([True, False])}, r"is_known has shape \(2,\); accepted: \(1,\)"),
    ],
)
def test_what_is_no_obstacle_is_refused(given_, named) -> None:
    with pytest.raises(ValueError, match=named):
        Obstacles(Outlines.discs([[0.0, 0.0]], 1.0), **given_)


def test_none_of_them_is_fine() -> None:
    nothing = Obstacles(Outlines.discs([], 1.0), [], [])
    assert nothing.predict_centres(jnp.asarray(1.0)).shape == (0, 2)
