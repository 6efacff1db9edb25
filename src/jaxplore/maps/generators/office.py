"""Generate an office floor, for examples, tests and benchmarks."""

import math

import numpy as np
from numpy.typing import NDArray

from jaxplore import _checks, _kinds
from jaxplore._limits import DEEPEST_OFFICE
from jaxplore.maps.generators._clutter import DOOR_CLEARANCE, ROBOT_RADIUS, wall_cells
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.resample import CELL_LIMIT

START_CLEARANCE = 0.5
"""Least distance from the walls at the start pose [m]."""

_AISLE = 0.8
"""Least passage between two pieces of furniture [m]."""
# Furniture: kind, sides [m], least area of a room for it [m^2], whether it stands at a wall.
_FURNITURE = (
    ("table", (1.8, 1.0), 16.0, False),
    ("pillar", (0.5, 0.5), 13.0, False),
    ("desk", (1.5, 0.7), 8.0, True),
    ("desk", (1.5, 0.7), 8.0, True),
    ("cabinet", (1.1, 0.4), 7.0, True),
    ("desk", (1.4, 0.7), 14.0, True),
    ("cabinet", (0.9, 0.4), 14.0, True),
    ("table", (1.0, 1.0), 22.0, False),
    ("shelf", (2.0, 0.4), 18.0, True),
)

Box = tuple[int, int, int, int]
"""Cells [bottom, top) x [left, right)."""


def office(
    seed: int = 0, *, width: float = 20.0, height: float = 14.0, resolution: float = 0.1
) -> OccupancyGrid:
    """Generate an office floor: a corridor from west to east with rooms to its north and south.

    The corridor is empty and about 2 m wide. Rooms are 2.8 to 5 m wide. Each has a door of about
    1 m to the corridor, some have a second one to the next room, and they hold desks, cabinets,
    tables and pillars as their size allows. Walls are 0.1 to 0.2 m thick. All places in which a
    disc robot of radius `ROBOT_RADIUS` fits are connected for it: furniture that would cut one off
    is left out. Equal arguments give equal floors.

    Args:
        seed: seed of the floor plan; a whole number >= 0.
        width: extent along x [m]; at least 8.
        height: extent along y [m]; at least 7.
        resolution: side of a cell [m]; at most 0.2, so that doors and walls keep their sizes.

    Returns:
        Grid with probability 0 (free) or 1 (occupied), (height / resolution, width / resolution),
        and its origin at (0, 0, 0). `start_pose` gives a pose to start from.

    Raises:
        ValueError: a seed, size or resolution that is not accepted, more than 64 million cells, or
            rooms that are too deep to furnish.
    """
    number = _checks.whole_number("seed", seed, at_least=0)
    width = _checks.number("width", width, at_least=8.0)
    height = _checks.number("height", height, at_least=7.0)
    resolution = _checks.number("resolution", resolution, above=0.0, at_most=0.2)
    if (width / resolution) * (height / resolution) > CELL_LIMIT:
        raise ValueError(
            f"resolution is {resolution}; accepted: at most {CELL_LIMIT} cells on "
            f"{width} m x {height} m"
        )
    if (width / resolution) * (height / resolution) * height > DEEPEST_OFFICE:
        raise ValueError(
            f"height is {height} m beside a width of {width} m and cells of {resolution} m; "
            f"accepted: at most {DEEPEST_OFFICE:g} cells times height"
        )
    rng = np.random.default_rng(number)
    occupied = np.zeros((round(height / resolution), round(width / resolution)), bool)
    wall = wall_cells(resolution)
    # Writing through the transposed view closes the other two sides.
    for edge in (occupied, occupied.T):
        edge[:wall] = edge[-wall:] = True

    breadth = rng.uniform(1.8, 2.2)
    south = (height - breadth) / 2 + rng.uniform(-0.06, 0.06) * (height - breadth)
    bottom = round(south / resolution)
    top = bottom + math.ceil(breadth / resolution)
    for low, high, inner in (
        (wall, bottom - wall, slice(bottom - wall, bottom)),
        (top + wall, occupied.shape[0] - wall, slice(top, top + wall)),
    ):
        occupied[inner] = True
        rooms = _partition(rng, occupied, low, high, wall, resolution)
        keep_clear = _cut_doors(rng, occupied, rooms, inner, resolution)
        for room in rooms:
            _furnish(rng, occupied, keep_clear, room, wall, resolution)
    return OccupancyGrid(occupied.astype(np.float32), resolution)


@_kinds.check_arguments
def start_pose(grid: OccupancyGrid) -> tuple[float, float, float]:
    """Return a pose (x, y, yaw) at the west end of the corridor, heading along it [m, m, rad].

    It works on any grid. Among the rows with the longest run of free cells, the middle row of the
    broadest band is chosen, and in it the first cell of the run with a clearance of at least
    `START_CLEARANCE`. If the run has no such cell, only runs that have one are considered. The yaw
    is that of the grid.

    Raises:
        ValueError: a grid without a cell of that clearance.
    """
    from scipy import ndimage  # slow to import, and few need it

    free = np.asarray(grid.is_free)
    position = np.arange(1, free.shape[1] + 1)
    # The last blocked cell up to each cell, counted from 1, gives the free run that ends there.
    blocked_at = np.maximum.accumulate(np.where(free, 0, position), axis=1)
    run = position - blocked_at
    row, last = _middle_longest(run)
    # The transform measures between cell centres; the face of a cell is half a cell nearer.
    distance = (ndimage.distance_transform_edt(np.pad(free, 1)) - 0.5) * grid.resolution
    is_wide = distance[1:-1, 1:-1] >= START_CLEARANCE
    if not is_wide.any():
        raise ValueError(
            f"this {free.shape[0]} x {free.shape[1]} map has no cell with {START_CLEARANCE} m of "
            "clearance; accepted: a map with a place for the robot, such as office()"
        )
    if not is_wide[row, last + 1 - run[row, last] : last + 1].any():
        wide_at = np.maximum.accumulate(np.where(is_wide, position, 0), axis=1)
        # Only runs in which the last wide cell is behind the last blocked one count.
        row, last = _middle_longest(np.where(wide_at > blocked_at, run, 0))
    first = last - int(run[row, last]) + 1
    wide = np.flatnonzero(is_wide[row, first : last + 1])
    x0, y0, yaw = np.asarray(grid.frame.origin, np.float64).tolist()
    x, y = (first + int(wide[0]) + 0.5) * grid.resolution, (row + 0.5) * grid.resolution
    cos, sin = math.cos(yaw), math.sin(yaw)
    return x0 + cos * x - sin * y, y0 + sin * x + cos * y, yaw


def _middle_longest(run: NDArray[np.int_]) -> tuple[int, int]:
    """Return the row and the last column of a longest run of free cells.

    `run` is the length (H, W) of the run that ends at each cell.
    """
    from scipy import ndimage  # slow to import, and few need it

    longest = run.max(axis=1)
    mask = longest == longest.max()
    # Aligned doorways make runs as long as the corridor, but in a narrow band of rows only.
    bands = ndimage.label(mask)[0]
    broadest = np.bincount(bands[mask]).argmax()
    rows = np.flatnonzero(bands == broadest)
    row = int(rows[rows.size // 2])
    return row, int(run[row].argmax())


def _partition(
    rng: np.random.Generator,
    occupied: NDArray[np.bool_],
    low: int,
    high: int,
    wall: int,
    resolution: float,
) -> list[Box]:
    """Build the walls between the rooms of one side and return the rooms, west to east."""
    left, right = wall, occupied.shape[1] - wall
    extent = (right - left) * resolution
    fewest, most = math.ceil(extent / 5.0), math.floor(extent / 3.0)
    count = int(rng.integers(fewest, max(fewest, min(most, fewest + round(extent / 16))) + 1))
    widths = []
    for after in range(count - 1, -1, -1):
        # The remaining extent must leave 3 to 5 m for each of the remaining rooms.
        widths.append(rng.uniform(max(3.0, extent - 5.0 * after), min(5.0, extent - 3.0 * after)))
        widths[-1] = widths[-1] if after else extent
        extent -= widths[-1]
    ends = left + np.rint(np.cumsum(rng.permutation(widths)) / resolution).astype(int)
    rooms = []
    for end in ends.tolist():
        end = right if end == ends[-1] else end - wall // 2
        rooms.append((low, high, left, end))
        left = end + wall
        occupied[low:high, end:left] = True
    return rooms


def _cut_doors(
    rng: np.random.Generator,
    occupied: NDArray[np.bool_],
    rooms: list[Box],
    inner: slice,
    resolution: float,
) -> NDArray[np.bool_]:
    """Open a door from each room to the corridor and some to the next room; return the mask (H, W)
    of the cells that furniture has to keep clear."""
    keep_clear = np.zeros_like(occupied)
    reach, margin = math.ceil(DOOR_CLEARANCE / resolution), math.ceil(0.3 / resolution)
    narrow = math.ceil(0.9 / resolution - 1e-9)
    broad = max(narrow, math.floor(1.1 / resolution + 1e-9))

    def choose_opening(low: int, high: int) -> slice:
        size = int(rng.integers(narrow, broad + 1))
        start = int(rng.integers(low + margin, max(low + margin, high - margin - size) + 1))
        return slice(start, start + size)

    def cut(rows: slice, columns: slice) -> None:
        occupied[rows, columns] = False
        grown = [slice(max(0, s.start - reach), s.stop + reach) for s in (rows, columns)]
        keep_clear[grown[0], grown[1]] = True

    for index, (low, high, left, right) in enumerate(rooms):
        cut(inner, choose_opening(left, right))
        if index + 1 < len(rooms) and rng.random() < 0.35:
            cut(choose_opening(low, high), slice(right, rooms[index + 1][2]))
    return keep_clear


def _furnish(
    rng: np.random.Generator,
    occupied: NDArray[np.bool_],
    keep_clear: NDArray[np.bool_],
    room: Box,
    wall: int,
    resolution: float,
) -> None:
    """Place furniture in a room, without cutting off a part of it for the robot."""
    low, high, left, right = room
    area = (high - low) * (right - left) * resolution**2
    aisle = math.ceil(_AISLE / resolution)
    pieces = np.zeros_like(occupied[low:high, left:right])
    # Large rooms are furnished from the list more than once.
    for kind, sides, smallest_room, at_wall in _FURNITURE * (1 + int(area // 40.0)):
        if area < smallest_room or rng.random() < 0.2:
            continue
        shape = [max(1, round(side / resolution)) for side in sides]
        # Try several places, and undo a piece that would cut off a part of the room.
        for _ in range(12):
            placed = _place(rng, shape, pieces.shape, aisle, at_wall)
            if placed is None:
                continue
            bottom, top, west, east = placed
            around = (
                slice(max(0, bottom - aisle), top + aisle),
                slice(max(0, west - aisle), east + aisle),
            )
            here = slice(low + bottom, low + top), slice(left + west, left + east)
            if keep_clear[here].any() or pieces[around].any():
                continue
            piece = _disc(top - bottom) if kind == "pillar" and rng.random() < 0.5 else True
            pieces[bottom:top, west:east] = piece
            occupied[here] |= pieces[bottom:top, west:east]
            if _is_connected(occupied, room, wall, resolution):
                break
            pieces[bottom:top, west:east] = False
            occupied[here] = False


def _place(
    rng: np.random.Generator,
    shape: list[int],
    room: tuple[int, ...],
    aisle: int,
    at_wall: bool,
) -> Box | None:
    """Draw a place in a room, at a wall or at least an aisle away from every wall, or None."""
    along_x = rng.random() < 0.5
    size = (shape[1], shape[0]) if along_x else (shape[0], shape[1])
    start = []
    for axis in (0, 1):
        slack = room[axis] - size[axis]
        # The long side lies along this wall. Along the other axis a corner is used rather than a
        # gap that is too narrow to pass.
        backs_onto_wall = along_x == (axis == 0)
        if at_wall and (backs_onto_wall or rng.random() < 0.5):
            start.append(int(rng.integers(2)) * slack)
        elif slack >= 2 * aisle:
            start.append(int(rng.integers(aisle, slack - aisle + 1)))
        else:
            return None
        if slack < aisle:
            return None
    return start[0], start[0] + size[0], start[1], start[1] + size[1]


def _disc(size: int) -> NDArray[np.bool_]:
    offset = np.arange(size) - (size - 1) / 2
    disc: NDArray[np.bool_] = np.add.outer(offset**2, offset**2) <= (size / 2) ** 2
    return disc


def _is_connected(occupied: NDArray[np.bool_], room: Box, wall: int, resolution: float) -> bool:
    """Return whether the cells in which the robot fits are connected in a room and its doorways."""
    from scipy import ndimage  # slow to import, and few need it

    low, high, left, right = room
    # Whether the robot fits into a doorway depends on what stands outside of the room, too.
    margin = math.ceil(ROBOT_RADIUS / resolution) + 2
    rows = slice(max(0, low - wall - margin), high + wall + margin)
    columns = slice(max(0, left - wall - margin), right + wall + margin)
    # The nearest point of a cell may be half a diagonal nearer than its centre.
    distance = ndimage.distance_transform_edt(~occupied[rows, columns]) - math.sqrt(0.5)
    fits = distance * resolution >= ROBOT_RADIUS
    inside = np.zeros_like(fits)
    inside[
        low - wall - rows.start : high + wall - rows.start,
        left - wall - columns.start : right + wall - columns.start,
    ] = True
    pieces: int = ndimage.label(fits & inside)[1]
    return pieces == 1
