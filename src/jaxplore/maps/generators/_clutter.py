"""Place obstacles on a generated map so that the robot can pass between them."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Mask = NDArray[np.bool_]

ROBOT_RADIUS = 0.3
"""Radius of the disc robot for which a generated map is connected [m]."""
DOOR_CLEARANCE = 0.9
"""Distance from a door within which no furniture stands [m]."""


def interpolate(easy: float, hard: float, difficulty: float) -> float:
    """Interpolate linearly from `easy` at difficulty 0 to `hard` at difficulty 1."""
    return easy + (hard - easy) * difficulty


def wall_cells(resolution: float) -> int:
    """Return the thickness of a wall of about 0.15 m [cells]."""
    # Round half up. The margin is for 0.15 / 0.1, which is slightly less than 1.5 in binary.
    return max(1, math.floor(0.15 / resolution + 0.5 + 1e-9))


def clearance_cells(radius: float, resolution: float) -> float:
    """Return the least distance between cell centres at which a disc clears an occupied cell.

    It is in cells, and includes half a diagonal: the nearest point of a cell may be that much
    nearer than its centre.
    """
    return radius / resolution + math.sqrt(0.5)


def passage_cells(breadth: float, resolution: float) -> int:
    """Return the number of cells across a passage of a width [m] that the robot fits through."""
    # Round up, unless the remainder is less than a quarter of a cell. The robot fits where the
    # middle cell of an odd width is a clearance away from both walls.
    wanted = math.ceil(breadth / resolution - 0.25)
    return max(wanted, 2 * math.ceil(clearance_cells(ROBOT_RADIUS, resolution)) - 1)


def widest_part(free: Mask, radius: float, resolution: float) -> Mask:
    """Return the cells that a disc can sweep in the largest connected part of the free space.

    Every passage within them is at least as wide as the disc.
    """
    from scipy import ndimage  # slow to import, and few need it

    reach = clearance_cells(radius, resolution)
    # The padding makes the edge of the map a wall.
    pieces, count = ndimage.label(ndimage.distance_transform_edt(np.pad(free, 1)) >= reach)
    if not count:
        return np.zeros_like(free)
    sizes = np.bincount(pieces.ravel())
    largest = int(sizes[1:].argmax()) + 1
    swept: Mask = ndimage.distance_transform_edt(pieces != largest)[1:-1, 1:-1] < reach
    return swept


def disc(diameter: float, resolution: float) -> Mask:
    """Return the cells of a disc of a diameter [m], at least one cell."""
    return block(diameter, diameter, 0.0, resolution, is_round=True)


def block(
    length: float, breadth: float, yaw: float, resolution: float, *, is_round: bool = False
) -> Mask:
    """Return the cells of a rectangle with two sides [m] and a yaw [rad], or of an ellipse."""
    sides = np.maximum([length, breadth], resolution) / resolution
    cos, sin = math.cos(yaw), math.sin(yaw)
    extent = [abs(sin) * sides[0] + abs(cos) * sides[1], abs(cos) * sides[0] + abs(sin) * sides[1]]
    rows, columns = (max(1, round(side)) for side in extent)
    y = np.arange(rows)[:, None] - (rows - 1) / 2
    x = np.arange(columns)[None, :] - (columns - 1) / 2
    along, across = 2 * (cos * x + sin * y) / sides[0], 2 * (cos * y - sin * x) / sides[1]
    inside: Mask
    if is_round:
        inside = along**2 + across**2 <= 1.0
    else:
        inside = np.maximum(abs(along), abs(across)) <= 1.0 + 1e-9
    inside[rows // 2, columns // 2] = True  # a thin piece may contain no cell centre
    return inside


class Clutter:
    """Obstacles on a floor, with a passage between any two of them: without holes and farther apart
    than the robot is wide, they never cut off a part of the floor. `put` adds to `occupied` (H, W)
    in place, at least `passage` [m] apart; `is_apart` keeps this from what was occupied before,
    too."""

    def __init__(
        self, occupied: Mask, passage: float, resolution: float, *, is_apart: bool
    ) -> None:
        from scipy import ndimage  # slow to import, and few need it

        self.occupied = occupied
        # The robot moves from cell to cell along the line half-way between two obstacles. The cell
        # centres along it are at most half a diagonal off the line, which is added on both sides.
        least = 2 * (clearance_cells(ROBOT_RADIUS, resolution) + math.sqrt(0.5))
        self.passage = max(passage_cells(passage, resolution), math.ceil(least))
        self.resolution = resolution
        self.taken = np.zeros_like(occupied)
        if is_apart:
            self.taken = ndimage.distance_transform_edt(~occupied) <= self.passage

    def put(self, piece: Mask, row: int, column: int) -> bool:
        """Place an obstacle with its first cell at a row and column; return whether it fits."""
        from scipy import ndimage  # slow to import, and few need it

        height, width = piece.shape
        if not (0 <= row <= self.taken.shape[0] - height):
            return False
        if not (0 <= column <= self.taken.shape[1] - width):
            return False
        here = slice(row, row + height), slice(column, column + width)
        if (self.taken[here] & piece).any():
            return False
        self.occupied[here] |= piece
        # Reserve the passage around the new obstacle, within the map.
        reach = self.passage
        near = ndimage.distance_transform_edt(~np.pad(piece, reach)) <= reach
        first = max(0, row - reach), max(0, column - reach)
        around = self.taken[first[0] : row + height + reach, first[1] : column + width + reach]
        skipped = first[0] - row + reach, first[1] - column + reach
        around |= near[skipped[0] :, skipped[1] :][: around.shape[0], : around.shape[1]]
        return True

    def scatter(
        self,
        rng: np.random.Generator,
        draw: Callable[[np.random.Generator], Mask],
        share: float,
    ) -> None:
        """Place random obstacles until they cover a share of the free cells or no more fit."""
        wanted = share * float(np.count_nonzero(~self.occupied))
        # Enough tries that each place for a small obstacle is drawn a few times.
        tries = math.ceil(8 * self.taken.size * self.resolution**2)
        rows, columns = self.taken.shape
        for _ in range(tries):
            if wanted <= 0:
                break
            piece = draw(rng)
            middle = int(rng.integers(rows)), int(rng.integers(columns))
            if self.put(piece, middle[0] - piece.shape[0] // 2, middle[1] - piece.shape[1] // 2):
                wanted -= np.count_nonzero(piece)
