"""The search of a whole map, against poses that are known and a slow search in NumPy."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import Lidar, OccupancyGrid
from jaxplore.localisation import ParticleFilter
from jaxplore.localisation.place_search import search_places

pytestmark = pytest.mark.long

LIDAR = Lidar(num_beams=60, max_range=5.0, range_noise=0.01)
FILTER = ParticleFilter()
RESOLUTION = 0.1
SHAPE = (40, 60)


@eqx.filter_jit
def look(grid, pose, expected):
    scan = LIDAR.scan(grid, pose, key=jax.random.key(1))
    field = FILTER.likelihood_field(grid)
    points = scan.points(LIDAR)
    found = search_places(FILTER, field, points, scan.is_return, LIDAR.max_range, expected)
    return found, field, points, scan.is_return


def room(*boxes) -> OccupancyGrid:
    """A room of 6 m x 4 m with boxes (first row, last row, first column, last column)."""
    values = np.zeros(SHAPE, np.float32)
    values[[0, -1]] = values[:, [0, -1]] = 1.0
    for first, last, left, right in boxes:
        values[first:last, left:right] = 1.0
    return OccupancyGrid(values, RESOLUTION, (-1.0, 2.0, 0.4))


def nowhere():
    return jnp.full((2, 3), jnp.nan)


def world(grid, row, column, yaw):
    place = grid.frame.to_world(jnp.array([row, column]))
    return jnp.array([*place.tolist(), yaw], jnp.float32)


UNLIKE = room((8, 14, 10, 16), (25, 40, 40, 44), (0, 6, 50, 60))


@pytest.mark.parametrize("at", [(20.3, 20.8, 2.0), (31.2, 8.1, -2.9), (12.5, 45.5, 0.4)])
def test_a_scan_is_found_where_it_was_taken(at) -> None:
    pose = world(UNLIKE, *at)
    found, *_ = look(UNLIKE, pose, nowhere())
    np.testing.assert_allclose(found.pose[:2], pose[:2], atol=0.06)
    turn = float(found.pose[2] - pose[2])
    assert abs(np.arctan2(np.sin(turn), np.cos(turn))) < 0.03
    assert bool(found.is_seen)
    assert bool(found.is_unique)
    assert not np.isfinite(found.near_ratios).any()
    np.testing.assert_array_equal(found.contradicted, 1.0)


def test_no_pose_of_a_slow_search_elsewhere_fits_better_than_the_rival() -> None:
    """The likelihood of ends alone is a bound of that of whole beams."""
    pose = world(UNLIKE, 20.3, 20.8, 2.0)
    found, field, points, is_return = look(UNLIKE, pose, nowhere())
    distance, ends = np.asarray(field.distance.values), np.asarray(points)[np.asarray(is_return)]

    def likelihood(row, column, yaw) -> float:
        cos, sin = np.cos(yaw - 0.4), np.sin(yaw - 0.4)
        x, y = ends.T
        rows, columns = sin * x + cos * y, cos * x - sin * y
        cells = np.floor([row + rows / RESOLUTION, column + columns / RESOLUTION]).astype(int)
        is_in = (cells >= 0).all(axis=0) & (cells[0] < SHAPE[0]) & (cells[1] < SHAPE[1])
        away = np.full(len(ends), 0.6)
        away[is_in] = distance[tuple(cells[:, is_in])]
        fit = np.exp(-0.5 * (away / 0.1) ** 2)
        return 0.3 * np.log(0.8 * fit + 0.2).sum()

    def at(pose) -> float:
        row, column = np.asarray(UNLIKE.frame.to_grid(jnp.asarray(pose[:2])))
        return likelihood(row, column, float(pose[2]))

    best = at(found.pose)
    centre = np.asarray(UNLIKE.frame.to_grid(found.pose[:2]))
    free = np.argwhere(np.asarray(UNLIKE.is_free))[::3] + 0.5
    far = [each for each in free if np.hypot(*(each - centre)) * RESOLUTION > 1.1]
    elsewhere = max(likelihood(*each, yaw) for each in far for yaw in np.arange(0, 6.28, 0.1))
    assert best - elsewhere > 3.0
    assert float(found.ratio) <= best - at(found.rival) + 25.0
    assert float(found.ratio) > 3.0


def test_a_room_that_looks_alike_turned_by_half_is_not_unique() -> None:
    grid = room()
    pose = world(grid, 12.0, 14.0, 1.0)
    other = world(grid, 28.0, 46.0, 1.0 - np.pi)
    found, *_ = look(grid, pose, jnp.stack([pose, other]))
    assert bool(found.is_seen)
    assert not bool(found.is_unique)
    ends = np.stack([found.pose[:2], found.rival[:2]])
    # One of them is the true one, whichever fits better by rounding.
    near = [np.abs(ends - each[:2]).max(axis=1).min() for each in (pose, other)]
    np.testing.assert_allclose(near, 0.0, atol=0.1)
    # Both are as good where the robot is expected, and nothing speaks against them.
    assert (np.abs(found.near_ratios) < 0.7).all()
    assert (np.asarray(found.contradicted) < 0.05).all()


def test_another_place_is_contradicted_and_an_unknown_one_is_not() -> None:
    values = np.array(UNLIKE.probability)
    values[:, 30:] = 0.5
    half = OccupancyGrid(values, RESOLUTION, (-1.0, 2.0, 0.4))
    pose = world(UNLIKE, 20.3, 52.0, 2.0)
    scan = LIDAR.scan(UNLIKE, pose, key=jax.random.key(1))
    field = FILTER.likelihood_field(half)
    expected = jnp.stack([pose, world(UNLIKE, 30.0, 20.0, -1.0)])
    found = eqx.filter_jit(search_places)(
        FILTER, field, scan.points(LIDAR), scan.is_return, LIDAR.max_range, expected
    )
    assert float(found.contradicted[0]) < 0.1 < 0.3 < float(found.contradicted[1])


def test_an_empty_scan_is_seen_nowhere() -> None:
    field = FILTER.likelihood_field(UNLIKE)
    points, none = jnp.zeros((60, 2)), jnp.zeros(60, bool)
    found = eqx.filter_jit(search_places)(FILTER, field, points, none, LIDAR.max_range, nowhere())
    assert float(found.share) == 0.0
    assert np.isfinite(found.pose).all()
