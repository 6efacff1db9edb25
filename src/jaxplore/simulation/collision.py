"""How close the robot really is to the world."""

import math

import jax.numpy as jnp
from jax import Array

from jaxplore._types import GridMask, Scalar


def disc_clearance(
    solid: GridMask, grid: Array, radius: Scalar, resolution: float, reach: int
) -> Scalar:
    """Return the distance from a disc's edge to the nearest solid square cell [m].

    Exact for cells within `reach` cells of the disc's centre, and at most that far; off the map
    everything is solid. Negative: they overlap.

    Args:
        solid: (H, W).
        grid: (row, column) of the centre [cells].
        radius: of the disc [m].
        resolution: side of a cell [m].
        reach: cells looked at in each direction; static.
    """
    height, width = solid.shape
    base = jnp.floor(grid).astype(jnp.int32)
    offsets = jnp.arange(-reach, reach + 1)
    rows, columns = base[0] + offsets, base[1] + offsets
    on_map = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))[None]
    is_solid = ~on_map | solid[jnp.clip(rows, 0, height - 1)][:, jnp.clip(columns, 0, width - 1)]

    def to_interval(cells: Array, centre: Array) -> Array:
        low = cells.astype(jnp.float32)
        return jnp.maximum(jnp.maximum(low - centre, centre - (low + 1.0)), 0.0)

    gap = jnp.hypot(to_interval(rows, grid[0])[:, None], to_interval(columns, grid[1])[None])
    nearest = jnp.min(jnp.where(is_solid, gap, float(reach)))
    return nearest * resolution - radius


def clearance_reach(radius: float, resolution: float, margin: float = 0.5) -> int:
    """Return the cells to look at for `disc_clearance` to be exact up to `margin` [m]."""
    return math.ceil((radius + margin) / resolution) + 1
