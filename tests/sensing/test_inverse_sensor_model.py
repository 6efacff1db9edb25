"""The model for which one look settles a cell; the gradual update is tested with the lidar."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import InverseSensorModel, Lidar, OccupancyGrid

DECISIVE = InverseSensorModel.line_of_sight()
update = jax.jit(lambda model, p, change: model.update(p, change))
WALL = np.float32(0.65)  # above it a cell is known to be occupied
PRIORS = st.floats(0.0, 1.0, width=32)


def looked(model: InverseSensorModel, p: float, *, hit: bool) -> np.ndarray:
    change = model.occupied if hit else model.free
    return np.asarray(update(model, jnp.float32(p), change))


@given(PRIORS, st.sampled_from([(0.01, 0.99), (0.2, 0.7), (1e-4, 0.5001)]))
def test_one_look_settles_a_cell_whatever_was_known(p: float, settled: tuple[float, float]) -> None:
    low, high = settled
    model = InverseSensorModel.line_of_sight(free=low, occupied=high)
    assert looked(model, p, hit=True) == pytest.approx(high, rel=1e-6)
    passed = looked(model, p, hit=False)
    if np.float32(p) > WALL:  # a wall stays as it is, to the bit
        assert passed == np.float32(p)
    else:
        assert passed == pytest.approx(low, rel=1e-6)


@given(PRIORS, st.booleans())
def test_a_second_look_changes_nothing(p: float, hit: bool) -> None:
    once = looked(DECISIVE, p, hit=hit)
    assert looked(DECISIVE, float(once), hit=hit) == once


def test_a_wall_begins_right_above_the_threshold_for_occupied() -> None:
    assert looked(DECISIVE, float(WALL), hit=False) == pytest.approx(0.01, rel=1e-6)
    above = np.nextafter(WALL, np.float32(1.0))
    assert looked(DECISIVE, float(above), hit=False) == above


def test_no_change_is_no_look() -> None:
    p = jnp.linspace(0.0, 1.0, 21)
    np.testing.assert_array_equal(update(DECISIVE, p, jnp.zeros(21)), p)


def test_a_gradual_model_moves_walls_too() -> None:
    gradual = InverseSensorModel()
    assert not gradual.is_decisive
    assert not InverseSensorModel.from_odds().is_decisive
    expected = 1.0 / (1.0 + math.exp(-(math.log(0.9 / 0.1) - 2.0)))
    assert looked(gradual, 0.9, hit=False) == pytest.approx(expected, rel=1e-5)
    p = jnp.asarray([0.0, 1e-5, 0.5, 0.9, 1.0])
    np.testing.assert_array_equal(gradual.settle(p), p)
    assert not gradual.stays(p, jnp.asarray(-2.0)).any()


def test_what_is_settled_counts_as_certain_and_nothing_else() -> None:
    p = [0.0, 0.001, 0.01, 0.0102, 0.3, 0.5, 0.9, 0.9898, 0.99, 0.999, 1.0]
    expected = np.asarray([0, 0, 0, 0.0102, 0.3, 0.5, 0.9, 0.9898, 1, 1, 1], np.float32)
    np.testing.assert_array_equal(DECISIVE.settle(jnp.asarray(p)), expected)


def test_only_walls_stay_and_only_when_passed() -> None:
    p = jnp.asarray([0.01, 0.5, 0.65, 0.66, 0.99])
    np.testing.assert_array_equal(DECISIVE.stays(p, DECISIVE.free), [0, 0, 0, 1, 1])
    assert not DECISIVE.stays(p, DECISIVE.occupied).any()


LIDAR, RESOLUTION, SIZE = Lidar(24, 4.0, math.pi / 2, 0.0), 0.1, (40, 50)
scan = jax.jit(lambda world, pose, key: LIDAR.scan(world, pose, key=key))
observe = jax.jit(lambda belief, scan, pose: LIDAR.update(belief, scan, pose, DECISIVE))


def march(world: np.ndarray, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which cells are passed, which are hit, and which are too close to call.

    A beam is cut at every line of the grid; the middle of a piece says which cell it lies in. Of a
    piece shorter than a thousandth of a cell rounding decides, and of all behind it if it is solid.
    """
    passed, hit, unsure = (np.zeros(world.shape, bool) for _ in range(3))
    start, reach = pose[:2] / RESOLUTION, 4.0 / RESOLUTION
    lines = np.arange(-50, 100)
    for angle in pose[2] + np.linspace(-math.pi / 4, math.pi / 4, 24):
        direction = np.array([math.cos(angle), math.sin(angle)])
        cuts = ((lines[:, None] - start) / direction).ravel()
        cuts = np.sort([0.0, *cuts[(cuts > 0.0) & (cuts < reach)], reach])
        middles = start + 0.5 * (cuts[1:] + cuts[:-1])[:, None] * direction
        is_doubtful = False
        for cell, length, end in zip(np.floor(middles), np.diff(cuts), cuts[1:], strict=True):
            column, row = cell.astype(int)
            if not (0 <= row < SIZE[0] and 0 <= column < SIZE[1]):
                break  # off the map everything is solid
            is_solid = world[row, column] >= 0.25
            if is_doubtful or length < 1e-3:
                unsure[row, column] = True
                is_doubtful |= bool(is_solid)
            elif is_solid:
                hit[row, column] = True
                break
            elif end < reach:  # the last one is not left within the range
                passed[row, column] = True
    return passed, hit, unsure


@given(st.integers(0, 2**32 - 1))
def test_a_scan_settles_what_is_in_sight_and_nothing_behind(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = (rng.random(SIZE) < 0.03).astype(np.float32)
    pose = np.array([*rng.uniform(1.0, 3.0, 2), rng.uniform(-4.0, 4.0)]).astype(np.float32)
    row, column = int(pose[1] / RESOLUTION), int(pose[0] / RESOLUTION)
    world[row - 3 : row + 4, column - 3 : column + 4] = 0.0
    prior = rng.uniform(0.02, 0.98, SIZE).astype(np.float32)
    passed, hit, unsure = march(world, pose.astype(float))
    measured = scan(OccupancyGrid(world, RESOLUTION), jnp.asarray(pose), jax.random.key(0))
    once = observe(OccupancyGrid(prior, RESOLUTION), measured, jnp.asarray(pose))
    found, sure = np.asarray(once.probability), ~unsure
    np.testing.assert_allclose(found[hit & sure], 0.99, rtol=1e-6)
    np.testing.assert_allclose(found[passed & sure & (prior <= WALL)], 0.01, rtol=1e-6)
    is_kept = sure & ~hit & (~passed | (prior > WALL))
    np.testing.assert_array_equal(found[is_kept], prior[is_kept])
    assert (passed & sure).sum() > 5
    twice = observe(once, measured, jnp.asarray(pose))
    np.testing.assert_array_equal(twice.probability, found)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"free": 0.0}, "free is 0.0; accepted: a finite number > 0.0 and < 0.5"),
        ({"free": 0.5}, "free is 0.5; accepted: a finite number > 0.0 and < 0.5"),
        ({"free": math.nan}, "free is nan; accepted"),
        ({"occupied": 0.5}, "occupied is 0.5; accepted: a finite number > 0.5 and < 1.0"),
        ({"occupied": 1.0}, "occupied is 1.0; accepted: a finite number > 0.5 and < 1.0"),
    ],
)
def test_bad_probabilities_are_named(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        InverseSensorModel.line_of_sight(**arguments)


def test_traced_probabilities_pass_and_do_not_recompile() -> None:
    made = jax.jit(InverseSensorModel.line_of_sight)(jnp.asarray(0.05), jnp.asarray(0.8))
    assert looked(made, 0.4, hit=False) == pytest.approx(0.05, rel=1e-6)
    assert looked(made, 0.4, hit=True) == pytest.approx(0.8, rel=1e-6)
    before = update._cache_size()
    looked(InverseSensorModel.line_of_sight(0.02, 0.7), 0.4, hit=True)
    assert update._cache_size() == before
