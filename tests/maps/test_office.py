import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from jaxplore.maps.generators.office import ROBOT_RADIUS, START_CLEARANCE, office, start_pose
from jaxplore.maps.occupancy_grid import OccupancyGrid

SIZES = [
    (20.0, 14.0, 0.1),
    (20.0, 14.0, 0.05),
    (8.0, 7.0, 0.2),
    (9.9, 7.0, 0.07),
    (30.0, 20.0, 0.13),
    (12.3, 9.1, 0.18),
]
FLOORS = [(seed, *SIZES[seed % len(SIZES)]) for seed in range(36)] + [(67, 9.9, 7.0, 0.05)]


def free_cells(grid):
    return np.asarray(grid.probability) == 0


def distance_to_walls(free, resolution):
    """Return a lower bound of each cell centre's distance to the nearest occupied square [m]."""
    return (ndimage.distance_transform_edt(free) - math.sqrt(0.5)) * resolution


@pytest.mark.parametrize(("seed", "width", "height", "resolution"), FLOORS)
def test_every_place_is_reachable(seed, width, height, resolution):
    grid = office(seed, width=width, height=height, resolution=resolution)
    free = free_cells(grid)
    assert grid.shape == (round(height / resolution), round(width / resolution))
    assert set(np.unique(np.asarray(grid.probability))) == {0.0, 1.0}
    assert not free[[0, -1]].any()
    assert not free[:, [0, -1]].any()
    assert ndimage.label(free)[1] == 1

    fits = distance_to_walls(free, resolution) >= ROBOT_RADIUS
    pieces, count = ndimage.label(fits)
    assert count == 1
    # The robot gets near everything, not only around one corner of the building.
    seen = ndimage.distance_transform_edt(pieces == 0) * resolution
    assert seen[free].max() < 1.5
    assert 0.4 < free.mean() < 0.95


@pytest.mark.parametrize(("seed", "width", "height", "resolution"), FLOORS)
def test_the_start_is_at_the_west_end_of_the_corridor(seed, width, height, resolution):
    grid = office(seed, width=width, height=height, resolution=resolution)
    x, y, yaw = start_pose(grid)
    row, column = int(y / resolution), int(x / resolution)
    free = free_cells(grid)
    faces = (ndimage.distance_transform_edt(free) - 0.5) * resolution
    assert faces[row, column] >= START_CLEARANCE
    assert START_CLEARANCE < x < 1.2
    assert abs(y - height / 2) < 0.12 * height
    assert yaw == 0.0
    assert free[row, column : -round(0.2 / resolution) - 1].all()


def test_the_corridor_and_the_rooms():
    for seed in range(8):
        free = free_cells(office(seed))
        along = free.sum(axis=1)
        corridor = np.flatnonzero(along == along.max())
        breadth = corridor.size * 0.1
        assert 1.75 < breadth < 2.35
        assert (np.diff(corridor) == 1).all()
        for side in (corridor[0] - 1, corridor[-1] + 1):
            doors, count = ndimage.label(free[side])
            widths = np.bincount(doors)[1:] * 0.1
            assert count >= 4
            assert (widths > 0.85).all()
            assert (widths < 1.15).all()


def test_a_seed_gives_one_floor():
    floors = [free_cells(office(seed)) for seed in range(6)]
    np.testing.assert_array_equal(floors[0], free_cells(office()))
    np.testing.assert_array_equal(floors[3], free_cells(office(3)))
    for index, floor in enumerate(floors):
        assert not any(np.array_equal(floor, other) for other in floors[index + 1 :])


def test_the_start_follows_the_grid_frame():
    here = office(1)
    x, y, _ = start_pose(here)
    moved = OccupancyGrid(here.probability, 0.1, (3.0, -2.0, math.pi / 2))
    np.testing.assert_allclose(start_pose(moved), (3.0 - y, -2.0 + x, math.pi / 2), atol=1e-6)
    position = jnp.asarray(start_pose(moved), jnp.float32)[:2]
    assert moved.at(position) == 0.0


def test_no_start_without_room():
    for values in (np.ones((5, 5)), np.zeros((4, 30))):
        with pytest.raises(ValueError, match="clearance"):
            start_pose(OccupancyGrid(values.astype(np.float32), 0.1))


def test_a_resolution_that_is_no_normal_number_is_refused():
    with pytest.raises(ValueError, match=r"resolution is .*accepted") as caught:
        office(resolution=1e-320)
    assert "\n" not in str(caught.value)
