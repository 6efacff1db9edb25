"""Exact traversal of grid cells by rays: no sampling step, no cell left out.

A ray leaves every cell through a column line or through a row line of the grid. The crossings with
either family of lines are equally spaced along the ray, so the n-th crossing of both together, and
with it the n-th cell, follows in closed form: all cells of all rays in parallel, nearest first. The
cells are those of Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing",
Eurographics 1987, which finds them one after the other.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxplore._types import Scalar

TOUCH = 1e-4
"""A cell that a ray crosses over less than this length [cells] is touched at a corner, no more."""
FAR = 1e9
"""Stands for "never" where infinity would spoil the arithmetic [cells]."""


class RayCells(NamedTuple):
    """The cells that a ray crosses, nearest first.

    `cell` (N, 2) is (row, column); the ray is in it from `entry` to `exit` (N,), distances from the
    start [cells], and `exit[n] == entry[n + 1]`. Where the ray only touches a cell, at a corner,
    `is_crossed` (N,) is False.
    """

    cell: Int[Array, "N 2"]
    entry: Float[Array, " N"]
    exit: Float[Array, " N"]
    is_crossed: Bool[Array, " N"]


def traverse(start: Float[Array, "2"], angle: Scalar, length: float) -> RayCells:
    """Return the cells that a ray crosses, its first cell included.

    Args:
        start: grid coordinates (row, column) [cells].
        angle: direction in the grid's frame, from the column axis towards the row axis [rad].
        length: static; at least the cells entered within this length are returned [cells]. Some
            farther ones follow, whose entries say so.
    """
    direction = jnp.stack([jnp.sin(angle), jnp.cos(angle)])
    base = jnp.floor(start)
    # Within the first cell: distances stay exact however far the map's corner is.
    fraction = start - base
    moves = jnp.abs(direction) > 1e-9
    spacing = jnp.where(moves, 1.0 / jnp.where(moves, jnp.abs(direction), 1.0), FAR)
    to_first = jnp.where(moves, jnp.where(direction > 0, 1.0 - fraction, fraction), 1.0)

    def crossing(axis: int, count: Array) -> Array:
        """Distance at which the count-th line of a family is crossed, count >= 1."""
        return (to_first[axis] + (count - 1.0)) * spacing[axis]

    # Of the first n crossings, r are with row lines and n - r with column lines, if the r-th of the
    # one comes before the (n - r + 1)-th of the other, and so the other way round.
    number = jnp.arange(max_cells(length), dtype=jnp.float32)
    ahead = crossing(1, number + 1.0) - crossing(0, jnp.zeros(()))
    rows = jnp.clip(jnp.floor(ahead / (spacing[0] + spacing[1])), 0.0, number)
    # The estimate is off by one at most; comparing the very distances settles it, so that every
    # cell is left where the next one is entered.
    too_many = (rows > 0) & (crossing(0, rows) > crossing(1, number - rows + 1.0))
    too_few = (rows < number) & (crossing(1, number - rows) > crossing(0, rows + 1.0))
    rows = rows - too_many.astype(jnp.float32) + too_few.astype(jnp.float32)
    # Everything else follows from it: materialised, it is computed once, not once for each.
    rows = jax.lax.optimization_barrier(rows)  # type: ignore[no-untyped-call]
    columns = number - rows
    last_row = jnp.where(rows > 0, crossing(0, rows), 0.0)
    last_column = jnp.where(columns > 0, crossing(1, columns), 0.0)
    entry = jnp.maximum(last_row, last_column)
    exit_ = jnp.minimum(crossing(0, rows + 1.0), crossing(1, columns + 1.0))
    step = jnp.stack([rows, columns], axis=-1) * jnp.sign(direction)
    return RayCells((base + step).astype(jnp.int32), entry, exit_, exit_ - entry > TOUCH)


def max_cells(length: float) -> int:
    """Return how many cells a ray of this length [cells] can enter, wherever it starts."""
    return math.ceil(math.sqrt(2.0) * length) + 3


class RayOffsets(NamedTuple):
    """The cells that rays from a cell's centre cross, nearest first, as offsets from that cell.

    `offset` (D, N, 2) is (row, column), `entry` and `exit` (D, N) the distances at which each cell
    is entered and left [cells]. Short rays are padded with the offset 0 and infinite distances.
    """

    offset: np.ndarray
    entry: np.ndarray
    exit: np.ndarray

    @property
    def is_crossed(self) -> np.ndarray:
        """Where the table holds a cell (D, N), not padding."""
        return np.isfinite(self.exit)


def ray_offsets(angles: np.ndarray, length: float) -> RayOffsets:
    """Return the cells left within `length` [cells] by rays from a cell's centre.

    A table in double precision, made once per sensor and resolution: every cell's ray in one
    direction crosses the same offsets, which is what lets a whole map be scanned by shifts.

    Args:
        angles: (D,) directions from the column axis towards the row axis [rad].
        length: how far a ray reaches [cells].
    """
    lines = np.arange(math.ceil(length) + 2) + 0.5
    rays = []
    for angle in angles:
        direction = np.array([math.sin(angle), math.cos(angle)])
        distance = np.concatenate([lines / max(abs(part), 1.0 / FAR) for part in direction])
        order = np.argsort(distance, kind="stable")
        is_row = order < len(lines)
        rows, columns = np.cumsum(is_row), np.cumsum(~is_row)
        exit_ = distance[order]
        entry = np.concatenate([[0.0], exit_[:-1]])
        cell = np.stack([rows - is_row, columns - ~is_row], axis=-1) * np.sign(direction)
        is_kept = (exit_ <= length) & (exit_ - entry > TOUCH)
        rays.append((cell[is_kept].astype(np.int32), entry[is_kept], exit_[is_kept]))
    longest = max(1, max(len(cell) for cell, _, _ in rays))
    offset = np.zeros((len(rays), longest, 2), np.int32)
    entry, exit_ = (np.full((len(rays), longest), np.inf) for _ in range(2))
    for index, (cell, enters, leaves) in enumerate(rays):
        offset[index, : len(cell)] = cell
        entry[index, : len(cell)], exit_[index, : len(cell)] = enters, leaves
    return RayOffsets(offset, entry, exit_)
