"""What a tracker makes of its measurements: where obstacles are, how sure, and which are known."""

import math

import hypothesis.extra.numpy as hnp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.belief import Obstacles

PLANE = hnp.arrays(np.float32, (3, 2), elements=st.floats(-5, 5, width=32))
RADII = jnp.asarray([0.2, 0.3, 0.4])
update = jax.jit(Obstacles.update)


def look(
    obstacles: Obstacles, positions, velocities, is_seen, std: float, elapsed: float
) -> Obstacles:
    arrays = (jnp.asarray(a, jnp.float32) for a in (positions, velocities))
    numbers = (jnp.asarray(a, jnp.float32) for a in (std, elapsed))
    return update(obstacles, *arrays, jnp.asarray(is_seen), *numbers)


@given(PLANE, PLANE, st.floats(0, 3, width=32))
def test_predictions_are_true_of_straight_motion(start, velocities, t: float) -> None:
    seen = look(Obstacles.unseen(RADII), start, velocities, [True] * 3, 0.1, 0.05)
    true = start.astype(np.float64) + t * velocities.astype(np.float64)
    np.testing.assert_allclose(seen.predict_centres(jnp.asarray(t)), true, atol=2e-5)
    # Out of sight they go on in just this way.
    unseen = look(seen, np.zeros((3, 2)), np.zeros((3, 2)), [False] * 3, 0.1, t)
    np.testing.assert_allclose(unseen.centres, true, atol=2e-5)
    np.testing.assert_array_equal(unseen.velocities, velocities)
    assert unseen.is_known.all()


@given(PLANE, PLANE, hnp.arrays(bool, 3), st.floats(0.125, 1, width=32))
def test_what_is_seen_is_where_it_was_measured(positions, velocities, is_seen, std) -> None:
    before = look(
        Obstacles.unseen(RADII, 0.5), np.ones((3, 2)), np.ones((3, 2)), [True] * 3, 0.3, 0.1
    )
    after = look(before, positions, velocities, is_seen, std, 0.4)
    for n in range(3):
        if is_seen[n]:
            np.testing.assert_array_equal(after.centres[n], positions[n])
            np.testing.assert_array_equal(after.velocities[n], velocities[n])
            assert after.covariance[n, 0, 0] == np.float32(std) * np.float32(std)
            assert not after.age[n]
        else:
            np.testing.assert_allclose(after.centres[n], 1.4, rtol=1e-6)
            np.testing.assert_array_equal(after.velocities[n], 1.0)
            np.testing.assert_array_equal(after.covariance[n], before.covariance[n])
            expected = math.hypot(0.3, 0.5 * (0.4 + 0.3))
            assert float(after.deviation(jnp.asarray(0.3))[n]) == pytest.approx(expected, rel=1e-6)


def test_what_was_seen_once_stays_known() -> None:
    obstacles = Obstacles.unseen(RADII)
    nothing = np.zeros((3, 2))
    assert not obstacles.is_known.any()
    for is_seen, known in (
        ([False, False, False], [False, False, False]),
        ([True, False, False], [True, False, False]),
        ([False, False, True], [True, False, True]),
    ):
        obstacles = look(obstacles, nothing, nothing, is_seen, 0.1, 0.05)
        np.testing.assert_array_equal(obstacles.is_known, known)
    np.testing.assert_array_equal(obstacles.outlines.radii, RADII)


def test_what_is_out_of_sight_for_long_is_forgotten_until_it_is_seen_again() -> None:
    nothing = np.zeros((3, 2))
    obstacles = look(Obstacles.unseen(RADII, memory=0.5), nothing, nothing, [True] * 3, 0.1, 0.1)
    for is_seen, known in (
        ([True, False, False], [True] * 3),
        ([True, False, False], [True] * 3),
        ([False, False, False], [True, False, False]),
        ([False, True, False], [True, True, False]),
        ([False, False, False], [False, True, False]),
    ):
        obstacles = look(obstacles, nothing, nothing, is_seen, 0.1, 0.2)
        np.testing.assert_array_equal(obstacles.is_known, known)


def test_the_error_that_it_states_is_that_of_a_velocity_that_is_off() -> None:
    """Monte Carlo: measured once, then out of sight for a second."""
    rng = np.random.default_rng(0)
    obstacles = look(
        Obstacles.unseen(RADII, 0.3), np.zeros((3, 2)), np.ones((3, 2)), [True] * 3, 0.2, 0.0
    )
    for elapsed in (0.05, 0.75, 0.2):  # in whatever steps the time goes by
        obstacles = look(obstacles, np.zeros((3, 2)), np.zeros((3, 2)), [False] * 3, 0.2, elapsed)
    position, velocity = rng.normal(0.0, 0.2, 100_000), 1.0 + rng.normal(0.0, 0.3, 100_000)
    errors = position + velocity - np.asarray(obstacles.centres)[0, 0]
    stated = float(obstacles.deviation(jnp.zeros(()))[0])
    assert stated == pytest.approx(errors.std(), rel=0.01)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_measurement_that_is_no_number_is_none(value: float) -> None:
    before = look(
        Obstacles.unseen(RADII), np.ones((3, 2)), np.ones((3, 2)), [True, True, False], 0.1, 0.1
    )
    positions, velocities = np.full((3, 2), 2.0), np.full((3, 2), 2.0)
    positions[0, 1] = velocities[1, 0] = positions[2, 0] = value
    after = look(before, positions, velocities, [True] * 3, 0.1, 0.0)
    np.testing.assert_array_equal(after.centres[:2], 1.0)
    np.testing.assert_array_equal(after.is_known, [True, True, False])
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(after))


def test_none() -> None:
    obstacles = Obstacles.unseen(())
    empty = np.zeros((0, 2))
    after = look(obstacles, empty, empty, np.zeros(0, bool), 0.1, 0.05)
    for found in (obstacles, after):
        assert found.predict_centres(jnp.asarray(1.0)).shape == (0, 2)
        assert found.outlines.radii.shape == found.age.shape == found.is_known.shape == (0,)


@pytest.mark.parametrize(
    ("changes", "culprit"),
    [
        ({"radii": [0.2, -0.5]}, "radii has a value -0.5; accepted: finite numbers >= 0.0"),
        ({"radii": [0.2, np.nan]}, "radii has a value nan; accepted"),
        ({"radii": np.ones((2, 2))}, r"radii has shape \(2, 2\); accepted: \(N,\)"),
        ({"growth": -0.5}, "growth has a value -0.5; accepted"),
        ({"memory": 0.0}, "memory is 0.0; accepted"),
    ],
)
def test_bad_input_is_named(changes, culprit: str) -> None:
    with pytest.raises(ValueError, match=culprit):
        Obstacles.unseen(**{"radii": [0.2], **changes})
