"""Distances from discs, capsules and polygons, against shapely's."""

import hypothesis.extra.numpy as hnp
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.geometry import Outlines
from jaxplore.geometry.outlines import nearest

POINT = st.tuples(st.floats(-6, 6, width=32), st.floats(-6, 6, width=32))
STAR = np.array([[2, 0], [0.5, 0.5], [0, 2], [-0.5, 0.5], [-2, 0], [-0.5, -0.5], [0, -2], [1, -1]])


@jax.jit
def distances(outlines: Outlines, position) -> jax.Array:
    return outlines.distances(position)


def around(angles: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Corners (V, 2) of a polygon that does not cross itself."""
    angles = np.sort(angles)
    return np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=-1)


def signed(polygon: shapely.Polygon, point: tuple[float, float]) -> float:
    away = polygon.exterior.distance(shapely.Point(point))
    return -away if polygon.contains(shapely.Point(point)) else away


@given(
    corners=hnp.arrays(np.float32, 7, elements=st.floats(0.0, 0.875, width=32)),
    radii=hnp.arrays(np.float32, 7, elements=st.floats(0.5, 4, width=32)),
    thickness=st.floats(0, 2, width=32),
    here=POINT,
)
def test_polygons_are_as_far_as_shapelys(corners, radii, thickness, here) -> None:
    # One corner in each seventh of a turn, so that none coincide.
    angles = (np.arange(7) + corners.astype(np.float64)) * (2.0 * np.pi / 7.0)
    polygon = around(angles, radii.astype(np.float64))
    outlines = Outlines.polygons([polygon, polygon[::-1]], thickness)
    expected = signed(shapely.Polygon(polygon), here) - thickness
    found = np.asarray(distances(outlines, jnp.asarray(here, jnp.float32)))
    np.testing.assert_allclose(found, expected, atol=1e-5)


@given(here=POINT, turn=st.floats(-3, 3), shift=POINT)
def test_turned_and_moved_together_they_are_as_far(here, turn, shift) -> None:
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    before = distances(Outlines.polygons([STAR]), jnp.asarray(here, jnp.float32))
    moved = jnp.asarray(rotation @ np.asarray(here) + shift, jnp.float32)
    after = distances(Outlines.polygons([STAR @ rotation.T + np.asarray(shift)]), moved)
    np.testing.assert_allclose(after, before, atol=2e-5)


def test_discs_capsules_and_polygons_go_together() -> None:
    disc = Outlines.discs([[1.0, 0.0]], 0.5)
    capsule = Outlines(jnp.asarray([[[-1.0, 2.0], [1.0, 2.0]]]), jnp.asarray([0.25]))
    square = Outlines.polygons([[[-1, -1], [0, -1], [0, 0], [-1, 0]]])
    everything = disc + capsule + square
    assert everything.corners.shape == (3, 4, 2)
    assert everything.number == 3
    found = distances(everything, jnp.asarray([3.0, 0.0]))
    np.testing.assert_allclose(found, [1.5, np.hypot(2, 2) - 0.25, 3.0], rtol=1e-6)
    np.testing.assert_allclose(everything.centres, [[1, 0], [0, 2], [-0.5, -0.5]], atol=1e-7)
    inside = distances(everything, jnp.asarray([-0.25, -0.5]))
    assert inside[2] == pytest.approx(-0.25)


def test_a_point_that_is_not_a_number_is_at_no_distance() -> None:
    found = distances(Outlines.polygons([STAR]), jnp.asarray([jnp.nan, 0.0]))
    assert np.isnan(found).all()


def test_gradients_are_finite_everywhere() -> None:
    corners, radius = jnp.asarray(STAR, jnp.float32), jnp.asarray(0.5)
    slope = jax.jit(jax.grad(lambda p: nearest(corners, radius, p[0], p[1]).distance))
    for point in ([2.0, 0.0], [0.0, 0.0], [1.25, 0.25], [3.0, 1.0]):
        assert np.isfinite(slope(jnp.asarray(point))).all()
    np.testing.assert_allclose(slope(jnp.asarray([4.0, 0.0])), [1.0, 0.0], atol=1e-6)


@pytest.mark.parametrize(
    ("make", "named"),
    [
        (lambda: Outlines.discs([[0.0, 0.0, 0.0]], 1.0), "centres"),
        (lambda: Outlines.discs([[0.0, float("nan")]], 1.0), "centres"),
        (lambda: Outlines.discs([[0.0, 0.0]], -1.0), "radii"),
        (lambda: Outlines.discs([[0.0, 0.0]], [1.0, 2.0]), "radii"),
        (lambda: Outlines.polygons([[[0, 0], [1, 0]]]), r"polygons\[0\]"),
        (lambda: Outlines.polygons([STAR, [[0, 0], [1, 1], [2, 2]]]), r"polygons\[1\]"),
    ],
)
def test_what_is_no_outline_is_refused(make, named) -> None:
    with pytest.raises(ValueError, match=named):
        make()


def test_none_of_them_is_fine() -> None:
    assert Outlines.discs([], 1.0).number == 0
    assert Outlines.polygons([]).number == 0
    both = Outlines.discs([], 1.0) + Outlines.polygons([STAR])
    assert both.number == 1
    assert both.corners.shape == (1, 8, 2)
