"""Trilinear look-ups over position and heading."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.information.heading_field import HeadingField
from jaxplore.maps.frame import GridFrame

ROWS, COLUMNS, COUNT = SHAPE = (4, 6, 5)
YAW, STEP = 0.7, 2 * math.pi / COUNT
VALUES = np.random.default_rng(0).uniform(1.0, 9.0, SHAPE).astype(np.float32)
FIELD = HeadingField(jnp.asarray(VALUES), GridFrame(0.5, (2.0, -1.0, YAW)))
ALL = np.stack(np.meshgrid(*map(np.arange, SHAPE), indexing="ij"), axis=-1).reshape(-1, 3)


@jax.jit
@jax.vmap
def compiled(position: jax.Array, heading: jax.Array) -> tuple[jax.Array, ...]:
    value, slope = jax.value_and_grad(FIELD, argnums=(0, 1))(position, heading)
    return value, *slope


def value_and_slope(position: np.ndarray, heading: np.ndarray) -> list[np.ndarray]:
    """Return values and slopes by position and heading, compiled once for any number of poses."""
    count = len(heading)
    padding = [(0, len(ALL) - count)]
    found = compiled(np.pad(position, [*padding, (0, 0)]), np.pad(heading, padding))
    return [np.asarray(part)[:count] for part in found]


def poses(nodes: np.ndarray, turns: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return the position and heading of points given in nodes (row, column, heading)."""
    nodes = np.asarray(nodes, float)
    y, x = 0.5 * (nodes[:, :2].T + 0.5)
    cos, sin = math.cos(YAW), math.sin(YAW)
    position = np.stack([2.0 + cos * x - sin * y, -1.0 + sin * x + cos * y], axis=-1)
    heading = YAW + STEP * nodes[:, 2] + 2 * math.pi * turns
    return position.astype(np.float32), heading.astype(np.float32)


def read(nodes: np.ndarray, turns: int = 0) -> np.ndarray:
    return value_and_slope(*poses(nodes, turns))[0]


def trilinear(row: float, column: float, heading: float) -> float:
    """Interpolate along one axis after the other."""
    first = min(int(row), ROWS - 2), min(int(column), COLUMNS - 2), math.floor(heading)
    turned = np.roll(VALUES.astype(float), -first[2], axis=2)
    cube = turned[first[0] : first[0] + 2, first[1] : first[1] + 2, :2]
    for share in (p - f for p, f in zip((row, column, heading), first, strict=True)):
        cube = (1 - share) * cube[0] + share * cube[1]
    return float(cube)


@pytest.mark.parametrize("turns", [0, 1, -3])
def test_it_is_exact_at_nodes_and_headings(turns: int) -> None:
    np.testing.assert_allclose(read(ALL, turns), VALUES.reshape(-1), rtol=1e-4)


def test_headings_are_those_of_the_nodes_in_the_world() -> None:
    np.testing.assert_allclose(FIELD.headings, YAW + STEP * np.arange(COUNT), rtol=1e-6)
    position, _ = poses([[2, 3, 0]] * COUNT)
    found = value_and_slope(position, np.asarray(FIELD.headings))[0]
    np.testing.assert_allclose(found, VALUES[2, 3], rtol=1e-4)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_midpoints_are_means(axis: int) -> None:
    """Between the last heading and the first one too."""
    nodes = ALL if axis == 2 else ALL[ALL[:, axis] < SHAPE[axis] - 1]
    following = nodes + np.eye(3, dtype=int)[axis]
    following[:, 2] %= COUNT
    expected = 0.5 * (VALUES[tuple(nodes.T)] + VALUES[tuple(following.T)])
    np.testing.assert_allclose(read(nodes + 0.5 * np.eye(3)[axis]), expected, rtol=1e-4)


places = st.tuples(st.floats(0, ROWS - 1), st.floats(0, COLUMNS - 1), st.floats(-12, 12))


@given(places)
def test_in_between_it_is_trilinear(place: tuple[float, float, float]) -> None:
    assert float(read([place])[0]) == pytest.approx(trilinear(*place), rel=1e-3)


@given(places)
def test_a_whole_turn_changes_nothing(place: tuple[float, float, float]) -> None:
    np.testing.assert_allclose(read([place], 2), read([place], 0), rtol=1e-4)


@given(places)
def test_it_is_between_its_least_and_greatest_value(place: tuple[float, float, float]) -> None:
    assert VALUES.min() - 1e-4 <= float(read([place])[0]) <= VALUES.max() + 1e-4


def test_it_is_zero_right_behind_the_last_nodes() -> None:
    beyond = 0.01
    outside = [
        (-beyond, 2, 0),
        (ROWS - 1 + beyond, 2, 0),
        (2, -beyond, 1),
        (2, COLUMNS - 1 + beyond, 1),
        (-50, 2, 1),
        (2, 1e6, 3),
        (math.nan, 2, 1),
        (2, math.inf, 1),
    ]
    value, *slopes = value_and_slope(*poses(outside))
    np.testing.assert_array_equal(value, 0.0)
    for slope in slopes:
        np.testing.assert_array_equal(slope, 0.0)


def test_slopes_are_those_of_the_interpolation() -> None:
    place = np.array([1.3, 2.6, 3.4])
    _, by_position, by_heading = value_and_slope(*poses(place[None]))
    along = [
        (trilinear(*(place + step)) - trilinear(*(place - step))) / 2e-3
        for step in 1e-3 * np.eye(3)
    ]
    cos, sin = math.cos(YAW), math.sin(YAW)
    # Nodes are 0.5 m apart; rows lie along y, columns along x of the lattice.
    x, y = along[1] / 0.5, along[0] / 0.5
    expected = [cos * x - sin * y, sin * x + cos * y]
    np.testing.assert_allclose(by_position[0], expected, rtol=1e-3)
    assert float(by_heading[0]) == pytest.approx(along[2] / STEP, rel=1e-3)


def test_slopes_are_finite_everywhere() -> None:
    position, heading = poses(ALL)
    heading[:10] = [math.nan, math.inf] * 5
    for part in value_and_slope(position, heading):
        assert np.isfinite(part).all()


def test_the_best_heading_and_the_origin() -> None:
    np.testing.assert_array_equal(FIELD.best.values, VALUES.max(axis=-1))
    np.testing.assert_allclose(FIELD.origin, poses([[0, 0, 0]])[0][0], rtol=1e-6)
    at_node = FIELD.best(jnp.asarray(poses([[1, 4, 0]])[0][0]))
    assert float(at_node) == pytest.approx(VALUES[1, 4].max(), rel=1e-4)
    assert float(FIELD.best(jnp.asarray(poses([[-0.01, 4, 0]])[0][0]))) == 0.0


def test_a_lattice_of_one_node_and_one_heading() -> None:
    field = HeadingField(jnp.full((1, 1, 1), 3.0), GridFrame(0.5))
    for heading in (0.0, 2.0, -7.0):
        assert float(field(field.origin, jnp.float32(heading))) == 3.0
    assert float(field(field.origin + 0.01, jnp.float32(0.0))) == 0.0
