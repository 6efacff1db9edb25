import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

from jaxplore import OccupancyGrid

RNG = np.random.default_rng(0)
VALUES = RNG.random((7, 11)).astype(np.float32)
GRID = OccupancyGrid(VALUES, 0.25, (1.0, -2.0, 0.6))


def to_grid(x: float, y: float) -> tuple[float, float]:
    """Rotate and divide, in double precision: (row, column)."""
    dx, dy = x - 1.0, y + 2.0
    c, s = math.cos(-0.6), math.sin(-0.6)
    return (s * dx + c * dy) / 0.25, (c * dx - s * dy) / 0.25


@given(st.floats(-4, 6, width=32), st.floats(-6, 4, width=32))
def test_look_up_in_a_rotated_map(x: float, y: float) -> None:
    row, column = to_grid(x, y)
    if min(abs(row - round(row)), abs(column - round(column))) < 1e-3:
        return
    inside = 0 <= row < 7 and 0 <= column < 11
    expected = VALUES[math.floor(row), math.floor(column)] if inside else 1.0
    assert float(GRID.at(jnp.asarray([x, y], jnp.float32))) == pytest.approx(float(expected))


@given(st.floats(-4, 6, width=32), st.floats(-6, 4, width=32))
def test_interpolation_equals_scipy(x: float, y: float) -> None:
    row, column = to_grid(x, y)
    if min(abs(row), abs(row - 7), abs(column), abs(column - 11)) < 1e-3:
        return
    expected = 1.0
    if 0 <= row < 7 and 0 <= column < 11:
        at = [[row - 0.5], [column - 0.5]]
        expected = map_coordinates(VALUES.astype(float), at, order=1, mode="nearest")[0]
    assert float(GRID.interpolate(jnp.asarray([x, y], jnp.float32))) == pytest.approx(
        float(expected), abs=1e-4
    )


@given(st.integers(-50, 50), st.integers(-50, 50))
def test_world_and_cell_are_inverse(row: int, column: int) -> None:
    cell = jnp.asarray([row, column])
    assert np.array_equal(GRID.frame.to_cell(GRID.frame.cell_centre(cell)), cell)


@given(st.floats(-4, 6, width=32), st.floats(-6, 4, width=32))
def test_distances_are_those_to_the_cell_centres(x: float, y: float) -> None:
    row, column = to_grid(x, y)
    rows, columns = np.mgrid[:7, :11] + 0.5
    expected = 0.25 * np.hypot(rows - row, columns - column)
    found = GRID.frame.distances(jnp.asarray([x, y], jnp.float32), (7, 11))
    np.testing.assert_allclose(found, expected, atol=1e-5, rtol=1e-5)


def test_interpolation_is_exact_at_cell_centres() -> None:
    cells = jnp.stack(jnp.mgrid[:7, :11], axis=-1).reshape(-1, 2)
    found = jax.vmap(GRID.interpolate)(GRID.frame.cell_centre(cells))
    np.testing.assert_allclose(found, VALUES.reshape(-1), atol=1e-5)


def test_cells_are_found_with_floor_not_truncation() -> None:
    grid = OccupancyGrid(np.zeros((2, 2)), 1.0)
    assert np.array_equal(grid.frame.to_cell(jnp.asarray([-0.5, 0.5])), [0, -1])
    assert float(grid.at(jnp.asarray([-0.5, 0.5]))) == 1.0


def test_a_point_that_is_not_finite_is_off_the_map() -> None:
    assert float(GRID.interpolate(jnp.asarray([jnp.nan, 0.0]))) == 1.0
    assert float(GRID.interpolate(jnp.asarray([jnp.inf, 0.0]))) == 1.0
    for point in ([jnp.nan, 0.0], [0.0, jnp.nan], [jnp.inf, -jnp.inf]):
        assert float(GRID.at(jnp.asarray(point))) == 1.0


def test_gradients_are_finite_everywhere() -> None:
    points = jnp.asarray([[1.1, -1.9], [50.0, 50.0], [1.0, -2.0]])
    assert np.isfinite(jax.vmap(jax.grad(GRID.interpolate))(points)).all()


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1)])
def test_maps_one_cell_wide(shape: tuple[int, int]) -> None:
    grid = OccupancyGrid(np.full(shape, 0.3), 1.0)
    assert float(grid.interpolate(jnp.asarray([0.9, 0.9]))) == pytest.approx(0.3)
    assert float(grid.interpolate(jnp.asarray([6.0, 6.0]))) == 1.0


def test_a_prior_takes_the_place_of_not_knowing_and_of_nothing_else() -> None:
    grid = OccupancyGrid(np.array([[0.5, 0.4999, 0.49, 0.0, 1.0, 0.6]], np.float32), 0.1)
    expected = [[0.2, 0.2, 0.49, 0.0, 1.0, 0.6]]
    np.testing.assert_allclose(grid.with_prior(jnp.float32(0.2)).probability, expected, rtol=1e-6)
    np.testing.assert_array_equal(grid.probability[0, 0], 0.5)


def test_entropy_in_nats() -> None:
    p = np.array([[0.0, 0.5, 1.0, 0.1]])
    expected = [0.0, math.log(2), 0.0, -0.1 * math.log(0.1) - 0.9 * math.log(0.9)]
    np.testing.assert_allclose(OccupancyGrid(p, 1.0).entropy[0], expected, rtol=1e-6)


def test_ros_round_trip(tmp_path) -> None:
    values = np.where(VALUES > 0.7, 1.0, np.where(VALUES < 0.4, 0.0, 0.5)).astype(np.float32)
    OccupancyGrid(values, 0.25, (1.0, -2.0, 0.5)).to_ros(tmp_path / "map.yaml")
    back = OccupancyGrid.from_ros(tmp_path / "map.yaml")
    np.testing.assert_array_equal(back.probability, values)
    np.testing.assert_allclose(back.frame.origin, [1.0, -2.0, 0.5])
    assert back.resolution == 0.25


def test_resample_keeps_the_corner() -> None:
    coarse = GRID.resample(0.5)
    assert coarse.shape == (4, 6)
    np.testing.assert_array_equal(coarse.frame.origin, GRID.frame.origin)


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        ((np.zeros((0, 3)), 1.0), "probability"),
        ((np.zeros(3), 1.0), "probability"),
        ((np.zeros((2, 2)), 1.0, (0.0, 0.0)), "origin"),
    ],
)
def test_bad_input_is_named(arguments, culprit: str) -> None:
    with pytest.raises(ValueError, match=culprit) as error:
        OccupancyGrid(*arguments)
    assert "accepted" in str(error.value)


def test_a_grid_keeps_its_values_when_the_array_it_was_made_of_changes() -> None:
    # JAX shares memory that is aligned, which is luck otherwise.
    memory = np.zeros(64 + 4 * 32 * 32, np.uint8)
    first = -memory.ctypes.data % 64
    values = memory[first:][: 4 * 32 * 32].view(np.float32).reshape(32, 32)
    grid = OccupancyGrid(values, 0.1)
    values[:] = 1.0
    np.testing.assert_array_equal(grid.probability, 0.0)
