"""The distance to the nearest closed voxel, of all voxels together."""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float


def squared_distance(closed: Bool[Array, "D H W"], reach: int) -> Float[Array, "D H W"]:
    """Return the squared distance between the centres of each voxel and the nearest closed one.

    The exact Euclidean distance, axis by axis: with d_x the distance along x within the row,

        d^2(k, j, i) = min over m, n of  d_x^2(k + m, j + n, i) + n^2 + m^2

    Source: Maurer, Qi and Raghavan, "A linear time algorithm for computing exact Euclidean distance
    transforms of binary images in arbitrary dimensions", PAMI 2003, whose passes over the axes
    these are. Offsets beyond the reach are left out.

    Args:
        closed: the closed voxels. Beyond the array nothing is closed.
        reach: greatest distance of interest [voxels]; static. Greater distances are
            `(reach + 1)^2`.
    """
    far = float((reach + 1) ** 2)
    squared = jnp.where(closed, 0.0, far)
    for axis in (2, 1, 0):
        squared = _along(squared, axis, reach, far)
    return squared


def _along(squared: Array, axis: int, reach: int, far: float) -> Array:
    """Return the least squared distance with offsets along one more axis."""
    size = squared.shape[axis]
    steps = min(reach, size - 1)
    widths = [(steps, steps) if each == axis else (0, 0) for each in range(3)]
    padded = jnp.pad(squared, widths, constant_values=far)
    least = squared
    for offset in range(1, steps + 1):
        for begin in (steps - offset, steps + offset):
            shifted = jax.lax.slice_in_dim(padded, begin, begin + size, axis=axis)
            least = jnp.minimum(least, shifted + float(offset * offset))
    return least
