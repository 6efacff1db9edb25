"""Where the cells of a grid are in the world."""

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float, Int

from jaxplore import _checks
from jaxplore._types import Pose, Vector


class GridFrame(eqx.Module):
    """A regular grid's pose and cell size.

    A world point is turned into the grid's axes and divided by the resolution; cell `(row, column)`
    covers `[row, row + 1) x [column, column + 1)` of these *grid coordinates* and its centre is at
    `(row + 1/2, column + 1/2)`. Cells are found with floor, not truncation, which would map
    (-1, 0) onto cell 0.

    Args:
        resolution: side of a cell [m]; static, because the number of cells a beam can cross
            follows from it.
        origin: pose (x, y, yaw) of the outer corner of cell (0, 0) [m, m, rad].

    Raises:
        ValueError: a resolution that is not a positive number, an origin that is not three finite
            numbers.
    """

    origin: Pose
    resolution: float = eqx.field(static=True)

    def __init__(self, resolution: float, origin: Vector = (0.0, 0.0, 0.0)) -> None:
        self.resolution = _checks.number("resolution", resolution, above=0.0)
        self.origin = _checks.vector("origin", origin, 3)

    def to_grid(self, points: Float[Array, "*N 2"]) -> Float[Array, "*N 2"]:
        """Turn world points (x, y) [m] into grid coordinates (row, column) [cells]."""
        x, y = jnp.unstack(points - self.origin[:2], axis=-1)
        cos, sin = jnp.cos(self.origin[2]), jnp.sin(self.origin[2])
        return jnp.stack([cos * y - sin * x, cos * x + sin * y], axis=-1) / self.resolution

    def to_cell(self, points: Float[Array, "*N 2"]) -> Int[Array, "*N 2"]:
        """Return the cell (row, column) that holds each world point; it may lie off the map."""
        return jnp.floor(self.to_grid(points)).astype(jnp.int32)

    def to_world(self, grid: Float[Array, "*N 2"]) -> Float[Array, "*N 2"]:
        """Turn grid coordinates (row, column) [cells] into world points (x, y) [m]."""
        y, x = grid[..., 0] * self.resolution, grid[..., 1] * self.resolution
        cos, sin = jnp.cos(self.origin[2]), jnp.sin(self.origin[2])
        return jnp.stack([cos * x - sin * y, sin * x + cos * y], axis=-1) + self.origin[:2]

    def cell_centre(self, cell: Int[Array, "*N 2"]) -> Float[Array, "*N 2"]:
        """Return the world position (x, y) [m] of the centre of each cell (row, column)."""
        return self.to_world(cell.astype(jnp.float32) + 0.5)

    def coarsen(
        self, stride: int, node: float, first: Int[Array, "2"] | None = None
    ) -> "GridFrame":
        """Return the frame of a lattice with one node every `stride` cells.

        Node (i, j), the middle of that cell of the new frame, is at the grid coordinates
        `first + (i * stride + node, j * stride + node)` of this one; `first` is (0, 0) when absent.
        """
        corner = jnp.full(2, node - stride / 2.0)
        if first is not None:
            corner = corner + first.astype(jnp.float32)
        origin = jnp.concatenate([self.to_world(corner), self.origin[2:]])
        return GridFrame(self.resolution * stride, origin)
