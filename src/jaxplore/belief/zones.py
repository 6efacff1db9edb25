"""Measure how much of given zones is still unknown, and which cells a pose sees."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jaxtyping import Bool, Float, Int

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, GridMask, Position, Scalar
from jaxplore.geometry.rays import RayCells, traverse
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD, OccupancyGrid
from jaxplore.sensing.lidar import Lidar

Rectangles = ArrayLike | Sequence[Sequence[float]]
"""Rectangles written by hand: nested lists, tuples or an array."""


UNKNOWN = 0.5
"""Value of `entropy_proxy` above which a cell counts as unknown."""


def entropy_proxy(probability: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """Return `4 p (1 - p)`: 1 for an unknown cell, 0 for a certain one (quadrotor design notes).

    It is a lower bound of the entropy in bits, equal to it at p = 0, 1/2 and 1, without a
    logarithm.
    """
    return 4.0 * probability * (1.0 - probability)


@_kinds.check_arguments
def is_unknown(grid: OccupancyGrid, threshold: ArrayLike = UNKNOWN) -> GridMask:
    """Return the mask (H, W) of cells with `4 p (1 - p) > threshold`; see `unknown_fraction`."""
    bound = _checks.scalar("threshold", threshold, at_least=0.0, below=1.0)
    return entropy_proxy(grid.probability) > bound


def unknown_fraction(grid: OccupancyGrid, threshold: ArrayLike = UNKNOWN) -> Scalar:
    """Return the fraction of cells with `4 p (1 - p) > threshold`.

    The quadrotor design notes call a map explored when less than 5 % of it is unknown. At the
    default threshold a cell is unknown for p in (0.146, 0.854).

    Raises:
        ValueError: a threshold outside [0, 1).
    """
    # Off the map the probability is 1, where nothing is unknown.
    cells = is_unknown(grid, threshold)
    height, width = (jnp.asarray(side, jnp.float32) for side in grid.sides)
    return jnp.sum(cells, dtype=jnp.float32) / (height * width)


def visible(grid: OccupancyGrid, position: Position, heading: Scalar, lidar: Lidar) -> GridMask:
    """Return the mask (H, W) of the cells that are visible from a pose.

    A cell is visible if some beam enters it within the lidar's range and crosses no occupied cell
    before it: the face of a wall is visible, the cells behind it are not. Cells are traversed
    exactly, as in the field-of-view update of the quadrotor design notes. Nothing is visible from
    a pose that is off the map, in an occupied cell or not finite.

    Args:
        grid: occupancy grid of the robot.
        position: world position (x, y) [m].
        heading: world yaw [rad].
        lidar: sensor whose number of beams, range and field of view are used; its noise is not.
    """
    height, width = grid.shape
    length = lidar.max_range / grid.resolution
    is_finite = jnp.isfinite(position).all() & jnp.isfinite(heading)
    start = grid.frame.to_grid(jnp.where(is_finite, position, 0.0))
    here = grid.at_cell(jnp.floor(start).astype(jnp.int32))
    is_open = is_finite & (here <= OCCUPIED_THRESHOLD)  # off the map the probability is 1
    yaw = jnp.where(is_finite, heading, 0.0) - grid.frame.origin[2]
    angles = yaw + jnp.asarray(lidar.beam_angles)
    cells: RayCells = jax.vmap(lambda angle: traverse(start, angle, length))(angles)
    is_wall = cells.is_crossed & (grid.at_cell(cells.cell) > OCCUPIED_THRESHOLD)
    # The face of the first wall is visible, so a beam sees up to the entry of that cell.
    sight = jnp.where(is_wall, cells.entry, jnp.inf).min(axis=-1, keepdims=True)
    # `traverse` may add cells beyond the range, so the entry is compared with the range as well.
    is_seen = cells.is_crossed & (cells.entry <= sight) & (cells.entry < length) & is_open
    index = cells.cell[..., 0] * width + cells.cell[..., 1]
    # Cells that are not seen are scattered to an index out of bounds, which is dropped.
    index = jnp.where(is_seen & grid.contains(cells.cell), index, height * width)
    mask = jnp.zeros(height * width, bool).at[index.reshape(-1)].set(True, mode="drop")
    return mask.reshape(height, width)


class Zones(eqx.Module):
    """Z zones of a map that the robot has to explore.

    Args:
        member: mask (Z, H, W) of the cells that belong to each zone; zones may overlap.
    """

    member: Bool[Array, "Z H W"]

    def __check_init__(self) -> None:
        if not isinstance(self.member, (Array, np.ndarray)):
            raise ValueError(
                f"member is {_kinds.describe(self.member)}; accepted: an array (Z, H, W)"
            )

    @classmethod
    def from_rectangles(cls, rectangles: Rectangles, grid: OccupancyGrid) -> "Zones":
        """Build rectangular zones, aligned with the axes of the world.

        A cell belongs to a zone if its centre is in `[x_min, x_max) x [y_min, y_max)`. Two
        rectangles that share an edge share no cell, whatever the yaw of the grid.

        Args:
            rectangles: rectangles (Z, 4) as (x_min, y_min, x_max, y_max) in the world [m].
            grid: grid whose shape and frame are used; its probabilities are not read.

        Raises:
            ValueError: no rectangles, a rectangle that is not four finite numbers, a minimum that
                is not below its maximum, a rectangle without a cell of the grid.
        """
        # The numbers of traced rectangles are unknown, so neither they nor their cells are checked.
        bounds = rectangles if isinstance(rectangles, Tracer) else _check_rectangles(rectangles)
        height, width = grid.shape
        rows, columns = jnp.mgrid[:height, :width]
        centre = grid.frame.cell_centre(jnp.stack([rows, columns], axis=-1))
        corners = jnp.asarray(bounds, jnp.float32)[:, None, None]
        low, high = corners[..., :2], corners[..., 2:]
        member = ((centre >= low) & (centre < high)).all(axis=-1)
        if grid.is_on_map is not None:
            member = member & grid.is_on_map
        if not isinstance(member, Tracer):
            for row, has_cell in enumerate(np.asarray(member.any(axis=(1, 2)))):
                if not has_cell:
                    raise ValueError(
                        f"rectangles[{row}] is {bounds[row].tolist()}; "
                        "accepted: a rectangle with the centre of a cell of the grid in it"
                    )
        return cls(member)

    @property
    def num_cells(self) -> Int[Array, " Z"]:
        """Number of cells in each zone, (Z,)."""
        return self.member.sum(axis=(1, 2))

    def uncertainty(self, grid: OccupancyGrid) -> Float[Array, " Z"]:
        """Return the remaining uncertainty of each zone (Z,): the mean of `4 p (1 - p)`.

        It is 1 for an unknown and 0 for a known zone (quadrotor design notes).

        Raises:
            ValueError: a grid of another shape.
        """
        values = entropy_proxy(grid.probability)
        if grid.map_shape is not None:
            # The zones may be those of the map before it was padded.
            values = values[: self.member.shape[1], : self.member.shape[2]]
        return self._mean("grid", values)

    def centres(self, frame: GridFrame) -> Float[Array, "Z 2"]:
        """Return the mean position of each zone's cells, (Z, 2) as world (x, y) [m].

        Args:
            frame: frame of the grid.
        """
        _, height, width = self.member.shape
        count = jnp.maximum(self.num_cells, 1).astype(jnp.float32)[:, None]
        # Divide by the count first, so that sums stay as small as the coordinates.
        by_row = self.member.sum(axis=2).astype(jnp.float32) / count
        by_column = self.member.sum(axis=1).astype(jnp.float32) / count
        row = (by_row * (jnp.arange(height, dtype=jnp.float32) + 0.5)).sum(axis=1)
        column = (by_column * (jnp.arange(width, dtype=jnp.float32) + 0.5)).sum(axis=1)
        return frame.to_world(jnp.stack([row, column], axis=-1))

    def deplete(
        self, levels: Float[Array, " Z"], visible_cells: GridMask, rate: ArrayLike
    ) -> Float[Array, " Z"]:
        """Return the information levels of the zones after an observation: depletion by coverage.

            level <- level (1 - rate covered)

        with `covered` the share of the zone's cells that are visible. With rate 1, observing the
        whole zone depletes it. The levels are model states, one per zone, as in the quadrotor
        design notes; with a map that is updated, use `uncertainty` instead.

        Args:
            levels: information levels (Z,) before the observation.
            visible_cells: mask (H, W) of the visible cells, from `visible`.
            rate: share of the information that is taken from visible cells, in [0, 1].

        Raises:
            ValueError: a rate outside [0, 1], visible cells of another shape.
        """
        share = _checks.scalar("rate", rate, at_least=0.0, at_most=1.0)
        covered = self._mean("visible_cells", visible_cells.astype(jnp.float32))
        return levels * (1.0 - share * covered)

    def _mean(self, name: str, values: Float[Array, "H W"]) -> Float[Array, " Z"]:
        if values.shape != self.member.shape[1:]:
            raise ValueError(f"{name} has shape {values.shape}; accepted: {self.member.shape[1:]}")
        # A mask of the caller or a traced rectangle may give a zone without cells: avoid 0 / 0.
        total = jnp.where(self.member, values, 0.0).sum(axis=(1, 2))
        return total / jnp.maximum(self.num_cells, 1).astype(jnp.float32)


def _check_rectangles(rectangles: Rectangles) -> np.ndarray:
    accepted = "(Z, 4) finite numbers (x_min, y_min, x_max, y_max), min < max, Z >= 1"
    try:
        array = np.asarray(rectangles, np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"rectangles is {rectangles!r}; accepted: {accepted}") from None
    if array.ndim != 2 or array.shape[1] != 4 or array.shape[0] == 0:
        raise ValueError(f"rectangles has shape {array.shape}; accepted: {accepted}")
    for row, rectangle in enumerate(array):
        if not np.isfinite(rectangle).all() or not (rectangle[:2] < rectangle[2:]).all():
            raise ValueError(f"rectangles[{row}] is {rectangle.tolist()}; accepted: {accepted}")
    return array
