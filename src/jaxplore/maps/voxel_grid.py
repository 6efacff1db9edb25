"""The occupancy of a volume: log-odds of voxels on a regular lattice."""

import math
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Vector
from jaxplore.maps.frame import PRECISION
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OCCUPIED_THRESHOLD

FREE_BELOW = math.log(FREE_THRESHOLD / (1.0 - FREE_THRESHOLD))
OCCUPIED_ABOVE = math.log(OCCUPIED_THRESHOLD / (1.0 - OCCUPIED_THRESHOLD))
"""Log-odds of the thresholds of an `OccupancyGrid`."""


class VoxelGrid(eqx.Module):
    """Log-odds of occupancy of the voxels of a box whose axes are those of the world.

    Voxel `(k, j, i)` is the k-th along z, the j-th along y and the i-th along x, as rows and
    columns are of an `OccupancyGrid`. It covers
    `[i, i + 1)` times the resolution from the origin along x, and likewise the other axes.
    *Grid coordinates* (z, y, x) are a world point minus the origin, divided by the resolution.

    Args:
        log_odds: (D, H, W) log-odds of occupancy; 0 is unknown.
        resolution: side of a voxel [m]; static.
        origin: corner (x, y, z) of voxel (0, 0, 0) [m].

    Raises:
        ValueError: log-odds that are not three-dimensional, empty or not finite, a resolution that
            is not positive, an origin that is not finite or so far away that single precision does
            not resolve a fiftieth of a voxel.
    """

    log_odds: Float[Array, "D H W"]
    origin: Float[Array, "3"]
    resolution: float = eqx.field(static=True)

    def __init__(
        self, log_odds: ArrayLike, resolution: float, origin: Vector = (0.0, 0.0, 0.0)
    ) -> None:
        self.resolution = _checks.number("resolution", resolution, above=0.0)
        self.origin = _checks.vector("origin", origin, 3)
        if not _kinds.is_traced(self.origin):
            _checks.near("origin", np.asarray(self.origin), PRECISION * self.resolution)
        shape = np.shape(log_odds)
        if len(shape) != 3 or 0 in shape:
            raise ValueError(f"log_odds has shape {shape}; accepted: (D, H, W) with D, H, W >= 1")
        if not _kinds.is_traced(log_odds):
            values = np.asarray(log_odds)
            is_bad = ~np.isfinite(values)
            if is_bad.any():
                raise ValueError(
                    f"log_odds has a value {values[is_bad][0]}; accepted: finite numbers"
                )
        self.log_odds = jnp.asarray(log_odds, jnp.float32)

    @classmethod
    def unknown(
        cls, size: Vector, resolution: float, origin: Vector = (0.0, 0.0, 0.0)
    ) -> "VoxelGrid":
        """Return a box without knowledge.

        Args:
            size: extents (x, y, z) [m], rounded up to whole voxels.
            resolution: side of a voxel [m].
            origin: corner (x, y, z) [m].

        Raises:
            ValueError: an extent that is not positive, and what the class refuses.
        """
        extents = np.asarray(_checks.vector("size", size, 3), np.float64)
        side = _checks.number("resolution", resolution, above=0.0)
        if not (extents > 0.0).all():
            raise ValueError(f"size is {extents.tolist()}; accepted: three lengths above 0")
        # Tolerate rounding: 3 m are 30 voxels of 0.1 m, not 31.
        width, height, depth = (max(1, math.ceil(each / side - 1e-4)) for each in extents)
        return cls(np.zeros((depth, height, width), np.float32), side, origin)

    @classmethod
    def solid(
        cls, mask: ArrayLike, resolution: float, origin: Vector = (0.0, 0.0, 0.0)
    ) -> "VoxelGrid":
        """Return a true world: every voxel is certainly occupied or certainly free.

        Args:
            mask: (D, H, W) whether each voxel is occupied.
            resolution: side of a voxel [m].
            origin: corner (x, y, z) [m].

        Raises:
            ValueError: a mask that is not boolean, and what the class refuses.
        """
        given = np.asarray(mask)
        if given.dtype != bool:
            raise ValueError(f"mask has type {given.dtype}; accepted: booleans")
        # In single precision at once: no array of twice the size is made.
        log_odds = np.where(given, np.float32(CERTAIN), np.float32(-CERTAIN))
        return cls(log_odds, resolution, origin)

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels along z, y and x."""
        depth, height, width = self.log_odds.shape
        return depth, height, width

    def with_solid(self, mask: Bool[Array, "D H W"]) -> "VoxelGrid":
        """Return a true world in which these voxels are certainly occupied as well."""
        log_odds = jnp.where(mask, CERTAIN, self.log_odds)
        solid: VoxelGrid = eqx.tree_at(lambda each: each.log_odds, self, log_odds)
        return solid

    @property
    def is_free(self) -> Bool[Array, "D H W"]:
        """Mask of the voxels that are known to be free."""
        return self.log_odds < FREE_BELOW

    @property
    def is_occupied(self) -> Bool[Array, "D H W"]:
        """Mask of the voxels that are known to be occupied."""
        return self.log_odds > OCCUPIED_ABOVE

    @property
    def is_unknown(self) -> Bool[Array, "D H W"]:
        """Mask of the voxels that are neither."""
        return ~(self.is_free | self.is_occupied)

    def to_grid(self, points: Float[Array, "3 *N"]) -> Float[Array, "3 *N"]:
        """Convert world points (x, y, z) [m] to grid coordinates (z, y, x) [voxels]."""
        trailing = (3, *[1] * (points.ndim - 1))
        return jnp.flip(points - self.origin.reshape(trailing), axis=0) / self.resolution

    def to_world(self, grid: Float[Array, "3 *N"]) -> Float[Array, "3 *N"]:
        """Convert grid coordinates (z, y, x) [voxels] to world points (x, y, z) [m]."""
        trailing = (3, *[1] * (grid.ndim - 1))
        return jnp.flip(grid, axis=0) * self.resolution + self.origin.reshape(trailing)

    def contains(self, voxel: Int[Array, "3 *N"]) -> Bool[Array, "*N"]:
        """Return whether each voxel (k, j, i) is in the box."""
        return contains(voxel, self.shape)

    def at(self, voxel: Int[Array, "3 *N"], outside: float = 0.0) -> Float[Array, "*N"]:
        """Return the log-odds of each voxel (k, j, i).

        Args:
            voxel: the voxels.
            outside: log-odds off the box; unknown by default.
        """
        found = self.log_odds.reshape(-1).at[flat_index(voxel, self.shape)].get(mode="clip")
        return jnp.where(self.contains(voxel), found, outside)


CERTAIN = 10.0
"""Log-odds of a voxel of a true world."""


def contains(voxel: Int[Array, "3 *N"], shape: Sequence[int]) -> Bool[Array, "*N"]:
    """Return whether each voxel (k, j, i) is in a box of a shape (D, H, W)."""
    limits = jnp.asarray(shape).reshape((3, *[1] * (voxel.ndim - 1)))
    return jnp.all((voxel >= 0) & (voxel < limits), axis=0)


def flat_index(voxel: Int[Array, "3 *N"], shape: Sequence[int]) -> Int[Array, "*N"]:
    """Return the indices of voxels (k, j, i) in a flattened array (D, H, W).

    A voxel off the array has the index of another one, or none.
    """
    _, height, width = shape
    index: Array = (voxel[0] * height + voxel[1]) * width + voxel[2]
    return index
