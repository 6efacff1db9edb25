"""Describe a world: the true map, and the part of it that the robot knows beforehand."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from jaxplore import _files, _kinds, _text
from jaxplore._types import Rows, Vector
from jaxplore.maps.files.world_entries import (
    CHECKS,
    MOVER_ENTRIES,
    OBJECT_ENTRIES,
    OPTIONAL_LISTS,
    SHAPES,
    WORLD_ENTRIES,
    Row,
    check_entries,
    refuse_unknown,
    touches_solid,
)
from jaxplore.maps.files.world_entries import LabelledObject as LabelledObject
from jaxplore.maps.files.world_entries import MovingObstacle as MovingObstacle
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.rasterise import TOLERANCE, cell_at, disc_mask, rectangle_mask, segment_mask
from jaxplore.maps.resample import CELL_LIMIT, SLIVER
from jaxplore.maps.shapes import Shapes as Shapes
from jaxplore.maps.shapes import shape_lists, shapes_under

Values = NDArray[np.float64]
Cells = NDArray[np.bool_]
FREE_PROBABILITY = 0.01
"""Probability of a free cell (quadrotor design notes)."""
UNEXPECTED = ("hidden", "gone")
"""Entries with the shapes in which the true world differs from the prior map."""
UNKNOWN_PROBABILITY = 0.5
"""Prior probability of a cell in a zone."""
SOLID_PROBABILITY = 0.99
"""Probability of a solid cell (quadrotor design notes)."""


def hill_elevation(
    hills: Rows, shape: tuple[int, int], resolution: float, corner: Vector = (0.0, 0.0)
) -> Values:
    """Return the elevation (H, W) at the centre of each cell [m], the sum of hills

        z(d) = height cos^2(pi d / (2 radius))  for d < radius,  0 beyond

    with d the distance from the top of the hill. A hill is smooth and exactly 0 outside its radius.
    Its greatest slope is `|height| pi / (2 radius)`, half-way down. A negative height is a pit.

    Hills (N, 4) are finite numbers (x, y, height, radius) in the world [m], radius > 0; N may be 0.
    `corner` is the outer corner (x, y) of cell (0, 0) [m].
    """
    elevation = np.zeros(shape)
    for x, y, height, radius in np.reshape(np.asarray(hills, np.float64), (-1, 4)):
        gaps = _gaps((x, y), shape, resolution, corner)
        # Evaluate only the bounding box: hills are small compared with the map.
        rows, columns = (np.flatnonzero(np.abs(gap) < radius) for gap in gaps)
        share = np.hypot(gaps[0][rows, None], gaps[1][columns]) / radius
        rise = np.where(share < 1.0, height * np.cos(np.pi / 2 * share) ** 2, 0.0)
        elevation[np.ix_(rows, columns)] += rise
    return elevation


def is_on_map(
    hill: Vector, shape: tuple[int, int], resolution: float, corner: Vector = (0.0, 0.0)
) -> bool:
    """Return whether the centre of some cell is within a hill's radius; see `hill_elevation`."""
    x, y, _, radius = np.asarray(hill, np.float64)
    nearest = (np.abs(gap).min() for gap in _gaps((x, y), shape, resolution, corner))
    return bool(np.hypot(*nearest) < radius)


def _gaps(
    top: Vector, shape: tuple[int, int], resolution: float, corner: Vector
) -> tuple[Values, Values]:
    """Return the signed distances of rows (H,) and columns (W,) from the top along y and x [m]."""
    # Subtract the corner first, so that a world far from the origin gets exactly the same hills.
    x, y = np.asarray(top, np.float64) - np.asarray(corner, np.float64)
    rows, columns = ((np.arange(size) + 0.5) * resolution for size in shape)
    return rows - y, columns - x


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


@dataclass(frozen=True, kw_only=True)
class World:
    """True world and the robot's prior knowledge of it, as two maps with the same cells.

    Known obstacles are solid in both maps. Those that are gone are solid in the prior only, if no
    other obstacle has their cells. Zones are unknown in the prior. Hidden obstacles are
    solid in the true world only; in the prior their cells are free, or unknown inside a zone. A
    cell belongs to a shape if its centre does; `jaxplore.maps.rasterise` explains how shapes
    smaller than a cell are kept.

    Args:
        size: width (x) and height (y) of the map [m]; if they are not a whole number of cells, the
            last row and column reach beyond.
        start: start pose (x, y, yaw) of the robot [m, m, rad].
        goal: goal (x, y) or (x, y, z) [m], or None. The sign of z follows the robot's model.
        origin: lower corner (x, y) of the map [m].
        resolution: side of a cell [m].
        wall_reach: half the thickness of a wall [m].
        known: obstacles that are known beforehand.
        zones: rectangles (x_min, y_min, x_max, y_max) [m] that are unknown beforehand.
        hidden: obstacles that are not known beforehand.
        hills: hills (x, y, height, radius) [m], whose sum is the elevation; a negative height is a
            pit. See `jaxplore.maps.world.hill_elevation`.
        targets: points (x, y) [m] that the robot has to see.
        objects: objects other than the targets, each of a class, for a detector.
        movers: moving obstacles, discs on closed paths; they are in neither of the two maps.
        gone: obstacles of the prior map that are not there: free in the true world.
        forbidden: rectangles (x_min, y_min, x_max, y_max) in which nobody may be [m]. Whoever walks
            there is an anomaly.

    Raises:
        ValueError: one line that names the entry, such as `hidden.walls[2]`: numbers that are not
            finite or too few or many, a size or resolution that is not positive, more than 64
            million cells, a wall reach below half a cell (walls would have gaps), a shape without
            a cell on the map, a zone that leaves the map or holds no centre of a cell, a start,
            goal, target, object or point of a path that is off the map or in a cell that is solid
            in the true world, a hill whose radius is not positive or reaches no centre of a cell,
            heights that add up to more than 1000 km, a mover that `MovingObstacle` refuses or whose
            disc touches a solid cell of the true world on its way (it may reach beyond the map).
    """

    size: tuple[float, float]
    start: tuple[float, float, float]
    goal: tuple[float, float] | tuple[float, float, float] | None = None
    origin: tuple[float, float] = (0.0, 0.0)
    resolution: float = 0.1
    wall_reach: float = 0.2
    known: Shapes = field(default_factory=Shapes)
    zones: tuple[Row, ...] = ()
    hidden: Shapes = field(default_factory=Shapes)
    hills: tuple[Row, ...] = ()
    targets: tuple[Row, ...] = ()
    objects: tuple[LabelledObject, ...] = ()
    movers: tuple[MovingObstacle, ...] = ()
    gone: Shapes = field(default_factory=Shapes)
    forbidden: tuple[Row, ...] = ()

    def __post_init__(self) -> None:
        # The class is frozen, so checked values are written with `object.__setattr__`.
        for name in ("known", "hidden", "gone"):
            _kinds.instance(name, getattr(self, name), Shapes)
        for name in WORLD_ENTRIES:
            object.__setattr__(self, name, CHECKS[name](name, getattr(self, name)))
        cells = self._cells
        cells.check_resolution(has_walls=bool(self.known.walls or self.hidden.walls))
        cells.check_zones(self.zones)
        solid = cells.rasterise_obstacles(self.known) | cells.rasterise_obstacles(
            self.hidden, "hidden."
        )
        # What is gone must be on the map, too, and is free in the true world.
        cells.rasterise_obstacles(self.gone, "gone.")
        cells.check_place("start", self.start, solid)
        if self.goal is not None:
            cells.check_place("goal", self.goal, solid)
        cells.check_hills(self.hills)
        for index, target in enumerate(self.targets):
            cells.check_place(f"targets[{index}]", target, solid)
        for index, each in enumerate(self.objects):
            cells.check_place(f"objects[{index}]", each.position, solid)
        for index, mover in enumerate(self.movers):
            cells.check_path(f"movers[{index}].path", mover, solid)

    @classmethod
    def from_dict(cls, entries: Mapping[Any, Any]) -> "World":
        """Build a world from a mapping whose keys are the arguments of the class.

        `walls`, `rectangles` and `discs` at the top level are the known obstacles, those under
        `hidden` and `gone` the hidden ones and those that are gone. A mover is a mapping with
        `path`, `speed` and `radius`, an object one with `position` and `label`. `size` and `start`
        are required.

        Raises:
            ValueError: an unknown or missing entry, and what `World` raises.
        """
        refuse_unknown("", entries, (*WORLD_ENTRIES, *SHAPES, *UNEXPECTED))
        for key in ("size", "start"):
            if key not in entries:
                raise ValueError(f"{key} is missing; accepted: a world with size and start")
        unexpected: dict[str, Any] = {
            name: shapes_under(name, entries.get(name, {})) for name in UNEXPECTED
        }
        known = Shapes(**check_entries(entries, SHAPES))
        return cls(known=known, **unexpected, **check_entries(entries, WORLD_ENTRIES))

    @classmethod
    def from_yaml(cls, path: str | os.PathLike[str]) -> "World":
        """Read a world file: YAML with the entries of `from_dict`.

        Raises:
            ValueError: a file that is missing, unreadable, too large or no YAML mapping, and what
                `from_dict` raises; one line that names the file.
        """
        entries = _files.read_yaml(Path(path))
        try:
            return cls.from_dict(entries)
        except ValueError as error:
            raise ValueError(f"{_text.printable_path(Path(path))}: {error}") from None

    def to_dict(self) -> dict[str, object]:
        """Return a mapping from which `from_dict` builds this world again."""
        entries: dict[str, object] = {
            "origin": list(self.origin),
            "size": list(self.size),
            "resolution": self.resolution,
            "wall_reach": self.wall_reach,
            **shape_lists(self.known),
            "zones": [list(zone) for zone in self.zones],
            "hidden": shape_lists(self.hidden),
            "start": list(self.start),
        }
        if self.goal is not None:
            entries["goal"] = list(self.goal)
        if self.gone != Shapes():
            entries["gone"] = shape_lists(self.gone)
        # Empty lists are left out, so that a file lists only what its world has.
        extras = {kind: [_plain(row) for row in getattr(self, kind)] for kind in OPTIONAL_LISTS}
        return entries | {kind: rows for kind, rows in extras.items() if rows}

    def to_yaml(self, path: str | os.PathLike[str]) -> None:
        """Write a world file for `from_yaml`, completely or not at all.

        Raises:
            ValueError: a world that takes more YAML than `from_yaml` reads.
            OSError: the file cannot be written; an earlier file stays untouched.
        """
        # The width keeps each row of numbers on one line; by default YAML breaks lines at 80
        # characters.
        text = yaml.safe_dump(self.to_dict(), sort_keys=False, default_flow_style=None, width=2**31)
        if len(text) > _files.YAML_LIMIT:
            raise ValueError(
                f"the world takes {len(text)} bytes; accepted: at most {_files.YAML_LIMIT} of YAML"
            )
        _files.replace_files([(Path(path), text.encode())])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the map."""
        return self._cells.shape

    def truth(self) -> OccupancyGrid:
        """Return the true map: 0.99 in known and hidden obstacles, 0.01 elsewhere."""
        solid = self._cells.solid
        return self._paint((solid(self.known) | solid(self.hidden), SOLID_PROBABILITY))

    def prior(self) -> OccupancyGrid:
        """Return the robot's map at the start.

        It is 0.99 in known obstacles and those that are gone, else 0.5 in zones, else 0.01. Hidden
        obstacles are absent.
        """
        cells = self._cells
        return self._paint(
            # Later layers cover earlier ones: known obstacles inside a zone are known.
            (cells.rasterise("zones", self.zones), UNKNOWN_PROBABILITY),
            (cells.solid(self.known) | cells.solid(self.gone), SOLID_PROBABILITY),
        )

    def ground(self, **options: Any) -> Ground | None:
        """Return the ground, or None for a world without hills.

        Args:
            options: keyword arguments of `Ground`.
        """
        if not self.hills:
            return None
        elevation = hill_elevation(self.hills, self.shape, self.resolution, self.origin)
        return Ground(elevation, self.resolution, (*self.origin, 0.0), **options)

    @cached_property
    def _cells(self) -> WorldCells:
        return WorldCells(self.size, self.origin, self.resolution, self.wall_reach)

    def _paint(self, *layers: tuple[NDArray[np.bool_], float]) -> OccupancyGrid:
        probability = np.full(self.shape, FREE_PROBABILITY, np.float32)
        for mask, value in layers:
            probability[mask] = value
        return OccupancyGrid(probability, self.resolution, (*self.origin, 0.0))


def is_world_file(path: str | os.PathLike[str]) -> bool:
    """Return whether a YAML file describes a world, not a ROS map: it has a size and no image."""
    try:
        entries = _files.read_yaml(Path(path))
    except ValueError:
        return False
    return "size" in entries and "image" not in entries


def world_shape(entries: Mapping[Any, Any]) -> tuple[tuple[float, float], float]:
    """Return the rows and columns of a world, and its resolution [m], without building it.

    The entries are those of `World.from_dict`. A size or a resolution that `World` refuses raises a
    `ValueError`.
    """
    if "size" not in entries:
        raise ValueError("size is missing; accepted: a world with size and start")
    size = CHECKS["size"]("size", entries["size"])
    given = entries.get("resolution", World.resolution)
    resolution = float(CHECKS["resolution"]("resolution", given))
    return map_shape(size, resolution), resolution


def three_zones() -> World:
    """Build the world of the quadrotor design notes: seven walls and three unknown zones.

    It measures 14 m x 12 m from (-1, -1), with a goal 2 m above the ground (z down). The start is
    outside the zones, 1 m from the nearest wall.
    """
    return World(
        origin=(-1.0, -1.0),
        size=(14.0, 12.0),
        known=Shapes(
            walls=(
                (0.0, 2.0, 4.0, 2.0),
                (0.0, 8.0, 4.0, 8.0),
                (4.0, 2.0, 4.0, 0.0),
                (4.0, 8.0, 4.0, 10.0),
                (4.0, 0.0, 12.0, 0.0),
                (4.0, 10.0, 12.0, 10.0),
                (12.0, 0.0, 12.0, 10.0),
            )
        ),
        zones=((1.0, 4.0, 4.0, 8.0), (10.0, 4.0, 13.0, 8.0), (10.0, 1.0, 13.0, 3.0)),
        start=(0.8, 3.2, 0.0),
        goal=(9.0, 5.0, -2.0),
    )


def _plain(entry: Row | MovingObstacle | LabelledObject) -> object:
    if isinstance(entry, LabelledObject):
        row = (list(entry.position), entry.label)
        return dict(zip(OBJECT_ENTRIES, row, strict=True))
    if isinstance(entry, MovingObstacle):
        path = [list(point) for point in entry.path]
        return dict(zip(MOVER_ENTRIES, (path, entry.speed, entry.radius), strict=True))
    return list(entry)
