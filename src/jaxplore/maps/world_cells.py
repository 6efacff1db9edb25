"""The cells of a world: those that its shapes cover, and what must lie on them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from jaxplore.maps.files.world_entries import SHAPES, MovingObstacle, Row, touches_solid
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.hills import is_on_map
from jaxplore.maps.rasterise import TOLERANCE, cell_at, disc_mask, rectangle_mask, segment_mask
from jaxplore.maps.resample import CELL_LIMIT, SLIVER
from jaxplore.maps.shapes import Shapes

Cells = NDArray[np.bool_]


@dataclass(frozen=True)
class WorldCells:
    """The cells of a world.

    `size` is the width (x) and the height (y) of the map, `origin` its lower corner (x, y), and
    `wall_reach` half the thickness of a wall [m]. Each check raises a `ValueError` of one line that
    names the entry.
    """

    size: tuple[float, float]
    origin: tuple[float, float]
    resolution: float
    wall_reach: float

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        rows, columns = map_shape(self.size, self.resolution)
        return int(rows), int(columns)

    @property
    def extent(self) -> str:
        """The ranges of x and y on the map [m], for messages."""
        (x, y), (width, height) = self.origin, self.size
        return f"[{x:.10g}, {x + width:.10g}) x [{y:.10g}, {y + height:.10g})"

    @cached_property
    def _frame(self) -> GridFrame:
        """The frame relative to the lower corner: a frame keeps its origin in single precision."""
        return GridFrame(self.resolution)

    def rasterise(self, kind: str, rows: tuple[Row, ...]) -> Cells:
        """Return the mask (H, W) of the cells that shapes of one kind cover.

        A kind is walls, rectangles, discs or zones. A cell belongs to a zone if its centre does.
        """
        frame, shape, corner = self._frame, self.shape, np.array(self.origin)
        if kind == "discs":
            return disc_mask([(*(row[:2] - corner).tolist(), row[2]) for row in rows], frame, shape)
        local = np.reshape(rows, (-1, 4)) - np.tile(corner, 2)
        if kind == "walls":
            return segment_mask(local, frame, shape, self.wall_reach)
        return rectangle_mask(local, frame, shape, is_solid=kind != "zones")

    def solid(self, shapes: Shapes) -> Cells:
        """Return the mask (H, W) of the cells that obstacles cover."""
        mask = np.zeros(self.shape, bool)
        for kind in SHAPES:
            mask |= self.rasterise(kind, getattr(shapes, kind))
        return mask

    def rasterise_obstacles(self, shapes: Shapes, prefix: str = "") -> Cells:
        """Return the cells that obstacles cover, each of them at least one.

        In messages `prefix` stands before the name of their entry.
        """
        solid = np.zeros(self.shape, bool)
        for kind in SHAPES:
            for index, row in enumerate(getattr(shapes, kind)):
                # One shape at a time, so that the message can name the one that is off the map.
                mask = self.rasterise(kind, (row,))
                if not mask.any():
                    raise ValueError(
                        f"{prefix}{kind}[{index}] is {list(row)}, off the map; accepted: something "
                        f"with a cell on the map, {self.extent}"
                    )
                solid |= mask
        return solid

    def check_resolution(self, *, has_walls: bool) -> None:
        """Refuse more cells than an array holds, and walls thinner than a cell."""
        width, height = (max(1.0, side / self.resolution) for side in self.size)
        if not width * height <= CELL_LIMIT:
            raise ValueError(
                f"resolution is {self.resolution}; accepted: at most {CELL_LIMIT} cells on "
                f"{self.size[0]} m x {self.size[1]} m"
            )
        # With at least half a cell, every column that a wall crosses has a centre within reach.
        if has_walls and self.wall_reach + TOLERANCE < self.resolution / 2:
            raise ValueError(
                f"wall_reach is {self.wall_reach}; accepted: at least {self.resolution / 2}, half "
                "the resolution, so that walls have no gaps"
            )

    def check_zones(self, zones: tuple[Row, ...]) -> None:
        """Refuse a zone that leaves the map, or holds no centre of a cell."""
        (x, y), (width, height) = self.origin, self.size
        # Maxima change their sign, so that one comparison tests all four sides.
        bounds = np.array([x, y, -x - width, -y - height])
        # Far from the origin, the sums are rounded more than that.
        bounds -= np.maximum(TOLERANCE, 4.0 * np.spacing(np.abs(bounds)))
        for index, zone in enumerate(zones):
            if (np.array(zone) * [1, 1, -1, -1] < bounds).any():
                raise ValueError(
                    f"zones[{index}] is {list(zone)}; accepted: a rectangle on the map, "
                    f"{self.extent}"
                )
            if not self.rasterise("zones", (zone,)).any():
                raise ValueError(
                    f"zones[{index}] is {list(zone)}; accepted: a rectangle with the centre of a "
                    f"cell of {self.resolution} m in it"
                )

    def check_place(self, name: str, place: Row, solid: Cells) -> None:
        """Refuse a place (x, y, ...) off the map or in a solid cell."""
        x, y = (place[axis] - self.origin[axis] for axis in (0, 1))
        if not (0.0 <= x < self.size[0] and 0.0 <= y < self.size[1]):
            raise ValueError(
                f"{name} is {list(place)}; accepted: a point on the map, {self.extent}"
            )
        # A point within rounding of the far edge belongs to the cell beyond: clip it to the map.
        row, column = cell_at((x, y), self._frame)
        if solid[min(row, solid.shape[0] - 1), min(column, solid.shape[1] - 1)]:
            raise ValueError(
                f"{name} is {list(place)}, in something solid; accepted: a point in a cell that is "
                "free in the true world"
            )

    def check_hills(self, hills: tuple[Row, ...]) -> None:
        """Refuse a hill without the centre of a cell within its radius."""
        for index, hill in enumerate(hills):
            if not is_on_map(hill, self.shape, self.resolution, self.origin):
                raise ValueError(
                    f"hills[{index}] is {list(hill)}; accepted: a hill with the centre of a cell "
                    f"of the map within its radius, {self.extent}"
                )

    def check_path(self, name: str, mover: MovingObstacle, solid: Cells) -> None:
        """Refuse a moving obstacle that would touch a solid cell on its closed path."""
        for index, point in enumerate(mover.path):
            self.check_place(f"{name}[{index}]", point, solid)
        local = np.array(mover.path) - self.origin
        # The path is closed, so the last segment leads back to the first point.
        for index, ends in enumerate(np.stack([local, np.roll(local, -1, axis=0)], axis=1)):
            if touches_solid(solid, ends, mover.radius, self.resolution):
                following = (index + 1) % len(mover.path)
                raise ValueError(
                    f"{name}[{index}] is {list(mover.path[index])}, and on the way to "
                    f"{name}[{following}] the disc touches something solid; accepted: a path with "
                    f"nothing solid within the radius, {mover.radius} m"
                )


def map_shape(size: tuple[float, float], resolution: float) -> tuple[float, float]:
    """Return the rows and columns of a map by its width (x) and height (y) [m].

    They are whole numbers, which may be too large for an array.
    """
    width, height = (float(np.maximum(1.0, np.ceil(side / resolution - SLIVER))) for side in size)
    return height, width
