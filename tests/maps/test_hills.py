import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore.maps.world import hill_elevation, is_on_map

TOP = st.floats(-2.0, 6.0)
HILLS = st.lists(st.tuples(TOP, TOP, st.floats(-3.0, 3.0), st.floats(0.05, 4.0)), max_size=4)


def slow(hills, shape, resolution, corner):
    """The formula, cell by cell."""
    elevation = np.zeros(shape)
    for row, column in np.ndindex(*shape):
        x, y = corner[0] + (column + 0.5) * resolution, corner[1] + (row + 0.5) * resolution
        for top_x, top_y, height, radius in hills:
            away = math.dist((x, y), (top_x, top_y))
            if away < radius:
                # cos^2 by the double angle
                elevation[row, column] += height * (1 + math.cos(math.pi * away / radius)) / 2
    return elevation


@settings(max_examples=30)
@given(HILLS, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_elevation_is_the_sum_of_the_formula(hills, x, y):
    found = hill_elevation(hills, (12, 17), 0.25, (x, y))
    np.testing.assert_allclose(found, slow(hills, (12, 17), 0.25, (x, y)), atol=1e-9)


def test_known_values():
    # Tops at the centres of cells (1, 2) and (1, 6), 1 m apart from the next cells.
    found = hill_elevation([[2.5, 1.5, 3.0, 2.0], [6.5, 1.5, -1.0, 1.0]], (3, 8), 1.0)
    np.testing.assert_allclose(found[1], [0, 1.5, 3, 1.5, 0, 0, -1, 0], atol=1e-12)
    assert found[1, 0] == found[1, 4] == found[1, 5] == found[1, 7] == 0.0  # at the radius
    diagonal = 3 * math.cos(math.pi * math.sqrt(2) / 4) ** 2
    np.testing.assert_allclose(found[[0, 2], [1, 3]], diagonal)
    assert not hill_elevation([], (3, 8), 1.0).any()


@settings(max_examples=30)
@given(TOP, TOP, st.floats(-3.0, 3.0), st.floats(0.05, 4.0))
def test_a_hill_is_bounded_and_exactly_level_outside(x, y, height, radius):
    found = hill_elevation([(x, y, height, radius)], (40, 40), 0.1)
    centres = (np.arange(40) + 0.5) * 0.1
    away = np.hypot(centres - x, centres[:, None] - y)
    assert (found[away > radius * (1 + 1e-12)] == 0.0).all()
    assert (np.abs(found) <= abs(height)).all()
    assert (found * np.sign(height) >= 0.0).all()
    # No chord is steeper than the steepest tangent.
    steepest = abs(height) * math.pi / (2 * radius)
    for axis in (0, 1):
        assert np.abs(np.diff(found, axis=axis)).max() <= steepest * 0.1 + 1e-12


def test_the_slope_bound_is_reached_half_way_down():
    found = hill_elevation([[0.0, 0.0005, 2.0, 1.0]], (1, 1000), 0.001)[0]
    slope = -np.diff(found) / 0.001
    assert abs(slope.max() - math.pi) < 1e-4  # 2 pi / (2 * 1)
    assert abs((slope.argmax() + 1) * 0.001 - 0.5) < 0.005


@settings(max_examples=30)
@given(TOP, TOP, st.floats(0.01, 1.0))
def test_a_hill_is_on_the_map_where_it_raises_a_cell(x, y, radius):
    raised = hill_elevation([(x, y, 1.0, radius)], (8, 10), 0.4, (-0.5, 1.0)).any()
    assert is_on_map((x, y, 1.0, radius), (8, 10), 0.4, (-0.5, 1.0)) == raised


@settings(max_examples=15)
@given(st.integers(-4000, 4000), st.integers(-4000, 4000))
def test_hills_elsewhere_are_the_same(right, up):
    corner = np.array([right, up]) * 0.25  # exact in binary
    hill = (corner[0] + 1.0, corner[1] + 0.7, 1.0, 0.9)
    there = hill_elevation([hill], (20, 20), 0.1, corner)
    here = hill_elevation([[1.0, 0.7, 1.0, 0.9]], (20, 20), 0.1)
    np.testing.assert_allclose(there, here, atol=1e-10)
