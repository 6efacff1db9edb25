"""Look-ups on a lattice: its nodes, in between, and where it ends."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.maps.field import ScalarField, bilinear, gather, stencil
from jaxplore.maps.frame import GridFrame

SHAPE = ROWS, COLUMNS = 4, 6
VALUES = np.random.default_rng(0).uniform(1.0, 9.0, SHAPE).astype(np.float32)
MARGINS = pytest.mark.parametrize("margin", [0.0, 0.5, 2.0])


@functools.partial(jax.jit, static_argnames="margin")
def look_up(grid: jax.Array, margin: float) -> jax.Array:
    """Return the interpolated value, -1 off the lattice."""
    return gather(jnp.asarray(VALUES), stencil(SHAPE, grid, margin), -1.0)


@functools.partial(jax.jit, static_argnames="margin")
def slope(grid: jax.Array, margin: float) -> jax.Array:
    return jax.grad(functools.partial(look_up, margin=margin))(grid)


def read(row: float, column: float, margin: float) -> float:
    """Return the value at a place given in nodes."""
    where = jnp.asarray([row + 0.5, column + 0.5], jnp.float32)
    return float(look_up(where, margin=margin))


@MARGINS
def test_it_is_exact_at_nodes(margin: float) -> None:
    for row in range(ROWS):
        for column in range(COLUMNS):
            assert read(row, column, margin) == VALUES[row, column]


@given(st.floats(0, ROWS - 1), st.floats(0, COLUMNS - 1), st.sampled_from([0.0, 0.5]))
def test_it_is_bilinear_in_between(row: float, column: float, margin: float) -> None:
    by_row = [np.interp(column, np.arange(COLUMNS), line) for line in VALUES]
    expected = np.interp(row, np.arange(ROWS), by_row)
    assert read(row, column, margin) == pytest.approx(expected, rel=1e-4)


@MARGINS
def test_the_edge_value_holds_up_to_the_margin(margin: float) -> None:
    inside, outside = margin - 0.01, margin + 0.01
    for column in (0, 3, 5):
        if margin > 0:
            assert read(-inside, column, margin) == VALUES[0, column]
            assert read(ROWS - 1 + inside, column, margin) == VALUES[-1, column]
        assert read(-outside, column, margin) == -1.0
        assert read(ROWS - 1 + outside, column, margin) == -1.0
    for row in (0, 2, 3):
        if margin > 0:
            assert read(row, -inside, margin) == VALUES[row, 0]
            assert read(row, COLUMNS - 1 + inside, margin) == VALUES[row, -1]
        assert read(row, -outside, margin) == -1.0
        assert read(row, COLUMNS - 1 + outside, margin) == -1.0


def test_an_outermost_node_is_on_the_lattice_however_it_was_rounded() -> None:
    frame = GridFrame(0.1, (30.0, -20.0, 0.7))
    corners = jnp.asarray([(0, 0), (0, 5), (3, 0), (3, 5)])
    grid = frame.to_grid(frame.cell_centre(corners))
    assert jax.vmap(lambda where: stencil(SHAPE, where, 0.0).is_inside)(grid).all()


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e30, -1e30])
@MARGINS
def test_what_is_not_a_place_is_outside(bad: float, margin: float) -> None:
    assert read(bad, 2.0, margin) == -1.0
    assert read(2.0, bad, margin) == -1.0
    assert np.isfinite(slope(jnp.asarray([bad, 2.0], jnp.float32), margin=margin)).all()


@given(
    st.integers(1, 5),
    st.integers(1, 5),
    st.floats(-3, 9, width=32),
    st.floats(-3, 9, width=32),
    st.sampled_from([0.0, 0.5]),
)
def test_weights_are_shares_of_nodes_of_the_lattice(
    rows: int, columns: int, row: float, column: float, margin: float
) -> None:
    around = stencil((rows, columns), jnp.asarray([row, column], jnp.float32), margin)
    nodes, weight = np.asarray(around.nodes), np.asarray(around.weight)
    assert nodes.min() >= 0
    assert nodes.max() < rows * columns
    assert weight.sum() == pytest.approx(1.0, abs=1e-6)
    assert weight.min() >= 0.0
    reach = margin - 0.5
    at_edge = min(
        abs(row + reach),
        abs(rows - row + reach),
        abs(column + reach),
        abs(columns - column + reach),
    )
    if at_edge > 1e-3:
        is_inside = -reach < row < rows + reach and -reach < column < columns + reach
        assert bool(around.is_inside) == is_inside


def test_a_lattice_of_one_row_or_one_node() -> None:
    line = jnp.asarray([[1.0, 3.0, 5.0]])
    assert float(bilinear(line, jnp.asarray([0.5, 1.25]), -1.0)) == pytest.approx(2.5)
    assert float(bilinear(line, jnp.asarray([0.9, 1.5]), -1.0)) == 3.0
    assert float(bilinear(line.T, jnp.asarray([1.25, 0.1]), -1.0)) == pytest.approx(2.5)
    assert float(bilinear(line[:, :1], jnp.asarray([0.2, 0.9]), -1.0)) == 1.0
    assert float(bilinear(line[:, :1], jnp.asarray([0.2, 1.1]), -1.0)) == -1.0


def test_a_channel_is_its_own_field() -> None:
    channels = jnp.stack([jnp.asarray(VALUES), 10.0 + jnp.asarray(VALUES), -jnp.asarray(VALUES)])
    around = stencil(SHAPE, jnp.asarray([2.2, 3.9]))
    single = [float(gather(values, around, 0.0)) for values in channels]
    together = [float(gather(channels, around, 0.0, jnp.int32(index))) for index in range(3)]
    assert single == together
    assert together[1] == pytest.approx(together[0] + 10.0, rel=1e-5)
    assert together[2] == pytest.approx(-together[0])


def test_a_scalar_field_is_read_in_the_world() -> None:
    frame = GridFrame(0.5, (2.0, -1.0, 0.7))
    field = ScalarField(jnp.asarray(VALUES), frame, jnp.float32(-1.0))
    assert field.margin == 0.5
    read_world = jax.jit(lambda field, where: field(frame.to_world(where)))
    for margin, at_edge in ((0.5, VALUES[0, 0]), (0.0, -1.0)):
        field = ScalarField(jnp.asarray(VALUES), frame, jnp.float32(-1.0), margin)
        assert float(read_world(field, jnp.asarray([1.5, 3.5]))) == pytest.approx(
            VALUES[1, 3], rel=1e-4
        )
        mean = VALUES[1:3, 3:5].mean()
        assert float(read_world(field, jnp.asarray([2.0, 4.0]))) == pytest.approx(mean, rel=1e-4)
        assert float(read_world(field, jnp.asarray([0.1, 0.1]))) == pytest.approx(at_edge)
        assert float(read_world(field, jnp.asarray([-0.1, 0.1]))) == -1.0


def test_the_slope_of_a_scalar_field() -> None:
    """In the world: rows lie along y, columns along x of the lattice."""
    frame = GridFrame(0.5, (2.0, -1.0, 0.7))
    row, column = np.meshgrid(np.arange(ROWS), np.arange(COLUMNS), indexing="ij")
    plane = ScalarField(
        jnp.asarray(3.0 * row + 2.0 * column, jnp.float32), frame, jnp.zeros(()), 0.0
    )
    plane_slope = jax.jit(jax.grad(plane))
    cos, sin = math.cos(0.7), math.sin(0.7)
    expected = np.array([cos * 2 - sin * 3, sin * 2 + cos * 3]) / 0.5
    np.testing.assert_allclose(
        plane_slope(frame.to_world(jnp.asarray([1.8, 2.9]))), expected, rtol=1e-3
    )
    for where in ([0.4, 2.0], [-9.0, 2.0], [math.nan, 2.0]):
        np.testing.assert_array_equal(plane_slope(frame.to_world(jnp.asarray(where))), 0.0)
