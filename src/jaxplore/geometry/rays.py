"""Exact traversal of grid cells by rays: no sampling step, no cell left out.

A ray enters every cell but its first through a column line or through a row line of the grid. The
crossings with either family of lines are equally spaced along the ray, so all cells follow in
closed form and in parallel. They come as two families, not sorted by distance: what is asked of a
ray (the first hit, the cells passed before a reading) is a minimum or a mask, which needs no order.
The set of cells is that of Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing",
Eurographics 1987, which finds it one cell after the other.
"""

import math
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from jaxplore._types import Scalar


class RayCells(NamedTuple):
    """The cells that a ray crosses, in no order.

    `cell` (N, 2) is (row, column), `entry` and `exit` (N,) are distances from the start [cells].
    Padding has an infinite entry.
    """

    cell: Int[Array, "N 2"]
    entry: Float[Array, " N"]
    exit: Float[Array, " N"]


def traverse(start: Float[Array, "2"], angle: Scalar, num_crossings: int) -> RayCells:
    """Return the cells that a ray crosses, its first cell included.

    A ray that passes exactly through a corner goes on in the diagonal cell: cells that it only
    touches are left out.

    Args:
        start: grid coordinates (row, column) [cells].
        angle: direction in the grid's frame, from the column axis towards the row axis [rad].
        num_crossings: crossings kept with each family of lines; `ceil(length) + 1` covers a length
            [cells]. N is `2 * num_crossings + 1`.
    """
    direction = jnp.stack([jnp.sin(angle), jnp.cos(angle)])
    base = jnp.floor(start)
    # Within the first cell: distances stay exact however far the map's corner is.
    fraction = start - base
    moves = jnp.abs(direction) > 1e-9
    sign = jnp.sign(direction)
    spacing = 1.0 / jnp.where(moves, jnp.abs(direction), 1.0)
    to_first = jnp.where(direction > 0, 1.0 - fraction, fraction)
    count = jnp.arange(1, num_crossings + 1, dtype=jnp.float32)

    def distance(axis: int, crossing: Array) -> Array:
        """Distance at which the n-th line of a family is crossed, n >= 1."""
        along = (to_first[axis] + (crossing - 1.0)) * spacing[axis]
        return jnp.where(moves[axis], along, jnp.inf)

    def crossings(axis: int) -> RayCells:
        other = 1 - axis
        entry = distance(axis, count)
        # How many lines of the other family come before: estimated, then settled by comparing
        # the very distances that the other family has. Rounding cannot make the two disagree
        # about their order, so every cell is left where the next one is entered.
        estimate = jnp.maximum(jnp.floor(entry / spacing[other] - to_first[other]) + 1.0, 0.0)
        is_before = jnp.less_equal if axis == 1 else jnp.less
        more = is_before(distance(other, estimate + 1.0), entry)
        less = (estimate >= 1.0) & ~is_before(distance(other, estimate), entry)
        crossed = estimate + more.astype(jnp.float32) - less.astype(jnp.float32)
        crossed = jnp.where(moves[other] & moves[axis], crossed, 0.0)
        exit_ = jnp.minimum(distance(axis, count + 1.0), distance(other, crossed + 1.0))
        along, across = sign[axis] * count, sign[other] * crossed
        cell = jnp.stack([along, across] if axis == 0 else [across, along], axis=-1)
        is_crossed = moves[axis] & (exit_ > entry)
        return RayCells(
            (cell + base).astype(jnp.int32), jnp.where(is_crossed, entry, jnp.inf), exit_
        )

    rows, columns = crossings(0), crossings(1)
    one = jnp.ones(())
    first_exit = jnp.minimum(distance(0, one), distance(1, one))
    first_entry = jnp.where(first_exit > 0.0, 0.0, jnp.inf)
    return RayCells(
        jnp.concatenate([base.astype(jnp.int32)[None], rows.cell, columns.cell]),
        jnp.concatenate([first_entry[None], rows.entry, columns.entry]),
        jnp.concatenate([first_exit[None], rows.exit, columns.exit]),
    )


class RayOffsets(NamedTuple):
    """The cells that rays from a cell's centre cross, nearest first, as offsets from that cell.

    `offset` (D, N, 2) is (row, column) and `exit` (D, N) the distance at which each cell is left
    [cells]. Short rays are padded with the offset 0 and an infinite exit.
    """

    offset: np.ndarray
    exit: np.ndarray


def ray_offsets(angles: np.ndarray, length: float) -> RayOffsets:
    """Return the cells left within `length` [cells] by rays from a cell's centre.

    A table in double precision, made once per sensor and resolution: every cell's ray in one
    direction crosses the same offsets, which is what lets a whole map be scanned by shifts.

    Args:
        angles: (D,) directions from the column axis towards the row axis [rad].
        length: how far a ray reaches [cells].
    """
    rays = []
    for angle in angles:
        direction = np.array([math.sin(angle), math.cos(angle)])
        step = np.sign(direction).astype(int)
        with np.errstate(divide="ignore"):
            spacing = 1.0 / np.abs(direction)
        upcoming, cell, ray = spacing / 2.0, np.zeros(2, int), []
        while (leave := upcoming.min()) <= length:
            ray.append((cell[0], cell[1], leave))
            crossed = upcoming <= leave + 1e-9  # both at a corner
            cell = cell + step * crossed
            upcoming = np.where(crossed, upcoming + spacing, upcoming)
        rays.append(ray)
    longest = max(1, max(len(ray) for ray in rays))
    offset = np.zeros((len(rays), longest, 2), np.int32)
    exit_ = np.full((len(rays), longest), np.inf)
    for index, ray in enumerate(rays):
        if ray:
            table = np.array(ray)
            offset[index, : len(ray)] = table[:, :2]
            exit_[index, : len(ray)] = table[:, 2]
    return RayOffsets(offset, exit_)
