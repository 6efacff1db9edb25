"""What stands on the floor of a generated map, and the room that is left around it."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from jaxplore.maps.generators.office import ROBOT_RADIUS

Mask = NDArray[np.bool_]


def between(easy: float, hard: float, difficulty: float) -> float:
    """Return what is `easy` at difficulty 0 and `hard` at 1."""
    return easy + (hard - easy) * difficulty


def wall_cells(resolution: float) -> int:
    """Return the thickness of a wall, about 0.15 m [cells]."""
    return max(1, math.floor(0.15 / resolution + 0.5 + 1e-9))


def clearance_cells(radius: float, resolution: float) -> float:
    """Return how far the centre of an occupied cell is from that of a disc, at least [cells].

    A cell's nearest point may be half a diagonal nearer than its centre.
    """
    return radius / resolution + math.sqrt(0.5)


def passage_cells(breadth: float, resolution: float) -> int:
    """Return the number of cells across a passage [m] that also lets the robot through."""
    # Rounding leaves out a cell only where it is less than a quarter of one.
    wanted = math.ceil(breadth / resolution - 0.25)
    return max(wanted, 2 * math.ceil(clearance_cells(ROBOT_RADIUS, resolution)) - 1)


def widest_part(free: Mask, radius: float, resolution: float) -> Mask:
    """Return the cells that a disc sweeps where it has the most room to move.

    Every way through them is at least as wide as the disc.
    """
    reach = clearance_cells(radius, resolution)
    pieces, count = ndimage.label(ndimage.distance_transform_edt(np.pad(free, 1)) >= reach)
    if not count:
        return np.zeros_like(free)
    sizes = np.bincount(pieces.ravel())
    largest = int(sizes[1:].argmax()) + 1
    swept: Mask = ndimage.distance_transform_edt(pieces != largest)[1:-1, 1:-1] < reach
    return swept


def disc(diameter: float, resolution: float) -> Mask:
    """Return the cells of a disc [m], at least one."""
    return block(diameter, diameter, 0.0, resolution, is_round=True)


def block(
    length: float, breadth: float, yaw: float, resolution: float, *, is_round: bool = False
) -> Mask:
    """Return the cells of a rectangle of two sides [m], turned by a yaw [rad], or of an ellipse."""
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
    inside[rows // 2, columns // 2] = True
    return inside


class Clutter:
    """Pieces on a floor, each with a passage between it and every other.

    Pieces without holes that are farther from each other than the robot is wide never cut it off:
    it can go round each of them.

    Args:
        occupied: (H, W), what stands on the floor; `put` adds to it.
        passage: between a piece and the next [m].
        resolution: side of a cell [m].
        is_apart: whether pieces also keep that far from what was there before.
    """

    def __init__(
        self, occupied: Mask, passage: float, resolution: float, *, is_apart: bool
    ) -> None:
        self.occupied = occupied
        # Half-way between two pieces runs a line, and the centres of the cells it crosses are at
        # most half a diagonal away from it: the robot finds its way from cell to cell.
        least = 2 * (clearance_cells(ROBOT_RADIUS, resolution) + math.sqrt(0.5))
        self.passage = max(passage_cells(passage, resolution), math.ceil(least))
        self.resolution = resolution
        self.taken = np.zeros_like(occupied)
        if is_apart:
            self.taken = ndimage.distance_transform_edt(~occupied) <= self.passage

    def put(self, piece: Mask, row: int, column: int) -> bool:
        """Put a piece with its first cell at a row and column, if there is room for it."""
        height, width = piece.shape
        if not (0 <= row <= self.taken.shape[0] - height):
            return False
        if not (0 <= column <= self.taken.shape[1] - width):
            return False
        here = slice(row, row + height), slice(column, column + width)
        if (self.taken[here] & piece).any():
            return False
        self.occupied[here] |= piece
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
        """Put pieces at random places until they cover a share of the floor, or find no room."""
        wanted = share * float(np.count_nonzero(~self.occupied))
        # Enough for each place where a small piece could stand to come up a few times.
        tries = math.ceil(8 * self.taken.size * self.resolution**2)
        rows, columns = self.taken.shape
        for _ in range(tries):
            if wanted <= 0:
                break
            piece = draw(rng)
            middle = int(rng.integers(rows)), int(rng.integers(columns))
            if self.put(piece, middle[0] - piece.shape[0] // 2, middle[1] - piece.shape[1] // 2):
                wanted -= np.count_nonzero(piece)
