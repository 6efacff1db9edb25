"""A map whose window moves with the robot over a volume that is larger than memory.

The robot's map, distances and information cover a window. What leaves the window is kept with one
byte for each voxel, where a voxel of the window takes about 13. It comes back with the window.
"""

import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxplore._types import Flag, Scalar
from jaxplore.belief.volume_geodesic import volume_geodesic
from jaxplore.belief.volume_roads import FAR, VolumeRoads
from jaxplore.maps.volume_field import VolumeField
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.maps.window import Window, near_faces
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel

BLOCK = 8
"""Nodes on a side of the blocks by which the window moves, and of whose viewpoints outside the
window the best one is remembered."""
LEVELS = 127
"""Levels of stored log-odds on either side of 0."""


class RollingMap(eqx.Module):
    """What is known beyond the window of a belief.

    Args:
        stored: (D, H, W) log-odds of the voxels of the whole volume, in shares of the greatest one.
            Those in the window are those of the last time that it was stored.
        offset: voxel (k, j, i) of the volume at which the window begins; whole blocks.
        left: (Db, Hb, Wb) greatest information of a viewpoint, where the robot fits, of each block
            when it was last in the window [nat m^3].
        origin: corner (x, y, z) of the volume [m].
        unit: log-odds of a level.
        shape: numbers of voxels (D, H, W) of the volume; static.
    """

    stored: Int[Array, "D H W"]
    offset: Int[Array, "3"]
    left: Float[Array, "Db Hb Wb"]
    origin: Float[Array, "3"]
    unit: Scalar
    shape: tuple[int, int, int] = eqx.field(static=True)

    @classmethod
    def around(
        cls,
        grid: VoxelGrid,
        position: Float[Array, "3"],
        shape: tuple[int, int, int],
        block: int,
        model: InverseSensorModel,
    ) -> tuple["RollingMap", VoxelGrid]:
        """Return a map with its window around a position, and the grid of the window.

        `grid` is that of the whole volume. `shape` is one of `window_shape`, and `block` the
        number of voxels on a side of a block; both static. The bounds of `model` are those of the
        log-odds.
        """
        unit = jnp.maximum(jnp.abs(model.minimum), jnp.abs(model.maximum)) / LEVELS
        offset = centre_window(grid.to_grid(position), shape, grid.shape, block)
        blocks = [-(-size // block) for size in grid.shape]
        stored = _levels(grid.log_odds, unit)
        rolling = cls(stored, offset, jnp.zeros(blocks), grid.origin, unit, grid.shape)
        return rolling, rolling.window(grid, shape)

    def place(self, shape: tuple[int, int, int]) -> Window:
        """Return the place of a window of a shape in the volume."""
        return Window(self.offset, shape, self.shape)

    def window(self, grid: VoxelGrid, shape: tuple[int, int, int]) -> VoxelGrid:
        """Return the grid of the window as it was stored, with the resolution of `grid`."""
        log_odds = self.place(shape).read(self.stored).astype(jnp.float32) * self.unit
        corner = self.origin + grid.resolution * jnp.flip(self.offset).astype(jnp.float32)
        moved: VoxelGrid = eqx.tree_at(
            lambda each: (each.log_odds, each.origin), grid, (log_odds, corner)
        )
        return moved

    def with_window(self, grid: VoxelGrid) -> Int[Array, "D H W"]:
        """Return what is stored of the whole volume, with the grid of the window in its place."""
        return self.place(grid.shape).write(self.stored, _levels(grid.log_odds, self.unit))

    def whole(self, grid: VoxelGrid) -> VoxelGrid:
        """Return the grid of the whole volume, with that of the window in its place."""
        log_odds = self.with_window(grid).astype(jnp.float32) * self.unit
        known: VoxelGrid = eqx.tree_at(
            lambda each: (each.log_odds, each.origin), grid, (log_odds, self.origin)
        )
        return known

    def next_offset(
        self, grid: VoxelGrid, position: Float[Array, "3"], keep: float, block: int
    ) -> tuple[Flag, Int[Array, "3"]]:
        """Return whether the window must move, and where it begins then.

        It must if the robot is less than `keep` [m] from an inner face. `grid` is that of the
        window, and `block` the number of voxels on a side of a block; static.
        """
        here = grid.to_grid(position)
        ends = np.asarray(grid.shape, np.float32)
        gap = jnp.stack([here, ends - here], axis=1) * grid.resolution
        is_near = jnp.any((gap < keep) & self.place(grid.shape).is_inner)
        is_near = is_near & jnp.all(jnp.isfinite(here))
        offset = centre_window(here + self.offset.astype(here.dtype), grid.shape, self.shape, block)
        return is_near & jnp.any(offset != self.offset), offset

    def with_left(
        self, shape: tuple[int, int, int], worth: Float[Array, "d h w"], block: int
    ) -> Float[Array, "Db Hb Wb"]:
        """Return the greatest information of each block [nat m^3], with that of the window in its
        places. `shape` is that of the window, and `block` the voxels on a side of a block; both
        static. `worth` is 0 where the robot does not fit."""
        padded = jnp.pad(worth, [(0, -size % BLOCK) for size in worth.shape])
        depth, height, width = (size // BLOCK for size in padded.shape)
        split = padded.reshape(depth, BLOCK, height, BLOCK, width, BLOCK)
        at = Window.at(self.place(shape).corner // block, (depth, height, width), self.left.shape)
        return at.write(self.left, split.max(axis=(1, 3, 5)))

    def toward_the_rest(
        self,
        grid: VoxelGrid,
        block: int,
        decay_length: Scalar,
        min_information: Scalar,
    ) -> VolumeField:
        """Return the cost-to-go to what was left outside the window, as if nothing was between [m].

        With d the distance between blocks and I the greatest information of a block outside,

            V(x) = min over blocks b of d(x, b) - decay_length ln I(b)

        Blocks with less than `min_information` [nat m^3] do not count; without others the field is
        `FAR`. `grid` is that of the window, and `block` the number of voxels on a side of a block;
        static.
        """
        spacing = block * grid.resolution
        first = -(-self.offset // block)
        last = (self.offset + jnp.asarray(grid.shape)) // block
        index = jnp.stack(jnp.meshgrid(*map(jnp.arange, self.left.shape), indexing="ij"))
        trailing = (3, 1, 1, 1)
        is_inside = jnp.all(
            (index >= first.reshape(trailing)) & (index < last.reshape(trailing)), axis=0
        )
        counts = ~is_inside & (self.left >= min_information)
        reward = decay_length * jnp.log(jnp.maximum(self.left, 1e-6))
        source = jnp.where(counts, -reward, jnp.inf) / spacing
        is_open = jnp.ones([2 * size - 1 for size in self.left.shape], bool)
        cost = volume_geodesic(source, jnp.ones_like(source), is_open) * spacing
        # Finite, because interpolation would make NaN of infinity.
        bounded = jnp.minimum(cost, FAR)
        return VolumeField(bounded, self.origin + 0.5 * spacing, spacing, jnp.asarray(FAR))

    def ends(
        self,
        grid: VoxelGrid,
        roads: VolumeRoads,
        block: int,
        decay_length: Scalar,
        min_information: Scalar,
        kept: float,
    ) -> Float[Array, "d h w"]:
        """Return the cost of the nodes at the inner faces of the window as ends of a path [m].

        It is that of `toward_the_rest`, with the same arguments, and infinite at all other nodes.
        `kept` is the distance that the robot keeps from what is beyond the window [m]; static.
        """
        rest = self.toward_the_rest(grid, block, decay_length, min_information)
        shape = roads.slowness.shape
        width = 1 + math.ceil(kept / roads.spacing)
        at_face = near_faces(shape, self.place(grid.shape).is_inner, width)
        places = jnp.stack([each.reshape(-1) for each in roads.places])
        cost = jax.vmap(rest, in_axes=1)(places).reshape(shape)
        return jnp.where(at_face & (cost < 0.5 * FAR), cost, jnp.inf)


def check_extents(
    extents: Sequence[float], whole: tuple[int, int, int], side: float, block: int, keep: float
) -> None:
    """Check that a window of `extents` (x, y, z) [m] is so large that it need not move again at
    once. It moves by blocks of `block` voxels, when the robot is at the distance `keep` [m] from a
    face inside the volume of `whole` voxels along z, y and x."""
    # The robot is at most half a block from the middle, and moves on before the next fields.
    least = 2.0 * (keep + (0.5 * block + 1.0) * side + 0.5)
    for extent, size in zip(reversed(extents), whole, strict=True):
        if extent < min(least, size * side - 1e-3):
            raise ValueError(
                f"window is {list(extents)} for a volume of "
                f"{[round(n * side, 3) for n in reversed(whole)]} m; accepted: at least "
                f"{least:.1f} m, or the extent of the volume, along each axis"
            )


def window_shape(
    whole: tuple[int, int, int], extents: Sequence[float], side: float, block: int
) -> tuple[int, int, int]:
    """Return the numbers of voxels of a window along z, y and x.

    `whole` are those of the volume. `extents` (x, y, z) and the side of a voxel are in metres. At
    the far end of the volume, too, the window begins with a whole block of `block` voxels on a
    side.
    """
    sizes = []
    for most, extent in zip(whole, reversed(extents), strict=True):
        size = math.ceil(extent / side - 1e-4)
        sizes.append(min(most, size + (most - size) % block))
    depth, height, width = sizes
    return depth, height, width


def centre_window(
    here: Float[Array, "3"], shape: tuple[int, int, int], whole: tuple[int, ...], block: int
) -> Int[Array, "3"]:
    """Return the first voxel of the window whose middle is nearest to a place.

    The place is in grid coordinates (z, y, x) of the volume [voxels]. `shape` is that of the
    window, `whole` that of the volume, and `block` the voxels on a side of a block; all static.
    """
    finite = jnp.where(jnp.isfinite(here), here, 0.0)
    middle = 0.5 * np.asarray(shape, np.float32)
    first = jnp.round((finite - middle) / block).astype(jnp.int32) * block
    return jnp.clip(first, 0, np.subtract(whole, shape).astype(np.int32))


def shift_array(values: Array, shift: Int[Array, "3"]) -> Array:
    """Return an array (..., D, H, W) moved by places along its last axes; 0 where nothing was.

    `shift` is the place (k, j, i) that becomes the first one.
    """
    moved, first = values, values.ndim - 3
    for axis in range(3):
        size = values.shape[first + axis]
        source = jnp.arange(size) + shift[axis]
        is_known = (source >= 0) & (source < size)
        moved = jnp.roll(moved, -shift[axis], first + axis)
        others = [a for a in range(values.ndim) if a != first + axis]
        moved = jnp.where(jnp.expand_dims(is_known, others), moved, jnp.zeros((), values.dtype))
    return moved


def _levels(log_odds: Float[Array, "D H W"], unit: Scalar) -> Int[Array, "D H W"]:
    return jnp.round(jnp.clip(log_odds / unit, -LEVELS, LEVELS)).astype(jnp.int8)
