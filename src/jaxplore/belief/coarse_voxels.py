"""The coarser voxels in which information and paths are computed, kept up to date by windows."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.maps.window import Window, read_first

UNKNOWN, FREE, OCCUPIED = 0, 1, 2
"""States of a coarser voxel."""


def blocks(values: Array, side: int) -> Array:
    """Return the voxels of each block on the last axis; a short block repeats its last voxels."""
    widths = [(0, -size % side) for size in values.shape]
    padded = jnp.pad(values, widths, mode="edge")
    depth, height, width = (size // side for size in padded.shape)
    split = padded.reshape(depth, side, height, side, width, side).transpose(0, 2, 4, 1, 3, 5)
    return split.reshape(depth, height, width, side**3)


def coarse_states(grid: VoxelGrid, pool: int) -> Int[Array, "D2 H2 W2"]:
    """Return the states of the coarser voxels of a grid, with `pool` voxels on a side; static.

    A coarser voxel is occupied if any of its voxels is, and free if all of them are.
    """
    is_free = blocks(grid.is_free, pool).all(axis=-1)
    is_occupied = blocks(grid.is_occupied, pool).any(axis=-1)
    state = jnp.where(is_occupied, OCCUPIED, jnp.where(is_free, FREE, UNKNOWN))
    return state.astype(jnp.int8)


def coarse_room(clearance: Float[Array, "D H W"], pool: int) -> Float[Array, "D2 H2 W2"]:
    """Return the least clearance in each coarser voxel [m]."""
    return blocks(clearance, pool).min(axis=-1)


def coarse_shape(shape: Sequence[int], pool: int) -> tuple[int, int, int]:
    """Return the numbers of coarser voxels along z, y and x."""
    depth, height, width = (-(-size // pool) for size in shape)
    return depth, height, width


def align_window(
    corner: Int[Array, "3"], shape: Sequence[int], map_shape: tuple[int, int, int], pool: int
) -> Window:
    """Return a window that begins with a whole coarser voxel, also where it is moved inwards.

    It may begin up to a coarser voxel, of `pool` voxels on a side, before the voxel `corner`
    (k, j, i). After `corner` it has at least `shape` voxels. All but `corner` is static.
    """
    sizes = []
    for wanted, most in zip(shape, map_shape, strict=True):
        size = wanted + pool
        # What a window that is moved inwards leaves before it must be whole coarser voxels.
        sizes.append(min(most, size + (most - size) % pool))
    return Window.at(corner // pool * pool, sizes, map_shape)


def update_coarse(
    coarse: Shaped[Array, "D2 H2 W2"],
    new: Shaped[Array, "d2 h2 w2"],
    window: Window,
    pool: int,
) -> tuple[Shaped[Array, "D2 H2 W2"], Bool[Array, "d2 h2 w2"], Window]:
    """Return coarser voxels with new ones in a window, which of these changed, and their window.

    The argument `window` is one of `align_window`, in voxels. `pool` voxels are on a side of a
    coarser one; static.
    """
    shape = coarse_shape(window.shape, pool)
    target = Window.at(window.corner // pool, shape, coarse_shape(window.map_shape, pool))
    old, coarse = read_first(target, coarse)
    # The last coarser voxel is only complete where the map ends. Nothing changes there: windows
    # have a margin.
    for axis, size in enumerate(window.shape):
        if size % pool:
            is_end = window.corner[axis] + size == window.map_shape[axis]
            is_last = jnp.arange(shape[axis]) == shape[axis] - 1
            keeps = jnp.expand_dims(is_last & ~is_end, [a for a in range(3) if a != axis])
            new = jnp.where(keeps, old, new)
    return target.write(coarse, new), new != old, target


def find_stale_columns(
    changed: Bool[Array, "H2 W2"], reach: int, first: int, stride: int, shape: tuple[int, int]
) -> Bool[Array, "H W"]:
    """Return which columns of nodes have a changed column of coarser voxels within their reach.

    The reach along each axis, the place of the first node and the stride between nodes are in
    coarser voxels. `shape` are the rows and columns of nodes. All but `changed` is static.
    """
    touched = changed
    for axis, (size, number) in enumerate(zip(changed.shape, shape, strict=True)):
        last = first + (number - 1) * stride
        padding = [(0, 0), (0, 0)]
        padding[axis] = (max(0, reach - first), max(0, last + reach + 1 - size))
        window, strides = [1, 1], [1, 1]
        window[axis], strides[axis] = 2 * reach + 1, stride
        touched = jax.lax.reduce_window(
            touched, False, jax.lax.bitwise_or, window, strides, padding
        )
        touched = jax.lax.slice_in_dim(touched, 0, number, axis=axis)
    return touched
