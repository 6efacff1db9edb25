"""Distance to the nearest cell that may not be entered, cheap enough for every control step."""

import math

import jax
import jax.numpy as jnp
from jax import Array

from jaxplore._types import GridMask
from jaxplore.maps.field import ScalarField
from jaxplore.maps.frame import GridFrame


def clearance_field(blocked: GridMask, frame: GridFrame, max_distance: float) -> ScalarField:
    """Return the distance from each cell's centre to the nearest blocked cell [m].

    The Euclidean distance between cell centres less half a cell, so to the face of the nearest
    blocked cell along an axis, at least 0 and at most `max_distance`. Off the map everything is
    blocked. Exact within the bound: the squared distance separates,

        d^2(r, c) = min_j [(c - j)^2 + min_i ((r - i)^2 + [i, j is not blocked] * inf)]

    (Saito and Toriwaki 1994), and under a bound of R cells each minimum is over 2R + 1 shifts of
    the whole map, whatever is on it: no data-dependent loop, the same cost each time.

    Args:
        blocked: (H, W) cells that may not be entered.
        frame: where the cells are.
        max_distance: bound of the distance [m]; static.
    """
    reach = max(1, math.ceil(max_distance / frame.resolution + 0.5))
    far = float((reach + 1) ** 2)
    squared = jnp.where(blocked, 0.0, far)
    for axis in (0, 1):
        squared = _least_over_shifts(squared, reach, axis)
    distance = (jnp.sqrt(squared) - 0.5) * frame.resolution
    return ScalarField(
        values=jnp.clip(distance, 0.0, max_distance), frame=frame, outside=jnp.zeros(())
    )


def _least_over_shifts(squared: Array, reach: int, axis: int) -> Array:
    """Return `min over |k| <= reach of squared[shifted by k] + k^2` along an axis."""
    pad = [(0, 0), (0, 0)]
    pad[axis] = (reach, reach)
    padded = jnp.pad(squared, pad)  # 0: off the map is blocked

    def closer(index: Array, least: Array) -> Array:
        shifted = jax.lax.dynamic_slice_in_dim(padded, index, squared.shape[axis], axis)
        shift = (index - reach).astype(jnp.float32)
        return jnp.minimum(least, shifted + shift * shift)

    least: Array = jax.lax.fori_loop(0, 2 * reach + 1, closer, squared)
    return least
