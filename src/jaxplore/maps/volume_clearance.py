"""The distance to the nearest closed voxel, of all voxels together."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxplore.maps.volume_field import VolumeField
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.maps.window import Window, near_faces


def clearance_of_volume(
    grid: VoxelGrid, reach: int, closed: Bool[Array, "D H W"] | None = None
) -> VolumeField:
    """Return the distance of each voxel's centre from the nearest closed voxel [m].

    `closed` are all voxels that are not known to be free when None. `reach` is the greatest
    distance of interest [voxels]; static.
    """
    side, shape = grid.resolution, grid.shape
    nothing = jnp.zeros(shape)
    everything = Window.at(jnp.zeros(3, jnp.int32), shape, shape)
    metres = update_clearance(grid, nothing, everything, reach, closed)
    return VolumeField(metres, grid.origin + 0.5 * side, side, jnp.zeros(()))


def update_clearance(
    grid: VoxelGrid,
    before: Float[Array, "D H W"],
    window: Window,
    reach: int,
    closed: Bool[Array, "D H W"] | None = None,
) -> Float[Array, "D H W"]:
    """Return the distances of `clearance_of_volume` [m] after a change in a window.

    `before` are the distances before the change. The window has twice the reach around all that has
    changed.
    """
    seen = eqx.tree_at(lambda each: each.log_odds, grid, window.read(grid.log_odds))
    near = ~seen.is_free if closed is None else window.read(closed)
    # Beyond the map all is closed.
    squared = squared_distance(_add_walls(near, window), reach)[1:-1, 1:-1, 1:-1]
    # From the centre of the nearest closed voxel to its face is half a voxel.
    voxels = jnp.maximum(jnp.sqrt(squared.astype(jnp.float32)) - 0.5, 0.0)
    # Near the rim of the window, what lies outside could be nearer. Nothing changes there.
    kept = near_faces(window.shape, window.is_inner, reach)
    metres = jnp.where(kept, window.read(before), voxels * grid.resolution)
    return window.write(before, metres)


def squared_distance(closed: Bool[Array, "D H W"], reach: int) -> Int[Array, "D H W"]:
    """Return the squared distance between the centres of each voxel and the nearest closed one.

    The exact Euclidean distance, axis by axis: with d_x the distance along x within the row,

        d^2(k, j, i) = min over m, n of  d_x^2(k + m, j + n, i) + n^2 + m^2

    Beyond the array nothing is closed. Distances greater than `reach` [voxels] (static) are
    `(reach + 1)^2`: offsets beyond it are left out.

    Source: Maurer, Qi and Raghavan, "A linear time algorithm for computing exact Euclidean distance
    transforms of binary images in arbitrary dimensions", PAMI 2003, whose passes over the axes
    these are.
    """
    far = (reach + 1) ** 2
    # The sum of two squares must fit. With 16 bits the passes take a seventh of the time that they
    # take with floats.
    kind = jnp.int16 if 2 * far < 2**15 else jnp.int32
    squared = jnp.where(closed, jnp.zeros((), kind), jnp.asarray(far, kind))
    for axis in (2, 1, 0):
        squared = _along(squared, axis, reach, far)
    return squared


def _along(squared: Array, axis: int, reach: int, far: int) -> Array:
    """Return the least squared distance with offsets along one more axis."""
    size = squared.shape[axis]
    steps = min(reach, size - 1)
    widths = [(steps, steps) if each == axis else (0, 0) for each in range(3)]
    padded = jnp.pad(squared, widths, constant_values=far)
    least = squared
    for offset in range(1, steps + 1):
        for begin in (steps - offset, steps + offset):
            shifted = jax.lax.slice_in_dim(padded, begin, begin + size, axis=axis)
            least = jnp.minimum(least, shifted + jnp.asarray(offset * offset, squared.dtype))
    return least


def _add_walls(closed: Bool[Array, "d h w"], window: Window) -> Bool[Array, "d2 h2 w2"]:
    """Return a window with one more layer around, closed where the map ends."""
    walled = jnp.pad(closed, 1)
    for axis, (size, most) in enumerate(zip(window.shape, window.map_shape, strict=True)):
        begin = window.corner[axis]
        index: list[slice | int] = [slice(None)] * 3
        for side, ends in ((0, begin == 0), (-1, begin + size == most)):
            index[axis] = side
            walled = walled.at[tuple(index)].max(ends)
    return walled
