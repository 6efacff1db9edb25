"""One map of two: against a loop over cells, and what happens to walls a few cells off."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.maps import OccupancyGrid, unite_maps


def log_odds(probability: float) -> float:
    bounded = min(max(probability, 0.001), 0.999)
    return math.log(bounded / (1.0 - bounded))


def test_cells_are_those_of_a_loop() -> None:
    """Shifted by whole cells: sums of log-odds, one cell after the other."""
    rng = np.random.default_rng(0)
    values = [0.5, 0.3, 0.1, 0.6, 0.02]  # no walls
    first, second = rng.choice(values, (7, 9)), rng.choice(values, (5, 6))
    one = OccupancyGrid(first, 0.1, (1.0, 2.0, 0.0))
    other = OccupancyGrid(second, 0.1, (-4.0, 3.0, 0.0))
    united = unite_maps(one, other, (4.5, -0.8, 0.0))  # its corner is at (0.5, 2.2)
    assert united.shape == (7, 14)
    np.testing.assert_allclose(np.asarray(united.frame.origin), [0.5, 2.0, 0.0], atol=1e-6)
    found = np.asarray(united.probability)
    for row in range(7):
        for column in range(14):
            a = first[row, column - 5] if column >= 5 else 0.5
            b = second[row - 2, column] if 2 <= row < 7 and column < 6 else 0.5
            expected = 1.0 / (1.0 + math.exp(-log_odds(a) - log_odds(b)))
            assert found[row, column] == pytest.approx(expected, abs=1e-5)


def test_a_map_alone_stays_as_it_is() -> None:
    rng = np.random.default_rng(1)
    one = OccupancyGrid(rng.random((12, 15)), 0.05, (3.0, -2.0, 0.4))
    blank = OccupancyGrid(np.full((4, 5), 0.5), 0.1)
    united = unite_maps(one, blank, (3.2, -1.8, 1.0))
    # The corner of the first one in cells of the united map.
    away = np.asarray(one.frame.origin)[:2] - np.asarray(united.frame.origin)[:2]
    cos, sin = math.cos(0.4), math.sin(0.4)
    column, row = np.rint(np.array([[cos, sin], [-sin, cos]]) @ away / 0.05).astype(int)
    found = np.asarray(united.probability)[row : row + 12, column : column + 15]
    np.testing.assert_array_equal(found, np.asarray(one.probability))
    assert united.shape != one.shape


@pytest.mark.parametrize("yaw", [0.0, 0.5 * math.pi, 2.2])
def test_a_wall_and_its_hall_are_where_the_pose_says(yaw: float) -> None:
    """A point of a wall, and one of free space, followed from the frame of the other map."""
    values = np.full((60, 80), 0.5)
    values[10:50, 10:70] = 0.02
    values[29:32, 20:40] = 0.97
    other = OccupancyGrid(values, 0.05, (-1.0, 0.5, 0.3))
    one = OccupancyGrid(np.full((6, 6), 0.5), 0.05, (2.0, 1.0, -0.7))
    pose = np.array([1.5, -0.5, yaw])
    united = unite_maps(one, other, pose)
    for cell, expected in (((30.5, 30.5), 0.97), ((20.5, 60.5), 0.02), ((5.5, 5.5), 0.5)):
        x, y = np.asarray(other.frame.to_world(jnp.array(cell))).tolist()
        cos, sin = math.cos(yaw), math.sin(yaw)
        there = jnp.array([cos * x - sin * y + pose[0], sin * x + cos * y + pose[1]])
        assert float(united.at(there)) == pytest.approx(expected, abs=1e-3)


def hall(wall: int) -> OccupancyGrid:
    values = np.full((40, 60), 0.02)
    values[:, wall] = 0.98
    return OccupancyGrid(values, 0.05)


def test_a_wall_that_is_some_cells_off_stays() -> None:
    """By the log-odds alone the free space of each map would delete the wall of the other one."""
    united = np.asarray(unite_maps(hall(30), hall(32), (0.0, 0.0, 0.0)).probability)
    assert (united[:, [30, 32]] > 0.9).all()


def test_what_one_map_has_far_from_walls_of_the_other_is_in_doubt() -> None:
    united = np.asarray(unite_maps(hall(20), hall(40), (0.0, 0.0, 0.0)).probability)
    np.testing.assert_allclose(united[:, [20, 40]], 0.5, atol=1e-4)
    assert (np.delete(united, [20, 40], axis=1) < 0.01).all()


def test_maps_too_far_apart_are_refused() -> None:
    with pytest.raises(ValueError, match=r"pose is .*; accepted: at most 64000000 cells"):
        unite_maps(hall(3), hall(4), (9000.0, 9000.0, 0.0))
