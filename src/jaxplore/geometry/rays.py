"""Traverse grid cells along rays exactly: no step size, and no cell is missed.

A ray leaves every cell through a column line or a row line of the grid. The crossings with each
family of lines are equally spaced along the ray, so the n-th crossing of both families together,
and with it the n-th cell, has a closed form. All cells of all rays are computed in parallel,
nearest first. The cells are those of Amanatides and Woo, "A fast voxel traversal algorithm for ray
tracing", Eurographics 1987, which finds them one after another.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxplore._types import Scalar

TOUCH = 1e-4
"""A ray that is in a cell over less than this length only touches its corner [cells]."""
FAR = 1e9
"""Finite stand-in for an infinite distance: products of infinity and zero are NaN [cells]."""


class RayCells(NamedTuple):
    """Cells that a ray crosses, nearest first.

    `cell` (N, 2) is (row, column). The ray is in the cell from `entry` to `exit` (N,), distances
    from its start [cells], and `exit[n] == entry[n + 1]`. `is_crossed` (N,) is False if the ray
    only touches a corner of the cell.
    """

    cell: Int[Array, "N 2"]
    entry: Float[Array, " N"]
    exit: Float[Array, " N"]
    is_crossed: Bool[Array, " N"]


def traverse(start: Float[Array, "2"], angle: Scalar, length: float) -> RayCells:
    """Return the cells that a ray crosses, starting with that of its start (row, column), at an
    angle from the column axis towards the row axis. All cells entered within `length` [cells]
    (static) are returned. Some farther ones may follow; their `entry` is greater than the
    length."""
    direction = jnp.stack([jnp.sin(angle), jnp.cos(angle)])
    base = jnp.floor(start)
    # Work relative to the first cell, so that distances stay exact far from the map's corner.
    fraction = start - base
    # A ray along an axis crosses no line of one family: its first line is then at the distance FAR.
    moves = jnp.abs(direction) > 1e-9
    spacing = jnp.where(moves, 1.0 / jnp.where(moves, jnp.abs(direction), 1.0), FAR)
    to_first = jnp.where(moves, jnp.where(direction > 0, 1.0 - fraction, fraction), 1.0)

    def crossing(axis: int, count: Array) -> Array:
        """Return the distance at which the count-th line of a family is crossed, count >= 1."""
        return (to_first[axis] + (count - 1.0)) * spacing[axis]

    # Of the first n crossings, r are with row lines and n - r with column lines if the r-th row
    # line comes before the (n - r + 1)-th column line and the (n - r)-th column line before the
    # (r + 1)-th row line.
    number = jnp.arange(max_cells(length), dtype=jnp.float32)
    ahead = crossing(1, number + 1.0) - crossing(0, jnp.zeros(()))
    rows = jnp.clip(jnp.floor(ahead / (spacing[0] + spacing[1])), 0.0, number)
    # Rounding can put the estimate off by one. Correct it by comparing the distances themselves, so
    # that every cell is left exactly where the next one is entered.
    too_many = (rows > 0) & (crossing(0, rows) > crossing(1, number - rows + 1.0))
    too_few = (rows < number) & (crossing(1, number - rows) > crossing(0, rows + 1.0))
    rows = rows - too_many.astype(jnp.float32) + too_few.astype(jnp.float32)
    # All outputs depend on `rows`. The barrier makes XLA compute it once, not once per output.
    rows = jax.lax.optimization_barrier(rows)  # type: ignore[no-untyped-call]
    columns = number - rows
    last_row = jnp.where(rows > 0, crossing(0, rows), 0.0)
    last_column = jnp.where(columns > 0, crossing(1, columns), 0.0)
    entry = jnp.maximum(last_row, last_column)
    exit_ = jnp.minimum(crossing(0, rows + 1.0), crossing(1, columns + 1.0))
    step = jnp.stack([rows, columns], axis=-1) * jnp.sign(direction)
    return RayCells((base + step).astype(jnp.int32), entry, exit_, exit_ - entry > TOUCH)


def max_cells(length: float) -> int:
    """Return the greatest number of cells that a ray of a length [cells] can enter."""
    # At most sqrt(2) length + 2 lines are crossed, one cell for each, after the cell of the start.
    return math.ceil(math.sqrt(2.0) * length) + 3


class RayOffsets(NamedTuple):
    """Cells crossed by rays from a cell's centre, nearest first, as offsets (D, N, n) along the n
    axes of the grid, with the distances (D, N) at which each is entered and left [cells]. Short
    rays are padded with offset 0 and infinite distances."""

    offset: np.ndarray
    entry: np.ndarray
    exit: np.ndarray

    @property
    def is_crossed(self) -> np.ndarray:
        """Mask (D, N) of the entries that hold a cell, not padding."""
        return np.isfinite(self.exit)


def ray_offsets(angles: np.ndarray, length: float) -> RayOffsets:
    """Tabulate the cells that rays from a cell's centre leave within a length [cells].

    The angles (D,) are from the column axis towards the row axis [rad].
    """
    return direction_offsets(np.stack([np.sin(angles), np.cos(angles)]), length)


def direction_offsets(directions: np.ndarray, length: float) -> RayOffsets:
    """Tabulate the cells that rays from a cell's centre leave within a length [cells], in unit
    directions (n, D). They are the same from every cell, so a whole map can be processed by
    shifting it. Computed in double precision, once per sensor and resolution."""
    # From a cell's centre, the k-th line of a family is k + 1/2 cells away along its axis.
    lines = np.arange(math.ceil(length) + 2) + 0.5
    dimensions = len(directions)
    rays = []
    for direction in np.asarray(directions, np.float64).T:
        # The bound avoids a division by 0: a ray along an axis meets no line of another family.
        distance = np.concatenate([lines / max(abs(part), 1.0 / FAR) for part in direction])
        order = np.argsort(distance, kind="stable")
        is_axis = order[:, None] // len(lines) == np.arange(dimensions)
        counts = np.cumsum(is_axis, axis=0)
        exit_ = distance[order]
        entry = np.concatenate([[0.0], exit_[:-1]])
        cell = (counts - is_axis) * np.sign(direction)
        is_kept = (exit_ <= length) & (exit_ - entry > TOUCH)
        rays.append((cell[is_kept].astype(np.int32), entry[is_kept], exit_[is_kept]))
    longest = max(1, max(len(cell) for cell, _, _ in rays))
    offset = np.zeros((len(rays), longest, dimensions), np.int32)
    entry, exit_ = (np.full((len(rays), longest), np.inf) for _ in range(2))
    for index, (cell, enters, leaves) in enumerate(rays):
        offset[index, : len(cell)] = cell
        entry[index, : len(cell)], exit_[index, : len(cell)] = enters, leaves
    return RayOffsets(offset, entry, exit_)


class VoxelStep(NamedTuple):
    """The voxel that each of R rays is in, along the axes of the grid, and the distances at which
    it is entered and left [voxels]. It is not crossed if the ray only touches an edge or a corner
    of it, and where the ray has ended."""

    voxel: Int[Array, "3 R"]
    entry: Float[Array, " R"]
    exit: Float[Array, " R"]
    is_crossed: Bool[Array, " R"]


def walk[Carry](
    start: Float[Array, "3 R"],
    direction: Float[Array, "3 R"],
    length: Float[Array, " R"],
    visit: Callable[[Carry, VoxelStep], tuple[Carry, Bool[Array, " R"]]],
    carry: Carry,
) -> Carry:
    """Visit the voxels of R rays one after another, all rays in step; return what is carried.

    Starts are in grid coordinates [voxels], and directions are unit vectors along the axes of the
    grid. A ray without a finite direction is not walked. Voxels that are entered within `length`
    [voxels] are visited.

    `visit` takes what was carried so far and the voxels. It returns what is carried on, and which
    rays go on. It is also called for rays that have ended, with `is_crossed` False.

    A ray leaves every voxel through a plane of one of three families. The n-th crossing with the
    planes of one family has a closed form, so distances do not add up rounding from voxel to voxel.
    """
    is_finite = jnp.all(jnp.isfinite(start) & jnp.isfinite(direction), axis=0)
    # Converting NaN to an integer is undefined.
    base = jnp.floor(jnp.where(is_finite, start, 0.0))
    # Work relative to the first voxel, so that distances stay exact far from the grid's corner.
    fraction = start - base
    moves = jnp.abs(direction) > 1e-9
    spacing = jnp.where(moves, 1.0 / jnp.where(moves, jnp.abs(direction), 1.0), FAR)
    to_first = jnp.where(direction > 0, 1.0 - fraction, fraction)
    sign = jnp.where(moves, jnp.sign(direction), 0.0).astype(jnp.int32)
    first, axes = base.astype(jnp.int32), jnp.arange(3)[:, None]
    goes_on = is_finite & (length >= 0.0)

    def step(
        state: tuple[Array, Array, Array, Carry],
    ) -> tuple[Array, Array, Array, Carry]:
        count, entry, goes_on, carried = state
        planes = jnp.where(moves, (to_first + count.astype(start.dtype)) * spacing, FAR)
        through = jnp.argmin(planes, axis=0)
        exit_ = jnp.min(planes, axis=0)
        here = VoxelStep(first + sign * count, entry, exit_, goes_on & (exit_ - entry > TOUCH))
        carried, wanted = visit(carried, here)
        count = count + (axes == through).astype(jnp.int32)
        return count, exit_, goes_on & wanted & (exit_ <= length), carried

    state = (jnp.zeros(direction.shape, jnp.int32), jnp.zeros_like(length), goes_on, carry)
    *_, carried = jax.lax.while_loop(lambda each: jnp.any(each[2]), step, state)
    return carried
