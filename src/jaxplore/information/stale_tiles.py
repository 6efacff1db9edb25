"""Which tiles of a lattice of nodes a change of the map makes stale."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

TILE = 40
"""Nodes on a side of the tiles that are evaluated at a time: a tile fits the CPU's cache."""
BLOCKS = 5
"""Blocks on a side of a tile; changed cells are detected per block."""


def find_changed_blocks(
    is_changed: Bool[Array, "H W"], tiles: tuple[int, int], stride: int, margin: int
) -> Bool[Array, "rows columns"]:
    """Return the mask of the blocks with a changed cell, with a margin of unchanged blocks.

    `tiles` are the rows and columns of tiles, `stride` the number of cells between nodes, and
    `margin` the number of blocks around the map; all static.
    """
    side = TILE * stride // BLOCKS
    padding = [
        (0, count * BLOCKS * side - size)
        for count, size in zip(tiles, is_changed.shape, strict=True)
    ]
    cells = jnp.pad(is_changed, padding)
    blocks = cells.reshape(tiles[0] * BLOCKS, side, tiles[1] * BLOCKS, side)
    return jnp.pad(blocks.any(axis=(1, 3)), margin)


def find_touched_tiles(
    changed: Bool[Array, "rows columns"], size: int
) -> Bool[Array, "tile_rows tile_columns"]:
    """Return the mask of the tiles that have a changed block within the reach of their beams.

    `changed` has a margin. What a tile's beams reach has `size` blocks on a side; static.
    """
    touched: Array = jax.lax.reduce_window(
        changed, False, jax.lax.bitwise_or, (size, size), (BLOCKS, BLOCKS), "VALID"
    )
    return touched


def group_shape(tiles: tuple[int, int], reach: int, stride: int) -> tuple[int, int]:
    """Return the rows and columns of the tiles that are evaluated with the same maps.

    A scan changes cells up to the reach [cells] of its beams from the robot, and the information of
    nodes up to the reach of theirs from these. `tiles` are those of the lattice, `stride` cells a
    node.
    """
    most = 1 + -(-4 * reach // (TILE * stride))
    # A last tile is moved inwards, into the one before it, so a group has at least two.
    rows, columns = (min(count, max(2, most)) for count in tiles)
    return rows, columns


def first_group(
    pending: Bool[Array, "tile_rows tile_columns"], group: tuple[int, int]
) -> Int[Array, "2"]:
    """Return the first tile (row, column) of a group with the topmost of the pending tiles."""
    rows, columns = pending.shape
    row = jnp.minimum(jnp.argmax(pending.any(axis=1)), rows - group[0])
    band = jax.lax.dynamic_slice_in_dim(pending, row, group[0])
    column = jnp.minimum(jnp.argmax(band.any(axis=0)), columns - group[1])
    return jnp.stack([row, column]).astype(jnp.int32)


def find_reached_blocks(offset: np.ndarray, stride: int) -> np.ndarray:
    """Return the directions in which beams from a tile's nodes reach each block around the tile.

    The mask is over blocks and directions, (n, n, D), with the tile's own blocks in the middle.
    """
    # For each offset of a beam, its end cells over all nodes of the tile form a rectangle, which
    # covers a rectangle of blocks.
    side = TILE * stride // BLOCKS
    margin = -(-int(np.abs(offset).max() + stride) // side)
    reached = np.zeros((BLOCKS + 2 * margin, BLOCKS + 2 * margin, len(offset)), bool)
    low, high = stride // 2, stride // 2 + (TILE - 1) * stride
    for direction, cells in enumerate(offset):
        for row, column in np.unique(cells, axis=0):
            rows, columns = (
                slice((low + cell) // side + margin, (high + cell) // side + margin + 1)
                for cell in (row, column)
            )
            reached[rows, columns, direction] = True
    return reached
