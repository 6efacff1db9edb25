import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from jaxplore.geometry.rays import ray_offsets, traverse

LENGTH = 12.0


def walk(row: float, column: float, angle: float, length: float) -> list[tuple[int, int, float]]:
    """Amanatides and Woo, one cell after the other, in double precision: (row, column, entry)."""
    position, direction = [row, column], [math.sin(angle), math.cos(angle)]
    cell = [math.floor(row), math.floor(column)]
    upcoming = []
    for axis in (0, 1):
        if direction[axis] > 0:
            upcoming.append((cell[axis] + 1 - position[axis]) / direction[axis])
        elif direction[axis] < 0:
            upcoming.append((cell[axis] - position[axis]) / direction[axis])
        else:
            upcoming.append(math.inf)
    cells, entry = [(cell[0], cell[1], 0.0)], 0.0
    while min(upcoming) < length:
        axis = int(upcoming[1] < upcoming[0])
        entry = upcoming[axis]
        cell[axis] += int(math.copysign(1, direction[axis]))
        upcoming[axis] += 1.0 / abs(direction[axis])
        cells.append((cell[0], cell[1], entry))
    return cells


traverse_jit = jax.jit(partial(traverse, length=LENGTH))


@given(
    st.floats(-30, 30, width=32),
    st.floats(-30, 30, width=32),
    st.floats(-7, 7, width=32),
)
def test_traverse_crosses_the_cells_of_a_walk(row: float, column: float, angle: float) -> None:
    # Along a grid line the two sides are equally right.
    assume(min(abs(math.sin(angle)), abs(math.cos(angle))) > 1e-5)
    cells = traverse_jit(jnp.asarray([row, column], jnp.float32), jnp.float32(angle))
    entry, exit_, is_crossed = (np.asarray(a) for a in (cells.entry, cells.exit, cells.is_crossed))
    found = {tuple(cell): e for cell, e in zip(np.asarray(cells.cell), entry, strict=True)}
    # Single precision may see or miss a cell that is only grazed near a corner.
    walked = walk(row, column, angle, LENGTH)
    for (r, c, begin), after in zip(walked, [*walked[1:], (0, 0, LENGTH)], strict=True):
        if after[2] - begin > 1e-3:
            assert found[r, c] == pytest.approx(begin, abs=2e-4)
    known = {(r, c) for r, c, _ in walked}
    for cell, e, x, crossed in zip(np.asarray(cells.cell), entry, exit_, is_crossed, strict=True):
        if e < LENGTH - 1e-3 and x - e > 1e-3:
            assert crossed
            assert tuple(cell) in known


@given(
    st.floats(0, 1, width=32, exclude_max=True),
    st.floats(0, 1, width=32, exclude_max=True),
    st.floats(-7, 7, width=32),
)
@example(row=0.5, column=0.5, angle=math.pi / 4)
@example(row=0.5, column=0.5, angle=-math.pi / 4)
@example(row=0.0, column=0.0, angle=3 * math.pi / 4)
@example(row=0.0, column=0.5, angle=math.pi)
def test_traverse_leaves_no_gap(row: float, column: float, angle: float) -> None:
    cells = traverse_jit(jnp.asarray([row, column], jnp.float32), jnp.float32(angle))
    entry, exit_ = np.asarray(cells.entry), np.asarray(cells.exit)
    assert entry[0] == 0.0
    np.testing.assert_array_equal(exit_[:-1], entry[1:])
    assert (np.diff(entry) >= 0).all()
    assert exit_[-1] >= LENGTH
    step = np.abs(np.diff(np.asarray(cells.cell), axis=0)).sum(axis=1)
    np.testing.assert_array_equal(step, 1)


@pytest.mark.parametrize("angle", [0.0, math.pi / 2, math.pi, -math.pi / 2])
def test_traverse_along_an_axis_stays_in_its_line(angle: float) -> None:
    cells = traverse_jit(jnp.asarray([2.5, 3.5]), jnp.float32(angle))
    crossed = np.asarray(cells.cell)[(np.asarray(cells.entry) < 5.4) & cells.is_crossed]
    step = np.round([math.sin(angle), math.cos(angle)]).astype(int)
    expected = [(2 + k * step[0], 3 + k * step[1]) for k in range(6)]
    assert sorted(map(tuple, crossed)) == sorted(expected)


def test_traverse_through_a_corner_goes_on_diagonally() -> None:
    cells = traverse_jit(jnp.asarray([0.5, 0.5]), jnp.float32(math.pi / 4))
    near = np.asarray(cells.is_crossed) & (np.asarray(cells.entry) < 2.5)
    crossed = [tuple(c) for c in np.asarray(cells.cell)[near]]
    assert crossed == [(0, 0), (1, 1), (2, 2)]


@pytest.mark.parametrize("num_directions", [8, 12, 32, 7])
def test_ray_offsets_are_a_walk_from_the_centre(num_directions: int) -> None:
    angles = (np.arange(num_directions) + 0.5) * 2 * np.pi / num_directions
    rays = ray_offsets(angles, LENGTH)
    for angle, offset, exit_ in zip(angles, rays.offset, rays.exit, strict=True):
        walked = walk(0.5, 0.5, angle, 3 * LENGTH)
        leaves = [cell[2] for cell in walked[1:]]
        expected = [
            (r, c)
            for (r, c, e), x in zip(walked, leaves, strict=False)
            if x <= LENGTH and x - e > 1e-9
        ]
        filled = np.isfinite(exit_)
        assert list(map(tuple, offset[filled])) == expected
        assert (np.diff(exit_[filled]) > 0).all()


def test_ray_offsets_of_a_length_below_half_a_cell_are_padding() -> None:
    rays = ray_offsets(np.array([0.3, 2.0]), 0.2)
    assert not np.isfinite(rays.exit).any()
