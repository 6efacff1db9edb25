import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.resample import resample

LEVELS = [0.0, 0.1, 0.2, 0.25, 0.4, 0.5, 0.6, 0.65, 0.66, 0.8, 1.0]
MAPS = hnp.arrays(
    np.float32,
    hnp.array_shapes(min_dims=2, max_dims=2, max_side=9),
    elements=st.sampled_from(LEVELS),
)
# Millimetres, so that the oracle can decide overlaps in whole numbers.
SIZES = st.integers(20, 400)


def cell_by_cell(old, size, new_size):
    """Return the map by the definition, one new cell at a time; sizes in whole millimetres."""
    height, width = (math.ceil(n * size / new_size) for n in old.shape)
    new = np.empty((height, width), old.dtype)
    for row in range(height):
        for column in range(width):
            met = [
                old[i, j]
                for i in range(old.shape[0])
                for j in range(old.shape[1])
                if i * size < (row + 1) * new_size
                and (i + 1) * size > row * new_size
                and j * size < (column + 1) * new_size
                and (j + 1) * size > column * new_size
            ]
            unknown = [p for p in met if 0.25 <= p <= np.float32(0.65)]
            if max(met) > np.float32(0.65) or not unknown:
                new[row, column] = max(met)
            else:
                new[row, column] = min(unknown, key=lambda p: (abs(float(p) - 0.5), -p))
    return new


@given(MAPS, SIZES, SIZES)
def test_agrees_with_the_definition(old, size, new_size):
    new = resample(old, size / 1000.0, new_size / 1000.0)
    np.testing.assert_array_equal(new, cell_by_cell(old, size, new_size))
    assert new.dtype == old.dtype


@given(MAPS, SIZES)
def test_the_same_resolution_changes_nothing(old, size):
    np.testing.assert_array_equal(resample(old, size / 1000.0, size / 1000.0), old)


@given(MAPS, st.integers(1, 6))
def test_there_and_back_is_exact_when_the_ratio_is_whole(old, times):
    fine = resample(old, 0.3, 0.3 / times)
    np.testing.assert_array_equal(fine, np.kron(old, np.ones((times, times), np.float32)))
    np.testing.assert_array_equal(resample(fine, 0.3 / times, 0.3), old)


@pytest.mark.parametrize(
    ("met", "expected"),
    [
        ([0.0, 1.0], 1.0),
        ([0.5, 0.7], 0.7),
        ([0.0, 0.5], 0.5),
        ([0.3, 0.1], 0.3),
        ([0.3, 0.6], 0.6),
        ([0.375, 0.625], 0.625),
        ([0.0, 0.2], 0.2),
        ([0.25, 0.0], 0.25),
        ([0.65, 0.64], 0.64),
        ([0.75, 0.9], 0.9),
    ],
)
def test_the_most_cautious_value_wins(met, expected):
    assert resample(np.array([met], np.float32), 0.05, 0.1) == np.float32(expected)


@pytest.mark.parametrize(
    ("size", "old", "new", "expected"),
    [
        (100, 0.05, 0.1, 50),
        (101, 0.05, 0.1, 51),
        (10, 0.03, 0.1, 3),
        (11, 0.03, 0.1, 4),
        (3, 0.05, 0.15, 1),
        (7, 0.1, 0.7, 1),
        (3, 0.1, 0.3, 1),
        (2, 0.3, 0.1, 6),
        (5, 0.05, 100.0, 1),
        (5, 1e-30, 1e30, 1),
    ],
)
def test_size(size, old, new, expected):
    assert resample(np.zeros((size, size), np.float32), old, new).shape == (expected, expected)


def test_a_wall_one_cell_thick_survives():
    old = np.zeros((50, 50), np.float32)
    old[:, 17] = 1.0
    new = resample(old, 0.03, 0.1)
    assert new.shape == (15, 15)
    # 17 x 0.03 = 0.51 m to 0.54 m: column 5 of 0.1 m.
    assert (new[:, 5] == 1.0).all()
    assert new.sum() == 15


def test_the_grid_keeps_its_corner():
    grid = OccupancyGrid(np.eye(4, dtype=np.float32), 0.05, (1.0, 2.0, 0.3)).resample(0.1)
    assert grid.resolution == 0.1
    assert grid.shape == (2, 2)
    np.testing.assert_array_equal(grid.probability, np.eye(2))
    np.testing.assert_array_equal(grid.frame.origin, np.float32([1.0, 2.0, 0.3]))


@pytest.mark.parametrize(
    ("values", "old", "new", "named"),
    [
        (np.zeros((2, 2)), 0.0, 0.1, "resolution is 0.0"),
        (np.zeros((2, 2)), math.nan, 0.1, "resolution is nan"),
        (np.zeros((2, 2)), 0.1, -1.0, "new_resolution is -1.0"),
        (np.zeros((2, 2)), 0.1, math.inf, "new_resolution is inf"),
        (np.zeros((2, 2)), 0.1, 1e300, "new_resolution is 1e+300"),
        (np.zeros((2, 2)), 0.1, 1e-320, "new_resolution is"),
        (np.zeros((2000, 2000)), 0.05, 0.01, "10000 x 10000"),
        (np.zeros((2, 2, 2)), 0.1, 0.1, "shape (2, 2, 2)"),
        (np.zeros((0, 2)), 0.1, 0.1, "shape (0, 2)"),
    ],
)
def test_refusals(values, old, new, named):
    with pytest.raises(ValueError, match="accepted") as caught:
        resample(values, old, new)
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)
