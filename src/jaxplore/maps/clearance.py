"""Compute the distance to the nearest blocked cell, cheaply enough for every control step."""

import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jax import Array

from jaxplore._types import GridMask, GridValues
from jaxplore.maps.field import ScalarField
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OccupancyGrid
from jaxplore.maps.window import Window


def clearance_field(blocked: GridMask, frame: GridFrame, max_distance: float) -> ScalarField:
    """Return the field of distances from each cell's centre to the nearest blocked cell [m].

    The distance is the Euclidean distance between cell centres minus half a cell, which along an
    axis is the distance to the face of the nearest blocked cell. It is clipped to
    [0, max_distance]. Off the map everything is blocked. Within the bound it is exact, because the
    squared distance separates into two one-dimensional minima (Saito and Toriwaki 1994):

        d^2(r, c) = min_j [(c - j)^2 + min_i ((r - i)^2 + [i, j is not blocked] * inf)]

    With a bound of R cells each minimum is over 2R + 1 shifts of the whole map. So there is no
    data-dependent loop, and the cost does not depend on the map's content.

    Args:
        blocked: mask (H, W) of the cells that may not be entered.
        frame: pose and cell size of the map.
        max_distance: upper bound of the distance [m]; static.
    """
    values = _distances(blocked, frame.resolution, max_distance)
    return ScalarField(values=values, frame=frame, outside=jnp.zeros(()))


def find_closed_cells(
    grid: OccupancyGrid, ground: Ground | None, window: Window | None = None
) -> GridMask:
    """Return the mask of the cells that are not known to be free, or that the ground blocks.

    Without a ground the map is level. Without a window the mask is of the whole map.
    """
    probability = grid.probability if window is None else window.read(grid.probability)
    closed = ~(probability < FREE_THRESHOLD)
    if ground is None:
        return closed
    passable = ground.is_traversable
    return closed | ~(passable if window is None else window.read(passable))


def update_clearance(
    field: ScalarField,
    window: Window,
    blocked: Callable[[Window], GridMask],
    max_distance: float,
) -> ScalarField:
    """Return the `clearance_field` of a map that has changed in a window only, to the bit.

    Distances change within the bound `max_distance` [m] (static) around the window, and depend on
    the cells within the bound around these. So the cost is that of a map as large as the window and
    twice the bound on each side. `blocked` returns the mask of a part of the map.
    """
    reach = _reach(max_distance, field.frame.resolution)
    inner, outer = window.grow(reach), window.grow(2 * reach)
    values = _distances(blocked(outer), field.frame.resolution, max_distance)
    renewed = inner.write(field.values, inner.relative_to(outer).read(values))
    return ScalarField(values=renewed, frame=field.frame, outside=field.outside)


def _reach(max_distance: float, resolution: float) -> int:
    # Distances are reduced by half a cell, so the search reaches that much farther.
    return max(1, math.ceil(max_distance / resolution + 0.5))


def _distances(blocked: GridMask, resolution: float, max_distance: float) -> GridValues:
    reach = _reach(max_distance, resolution)
    far = float((reach + 1) ** 2)
    # Start with a value beyond the bound instead of infinity, which would spoil the sums.
    squared = jnp.where(blocked, 0.0, far)
    for axis in (0, 1):
        squared = _least_over_shifts(squared, reach, axis)
    return jnp.clip((jnp.sqrt(squared) - 0.5) * resolution, 0.0, max_distance)


def _least_over_shifts(squared: Array, reach: int, axis: int) -> Array:
    """Return `min over |k| <= reach of squared[shifted by k] + k^2` along an axis."""
    # Padding with 0 makes everything off the map blocked.
    pad = [(0, 0), (0, 0)]
    pad[axis] = (reach, reach)
    padded = jnp.pad(squared, pad)

    def closer(index: Array, least: Array) -> Array:
        shifted = jax.lax.dynamic_slice_in_dim(padded, index, squared.shape[axis], axis)
        shift = (index - reach).astype(jnp.float32)
        return jnp.minimum(least, shifted + shift * shift)

    least: Array = jax.lax.fori_loop(0, 2 * reach + 1, closer, squared)
    return least
