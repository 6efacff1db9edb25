"""Areas that a robot must not enter, and in which it looks for nothing."""

from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._limits import MOST_NAMES
from jaxplore._trees import with_field
from jaxplore._types import GridMask, Position, Rows, Scalar
from jaxplore.belief.part import Part
from jaxplore.geometry.outlines import Outlines, nearest
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD, OccupancyGrid
from jaxplore.parts.anomalies.reports import cell_centres

CORNER = 0.5**0.5
"""Distance of a corner of a cell from its centre, as a share of its side."""


class KeepOut(Part):
    """Areas that the robot must not enter: polygons, or the occupied cells of a mask.

    A cell is closed if its centre is within half a diagonal of a polygon, so every cell that a
    polygon touches is closed, or if its centre is in an occupied cell of the mask. Paths keep from
    closed cells the clearance that they keep from walls. The robot sees through closed cells and
    maps what it sees there, but what is unknown there has no information.

    A mask is that of nav2's keep-out filter: 100, occupied, where the robot must not be.

    Args:
        areas: corners (V_n, 2) of each polygon in order, without repeating the first [m].
        mask: map whose occupied cells are closed, in the frame of the robot's map; none when
            absent.

    Raises:
        ValueError: neither areas nor a mask, a polygon with fewer than three corners or with
            corners on one line, too many polygons.
    """

    name: ClassVar[str] = "keep_out"
    is_revisiting: ClassVar[bool] = False

    outlines: Outlines
    mask: OccupancyGrid | None
    is_placed: bool = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(self, areas: Sequence[Rows] = (), mask: OccupancyGrid | None = None) -> None:
        _kinds.instance("areas", areas, list, tuple, np.ndarray)
        _checks.whole_number("number of areas", len(areas), at_least=0, at_most=MOST_NAMES)
        if mask is None and not len(areas):
            raise ValueError("areas is empty without a mask; accepted: polygons, or a mask")
        self.outlines, self.mask = Outlines.polygons(areas, named="areas"), mask
        self.is_placed = True

    def init(self, grid: OccupancyGrid) -> GridMask:
        """Return the closed cells (H, W) of a map."""
        if not self.is_placed:
            return jnp.zeros(grid.shape, bool)
        return self._close(grid, cell_centres(grid))

    def unplaced(self) -> "KeepOut":
        """Return areas that close nothing before they are located."""
        return with_field(self, "is_placed", False)

    def locate(self, own: GridMask, grid: OccupancyGrid, origin: Position) -> GridMask:
        """Return the closed cells (H, W) of a map whose coordinates begin at `origin`."""
        return self._close(grid, cell_centres(grid) + origin)

    def _close(self, grid: OccupancyGrid, centres: Float[Array, "H W 2"]) -> GridMask:
        """Return the closed cells (H, W), whose centres are in the coordinates of the areas."""
        reach = CORNER * grid.resolution

        def close(so_far: GridMask, area: tuple[Array, Scalar]) -> tuple[GridMask, None]:
            def away(place: Array) -> Scalar:
                return nearest(*area, place[0], place[1]).distance

            return so_far | (jax.vmap(jax.vmap(away))(centres) <= reach), None

        closed = jnp.zeros(grid.shape, bool)
        if self.outlines.number:
            shapes = (self.outlines.corners, self.outlines.radii)
            closed, _ = jax.lax.scan(close, closed, shapes)
        if self.mask is None:
            return closed
        cells = self.mask.frame.to_cell(centres)
        is_masked = self.mask.contains(cells) & (self.mask.at_cell(cells) > OCCUPIED_THRESHOLD)
        return closed | is_masked

    def closed_cells(self, own: GridMask) -> GridMask:
        """Return the closed cells (H, W)."""
        return own

    def merge(self, own: GridMask, told: Bool[Array, "N H W"], is_heard: Array) -> GridMask:
        """Return the closed cells, which are the same for all robots."""
        return own
