import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.maps.frame import GridFrame
from jaxplore.maps.window import Window

FRAME = GridFrame(0.1, (0.7, -0.4, 0.5))
SHAPE = (40, 52)
REACH = 0.83


@jax.jit
def around(position):
    """The corner of the window around a position, and where it and a grown one are in the map."""
    window = Window.around(position, REACH, FRAME, SHAPE)
    grown = window.grow(3)
    marks = [each.write(jnp.zeros(SHAPE), jnp.ones(each.shape)) for each in (window, grown)]
    return window.corner, grown.corner, marks, window.relative_to(grown).corner


@given(st.floats(-1.0, 7.0), st.floats(-2.0, 6.0))
def test_a_window_holds_the_cells_within_its_reach(x: float, y: float) -> None:
    corner, grown, (mark, more), inner = jax.device_get(around(jnp.asarray([x, y], jnp.float32)))
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    here = np.asarray(FRAME.to_grid(jnp.asarray([x, y], jnp.float32)), float)
    # The distance to the nearest point of each cell.
    down = np.maximum(np.maximum(rows - here[0], here[0] - rows - 1), 0.0)
    right = np.maximum(np.maximum(columns - here[1], here[1] - columns - 1), 0.0)
    is_near = np.hypot(down, right) * 0.1 <= REACH
    assert not (is_near & (mark == 0)).any()
    size = 2 * (9 + 1) + 1
    assert mark.sum() == size**2
    assert (corner >= 0).all()
    assert (corner <= np.array(SHAPE) - size).all()
    # The grown window has three more cells on each side, where the map has them.
    assert more.sum() == (size + 6) ** 2
    expected = np.zeros(SHAPE)
    row, column = np.clip(corner - 3, 0, np.array(SHAPE) - size - 6)
    expected[row : row + size + 6, column : column + size + 6] = 1.0
    np.testing.assert_array_equal(more, expected)
    np.testing.assert_array_equal(inner, corner - grown)


@given(st.integers(-60, 60), st.integers(-60, 60), st.integers(0, 2**32 - 1))
def test_reads_and_writes_are_those_of_numpy(row: int, column: int, seed: int) -> None:
    values = np.random.default_rng(seed).random((2, *SHAPE)).astype(np.float32)
    found, changed = jax.device_get(cut(jnp.asarray([row, column], jnp.int32), values))
    row, column = np.clip([row, column], 0, [SHAPE[0] - 7, 0])
    np.testing.assert_array_equal(found, values[:, row : row + 7, :])
    values[:, row : row + 7, :] *= 2.0
    np.testing.assert_array_equal(changed, values)


@jax.jit
def cut(corner, values):
    # Wider than the map: all columns are taken.
    window = Window.at(corner, (7, 90), SHAPE)
    part = window.read(values)
    return part, window.write(values, 2.0 * part)


def test_a_small_map_is_its_window() -> None:
    values = jnp.ones((5, 6))
    window = Window.around(jnp.asarray([jnp.nan, 0.0]), 1.0, FRAME, (5, 6))
    assert window.shape == (5, 6)
    assert window.read(values) is values
    np.testing.assert_array_equal(window.corner, 0)
