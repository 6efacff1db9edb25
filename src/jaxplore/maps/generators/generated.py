"""Generate maps of several kinds from a seed, for examples, tests and benchmarks."""

import math
from collections.abc import Callable

import numpy as np

from jaxplore import _checks
from jaxplore.maps.generators._cave import cave
from jaxplore.maps.generators._clutter import (
    ROBOT_RADIUS,
    Clutter,
    Mask,
    block,
    clearance_cells,
    interpolate,
    wall_cells,
)
from jaxplore.maps.generators._hall import hall, open_ground
from jaxplore.maps.generators._maze import maze
from jaxplore.maps.generators._rooms import rooms
from jaxplore.maps.generators._warehouse import warehouse
from jaxplore.maps.generators.office import office
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.resample import CELL_LIMIT

KINDS = ("rooms", "office", "maze", "cave", "warehouse", "hall", "open")
"""Kinds of maps that `generate_map` can draw.

The position of a kind is part of its seed, so new kinds are added at the end."""

_SIZES = {
    "rooms": (18.0, 14.0),
    "office": (20.0, 14.0),
    "maze": (16.0, 14.0),
    "cave": (24.0, 18.0),
    "warehouse": (24.0, 16.0),
    "hall": (18.0, 13.0),
    "open": (22.0, 16.0),
}


def generate_map(
    kind: str,
    seed: int = 0,
    *,
    difficulty: float = 0.5,
    size: tuple[float, float] | None = None,
    resolution: float = 0.1,
) -> OccupancyGrid:
    """Generate a map of a kind, enclosed by a wall. Equal arguments give equal maps.

    All places in which a disc robot of radius 0.3 m fits are connected for it. A greater difficulty
    means more obstacles, narrower passages and fewer loops. The kinds, with their default size in
    brackets and their ranges from difficulty 0 to 1:

    - `rooms` (18 m x 14 m): rooms with furniture, joined by doors, without a corridor. Smaller
      rooms, doors of 1.2 m to 0.9 m, fewer doors that make loops, furniture on 3 to 18 percent of
      the floor, 1.3 m to 0.9 m apart.
    - `office` (20 m x 14 m): that of `jaxplore.office` with this seed; with crates in its rooms and
      its corridor on 0 to 1.6 percent of the floor, 1 m to 0.9 m from everything.
    - `maze` (16 m x 14 m): corridors of 2 m to 1.2 m. At 0 no dead end is left and there are many
      loops; at 1 there is one way between any two places.
    - `cave` (24 m x 18 m): smooth irregular walls. Finer shapes, ways of at least 1.5 m to 0.9 m,
      free space of at least about 60 to 45 percent of the map.
    - `warehouse` (24 m x 16 m): shelves with aisles of at least 2.2 m to 1.7 m and cross aisles.
      More pallets in the aisles, 0.9 m beside each; more shelves that close cross aisles and the
      ends of aisles.
    - `hall` (18 m x 13 m): one space with discs, boxes and short walls on 3 to 20 percent of the
      floor, at least 1.6 m to 0.9 m apart; the short walls are longer.
    - `open` (22 m x 16 m): nearly empty ground with an irregular outline, which is pressed in by
      15 to 45 percent; 0.3 to 2 percent is pillars.

    Obstacles cover less than that if no more fit. On coarse grids passages beside obstacles are
    wider: at least 0.6 m plus 2.9 cells, so up to 1.2 m.

    Args:
        kind: kind of the map, one of `KINDS`.
        seed: seed of the map; a whole number >= 0.
        difficulty: difficulty of the map, in [0, 1].
        size: extent along x, at least 8, and along y, at least 7 [m]. The default sizes give 150 to
            350 m^2 of free space at difficulty 0.5.
        resolution: side of a cell [m]; at most 0.2.

    Returns:
        Grid with probability 0 (free) or 1 (occupied), (size[1] / resolution, size[0] /
        resolution), and its origin at (0, 0, 0). `start_pose` gives a pose to start from.

    Raises:
        ValueError: a kind, seed, difficulty, size or resolution that is not accepted, or more than
            64 million cells.
    """
    if kind not in KINDS:
        raise ValueError(f"kind is {kind!r}; accepted: {', '.join(KINDS)}")
    seed = _checks.whole_number("seed", seed, at_least=0)
    difficulty = _checks.number("difficulty", difficulty, at_least=0.0, at_most=1.0)
    width, height = _extent(_SIZES[kind] if size is None else size)
    resolution = _checks.number("resolution", resolution, above=0.0, at_most=0.2)
    if (width / resolution) * (height / resolution) > CELL_LIMIT:
        raise ValueError(
            f"resolution is {resolution}; accepted: at most {CELL_LIMIT} cells on "
            f"{width} m x {height} m"
        )
    if kind == "office":
        floor = office(seed, width=width, height=height, resolution=resolution)
        occupied = np.array(floor.is_occupied)
    else:
        occupied = np.zeros((round(height / resolution), round(width / resolution)), bool)
        wall = wall_cells(resolution)
        # Writing through the transposed view closes the other two sides.
        for edge in (occupied, occupied.T):
            edge[:wall] = edge[-wall:] = True
    # Kinds with the same seed get independent random numbers.
    rng = np.random.default_rng((KINDS.index(kind), seed))
    _DRAW[kind](rng, occupied, difficulty, resolution)
    _fill_unreachable(occupied, resolution)
    return OccupancyGrid(occupied.astype(np.float32), resolution)


def _extent(size: tuple[float, float]) -> tuple[float, float]:
    try:
        width, height = size
    except (TypeError, ValueError):
        raise ValueError(f"size is {size!r}; accepted: width and height [m]") from None
    return (
        _checks.number("size[0]", width, at_least=8.0),
        _checks.number("size[1]", height, at_least=7.0),
    )


def _add_crates(
    rng: np.random.Generator, occupied: Mask, difficulty: float, resolution: float
) -> None:

    def draw(rng: np.random.Generator) -> Mask:
        return block(
            rng.uniform(0.3, 0.9), rng.uniform(0.3, 0.5), rng.uniform(0.0, math.pi), resolution
        )

    crates = Clutter(occupied, interpolate(1.0, 0.8, difficulty), resolution, is_apart=True)
    crates.scatter(rng, draw, 0.016 * difficulty)


_DRAW: dict[str, Callable[[np.random.Generator, Mask, float, float], None]] = {
    "rooms": rooms,
    "office": _add_crates,
    "maze": maze,
    "cave": cave,
    "warehouse": warehouse,
    "hall": hall,
    "open": open_ground,
}


def _fill_unreachable(occupied: Mask, resolution: float) -> None:
    """Fill the free space that the robot cannot reach from the largest connected part."""
    from scipy import ndimage  # slow to import, and few need it

    # Filling changes the clearance of the cells around, so repeat until nothing is unreachable.
    while True:
        distance = ndimage.distance_transform_edt(~occupied)
        # Label twice, with the most cautious and the most generous test, so that the map is
        # connected whether a cell counts as a square or as a disc and with or without diagonals.
        surely, _ = ndimage.label(distance >= clearance_cells(ROBOT_RADIUS, resolution))
        perhaps, _ = ndimage.label(
            (distance - 0.5) * resolution >= ROBOT_RADIUS - 1e-6, np.ones((3, 3), int)
        )
        main = surely == int(np.bincount(surely.ravel())[1:].argmax()) + 1
        pockets = ((surely > 0) & ~main) | ((perhaps > 0) & ~np.isin(perhaps, perhaps[main]))
        spaces, _ = ndimage.label(~occupied)
        cut_off = (spaces > 0) & ~np.isin(spaces, spaces[main])
        if not (pockets.any() or cut_off.any()):
            return
        # A free cell is assigned to the part from which the shorter way leads to it.
        places = main.astype(np.int16) + 2 * pockets.astype(np.int16)
        nearest = ndimage.watershed_ift(occupied.astype(np.uint8), places)
        occupied |= (nearest == 2) | cut_off
