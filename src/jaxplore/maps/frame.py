"""Convert between world points, grid coordinates and cells."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Pose, Position, Vector
from jaxplore._xla import on_device

PRECISION = 0.02
"""Greatest distance between neighbouring numbers in single precision at the origin of a grid, as a
share of a cell."""


class GridFrame(eqx.Module):
    """Pose and cell size of a regular grid.

    *Grid coordinates* (row, column) are a world point in the axes of the grid, divided by the
    resolution. Cell `(row, column)` covers `[row, row + 1) x [column, column + 1)`, and its centre
    is at `(row + 1/2, column + 1/2)`. A cell is found by rounding down: truncation would map the
    interval (-1, 0) onto cell 0.

    `map_shape` is the number of rows and columns that are on the map, for arrays that are padded
    (`OccupancyGrid.pad`); None if all are.

    Args:
        resolution: side of a cell [m]; static, because the number of cells that a beam can cross
            depends on it.
        origin: pose (x, y, yaw) of the outer corner of cell (0, 0) [m, m, rad].

    Raises:
        ValueError: a resolution that is not a positive number; an origin that is not three finite
            numbers, or so far away that single precision does not resolve a fiftieth of a cell:
            beyond 16 km for cells of 0.05 m. `jaxplore.maps.Datum` is for such maps.
    """

    origin: Pose
    resolution: float = eqx.field(static=True)
    map_shape: Int[Array | np.ndarray, "2"] | None

    def __init__(self, resolution: float, origin: Vector = (0.0, 0.0, 0.0)) -> None:
        self.resolution = _checks.number("resolution", resolution, above=0.0)
        self.origin = _checks.vector("origin", origin, 3)
        if not _kinds.is_traced(self.origin):
            _checks.near("origin", np.asarray(self.origin)[:2], PRECISION * self.resolution)
        self.map_shape = None

    def pad(self, map_shape: tuple[int, int]) -> "GridFrame":
        """Return the frame of larger arrays with `map_shape` rows and columns on the map."""
        return self._of_map(on_device(np.asarray(map_shape, np.int32)))

    def crop(self, values: ArrayLike) -> np.ndarray:
        """Return the rows and columns of an array (H, W, ...) that are on the map, in NumPy."""
        array = np.asarray(values)
        if array.ndim < 2 or array.dtype.kind in "OUS":
            raise ValueError(
                f"values is {_kinds.describe(values)}; accepted: an array with rows and columns"
            )
        if self.map_shape is None:
            return array
        rows, columns = np.asarray(self.map_shape).tolist()
        return array[:rows, :columns]

    def to_grid(self, points: Float[Array, "*N 2"]) -> Float[Array, "*N 2"]:
        """Convert world points (x, y) [m] to grid coordinates (row, column) [cells]."""
        x, y = jnp.unstack(points - self.origin[:2], axis=-1)
        cos, sin = jnp.cos(self.origin[2]), jnp.sin(self.origin[2])
        return jnp.stack([cos * y - sin * x, cos * x + sin * y], axis=-1) / self.resolution

    def to_cell(self, points: Float[Array, "*N 2"]) -> Int[Array, "*N 2"]:
        """Return the cell (row, column) that contains each world point (x, y) [m].

        The cell may be off the map; that of a point that is not finite is.
        """
        grid = self.to_grid(points)
        # Converting NaN to an integer is undefined: it depends on the machine.
        return jnp.floor(jnp.where(jnp.isfinite(grid), grid, -1.0)).astype(jnp.int32)

    def to_world(self, grid: Float[Array, "*N 2"]) -> Float[Array, "*N 2"]:
        """Convert grid coordinates (row, column) [cells] to world points (x, y) [m]."""
        y, x = grid[..., 0] * self.resolution, grid[..., 1] * self.resolution
        cos, sin = jnp.cos(self.origin[2]), jnp.sin(self.origin[2])
        return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1) + self.origin[:2]

    def cell_centre(self, cell: Int[Array, "*N 2"]) -> Float[Array, "*N 2"]:
        """Return the world position (x, y) [m] of the centre of each cell (row, column)."""
        return self.to_world(cell.astype(jnp.float32) + 0.5)

    def distances(self, point: Position, shape: tuple[int, ...]) -> Float[Array, "rows columns"]:
        """Return the distance of a world point from each cell's centre [m]; `shape` is static."""
        # Rows and columns apart: an array of the positions of all cells takes longer to make and to
        # read than all else that is done with the distances.
        along = [
            (jnp.arange(size, dtype=jnp.float32) + 0.5 - at) ** 2
            for size, at in zip(shape, jnp.unstack(self.to_grid(point)), strict=True)
        ]
        return self.resolution * jnp.sqrt(along[0][:, None] + along[1])

    def coarsen(
        self, stride: int, node: float, first: Int[Array, "2"] | None = None
    ) -> "GridFrame":
        """Return the frame of a coarser lattice with one node every `stride` cells.

        Node (i, j), the centre of cell (i, j) of the new frame, is at the grid coordinates `first +
        (i * stride + node, j * stride + node)` of this frame. `first` is (0, 0) when None; with it
        the lattice has no `map_shape`.
        """
        # The new frame's origin is the outer corner of its first cell, half a stride before node 0.
        corner = jnp.full(2, node - stride / 2.0)
        if first is not None:
            corner = corner + first.astype(jnp.float32)
        origin = jnp.concatenate([self.to_world(corner), self.origin[2:]])
        coarse = GridFrame(self.resolution * stride, origin)
        if self.map_shape is None or first is not None:
            return coarse
        return coarse._of_map(-(-self.map_shape // stride))

    def _of_map(self, map_shape: Int[Array | np.ndarray, "2"]) -> "GridFrame":
        same: GridFrame = eqx.tree_at(
            lambda frame: frame.map_shape, self, map_shape, is_leaf=lambda leaf: leaf is None
        )
        return same
