"""Generate volumes from a seed, for examples, tests and benchmarks."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from jaxplore import _checks
from jaxplore.maps.voxel_grid import VoxelGrid

Solid = NDArray[np.bool_]
Block = Callable[[tuple[float, float, float], tuple[float, float, float], bool], None]
"""Function that makes a box between two corners (x, y, z) [m] solid or free."""
START = (2.0, 2.0, 1.5)
"""Place (x, y, z) that is free in every volume, with 1 m around it in the plane [m]."""
_CLEAR = 1.2
"""Distance around the start within which no trunk stands [m]."""
_STOREY = 2.8
"""Height of a storey of a maze, its floor included [m]."""
_CORRIDOR = 2.5
"""Distance between the middles of neighbouring corridors of a maze [m]."""


def generate_volume(
    kind: str,
    seed: int = 0,
    *,
    size: tuple[float, float, float] = (20.0, 15.0, 3.0),
    resolution: float = 0.1,
) -> VoxelGrid:
    """Generate a volume of a kind, enclosed by walls, floor and ceiling, one voxel thick.

    - `forest`: trunks of 0.15 m to 0.35 m radius from floor to ceiling, 0.15 for each square metre.
    - `warehouse`: rows of shelves 1 m deep and 1.8 m apart, boxes of several heights on their
      boards, crossings between the rows.
    - `office`: rooms with doors 1.4 m wide and 2.2 m high, windows 1.2 m by 1 m between some of
      them, tables, cabinets of several heights, lamps.
    - `maze`: storeys of corridors 2.3 m wide, each a spanning tree with some more openings, joined
      by stairwells.
    - `cave`: passages at least 1.2 m wide, where smooth noise exceeds a level.

    Args:
        kind: name of the kind.
        seed: seed of the random numbers.
        size: extents (x, y, z) [m], at least 5 m by 5 m by 2 m. A maze has a storey for each 2.8 m.
        resolution: side of a voxel [m].

    Raises:
        ValueError: an unknown kind, a size below the least one, a seed that is negative.
    """
    if not isinstance(kind, str) or kind not in VOLUMES:
        raise ValueError(f"kind is {kind!r}; accepted: {', '.join(VOLUMES)}")
    extents = np.asarray(_checks.vector("size", size, 3), np.float64)
    if (extents < [5.0, 5.0, 2.0]).any():
        raise ValueError(f"size is {tuple(size)}; accepted: at least (5, 5, 2) m")
    side = _checks.number("resolution", resolution, above=0.0)
    number = _checks.whole_number("seed", seed, at_least=0)
    rng = np.random.default_rng([list(VOLUMES).index(kind), number])
    width, height, depth = (max(3, round(each / side)) for each in extents)
    solid = np.zeros((depth, height, width), bool)

    def block(
        low: tuple[float, float, float], high: tuple[float, float, float], is_solid: bool
    ) -> None:
        begin, end = (
            np.clip(np.round(np.asarray(each) / side).astype(int), 0, None) for each in (low, high)
        )
        solid[begin[2] : end[2], begin[1] : end[1], begin[0] : end[0]] = is_solid

    VOLUMES[kind](solid, extents, side, rng, block)
    solid[[0, -1]] = solid[:, [0, -1]] = solid[:, :, [0, -1]] = True
    return VoxelGrid.solid(solid, side)


def _forest(
    solid: Solid, size: np.ndarray, side: float, rng: np.random.Generator, block: Block
) -> None:
    y, x = (np.arange(n) + 0.5 for n in solid.shape[1:])
    y, x = np.meshgrid(y * side, x * side, indexing="ij")
    for _ in range(round(0.15 * size[0] * size[1])):
        at = rng.uniform(0.5, size[:2] - 0.5)
        radius = rng.uniform(0.15, 0.35)
        if np.hypot(*(at - START[:2])) > _CLEAR + radius:
            solid[:, np.hypot(x - at[0], y - at[1]) < radius] = True


def _warehouse(
    solid: Solid, size: np.ndarray, side: float, rng: np.random.Generator, block: Block
) -> None:
    """Put up rows of shelves along x."""
    boards = np.arange(0.9, size[2] - 0.6, 0.9)
    for y in np.arange(3.4, size[1] - 2.0, 2.8):
        x = 1.6
        while x < size[0] - 3.0:
            end = min(x + rng.uniform(3.0, 5.0), size[0] - 1.6)
            for board in (0.0, *boards):
                block((x, y, board), (end, y + 1.0, board + 0.1), True)
                at = x
                while at < end - 0.5:
                    length = rng.uniform(0.4, 0.9)
                    if rng.random() < 0.7:
                        top = board + 0.1 + rng.uniform(0.3, 0.7)
                        block((at, y, board), (min(at + length, end), y + 1.0, top), True)
                    at += length
            x = end + rng.uniform(1.6, 2.2)


def _office(
    solid: Solid, size: np.ndarray, side: float, rng: np.random.Generator, block: Block
) -> None:
    """Divide the storey into rooms, join them by doors and windows, and furnish them."""
    top = float(size[2])
    rooms: list[tuple[float, float, float, float]] = []

    def divide(left: float, low: float, right: float, high: float) -> None:
        across = right - left >= high - low
        length = right - left if across else high - low
        if length < 8.0:
            rooms.append((left, low, right, high))
            return
        at = rng.uniform(3.8, length - 3.8)

        def wall(
            begin: float, end: float, bottom: float, upper: float, is_solid: bool = True
        ) -> None:
            if across:
                block((left + at - 0.1, begin, bottom), (left + at + 0.1, end, upper), is_solid)
            else:
                block((begin, low + at - 0.1, bottom), (end, low + at + 0.1, upper), is_solid)

        first, last = (low, high) if across else (left, right)
        wall(first, last, 0.0, top)
        if across:
            divide(left, low, left + at, high)
            divide(left + at, low, right, high)
        else:
            divide(left, low, right, low + at)
            divide(left, low + at, right, high)
        # The openings come last, so that no wall of a smaller room closes one; those walls keep
        # 3.8 m from the ends, and an opening lies in the first or the last 3 m.
        door, window = (
            (first + 0.8, last - 2.4) if rng.random() < 0.5 else (last - 2.2, first + 1.2)
        )
        wall(door, door + 1.4, 0.0, 2.2, False)
        if rng.random() < 0.6:
            wall(window, window + 1.2, 1.0, 2.0, False)

    divide(0.0, 0.0, float(size[0]), float(size[1]))
    for left, low, right, high in rooms:
        for _ in range(round(0.12 * (right - left) * (high - low))):
            length, depth = rng.uniform(0.6, 1.6), rng.uniform(0.5, 0.8)
            length, depth = (length, depth) if rng.random() < 0.5 else (depth, length)
            x = rng.uniform(left + 0.3, right - 0.3 - length)
            y = rng.uniform(low + 0.3, high - 0.3 - depth)
            kind, tall = rng.random(), rng.uniform(0.8, 2.2)
            centre = np.array([x + 0.5 * length, y + 0.5 * depth])
            # The corners, where the doors are, and the start stay free.
            from_ends = np.minimum(centre - [left, low], [right, high] - centre)
            if from_ends.max() < 2.4 or np.abs(centre - START[:2]).max() < 2.0:
                continue
            if kind < 0.4:
                block((x, y, 0.7), (x + length, y + depth, 0.8), True)
                for leg_x in (x, x + length - 0.1):
                    for leg_y in (y, y + depth - 0.1):
                        block((leg_x, leg_y, 0.0), (leg_x + 0.1, leg_y + 0.1, 0.7), True)
            elif kind < 0.85:
                block((x, y, 0.0), (x + length, y + depth, tall), True)
            else:
                block((x, y, top - 0.6), (x + 0.3, y + 0.3, top), True)


def _maze(
    solid: Solid, size: np.ndarray, side: float, rng: np.random.Generator, block: Block
) -> None:
    """Open the corridors of a random spanning tree over the cells of all storeys."""
    storeys = max(1, round(size[2] / _STOREY))
    columns, rows = (max(2, round(each / _CORRIDOR)) for each in size[:2])
    pitch = np.array([size[0] / columns, size[1] / rows, size[2] / storeys])
    solid[:] = True

    def middle(cell: tuple[int, int, int]) -> np.ndarray:
        place: np.ndarray = (np.array(cell) + 0.5) * pitch
        return place

    half = 0.5 * pitch - 0.1

    def carve(one: tuple[int, int, int], other: tuple[int, int, int]) -> None:
        low, high = (
            np.minimum(middle(one), middle(other)) - half,
            np.maximum(middle(one), middle(other)) + half,
        )
        if one[2] != other[2]:
            # A stairwell has the width of its cell, less a rim.
            low[:2] += 0.3
            high[:2] -= 0.3
        block(tuple(low), tuple(high), False)

    cells = [(i, j, k) for k in range(storeys) for j in range(rows) for i in range(columns)]
    for cell in cells:
        carve(cell, cell)
    steps = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))
    limits = np.array([columns, rows, storeys])
    for storey in range(storeys):
        begin = (int(rng.integers(columns)), int(rng.integers(rows)), storey)
        visited, stack = {begin}, [begin]
        while stack:
            here = stack[-1]
            found = [
                there
                for step in steps
                if (there := tuple(np.add(here, step).tolist())) not in visited
                and (np.array(there) >= 0).all()
                and (np.array(there) < limits).all()
            ]
            if not found:
                stack.pop()
                continue
            there = found[rng.integers(len(found))]
            carve(here, there)
            visited.add(there)
            stack.append(there)
        # Some more openings make loops.
        for _ in range(columns * rows // 8):
            cell = (int(rng.integers(columns - 1)), int(rng.integers(rows)), storey)
            carve(cell, (cell[0] + 1, *cell[1:]))
        if storey > 0:
            well = (int(rng.integers(1, columns)), int(rng.integers(1, rows)), storey)
            carve((*well[:2], storey - 1), well)
    # Whatever the pitch, the start has its room.
    x, y, z = START
    block((x - 1.0, y - 1.0, z - 0.9), (x + 1.0, y + 1.0, z + 0.9), False)


def _cave(
    solid: Solid, size: np.ndarray, side: float, rng: np.random.Generator, block: Block
) -> None:
    """Carve where smooth noise exceeds a level, and keep what a ball of 0.6 m can reach."""
    from scipy import ndimage  # slow to import, and few need it

    # The noise stands on a lattice of fixed spacing, so that a seed gives one cave at any
    # resolution.
    lattice = np.maximum(2, np.ceil(size[::-1] / 0.4).astype(int))
    noise = ndimage.gaussian_filter(rng.standard_normal(lattice), 1.1 / 0.4)
    rise = ndimage.zoom(
        noise / noise.std(),
        np.divide(solid.shape, lattice).tolist(),
        order=1,
        mode="nearest",
        grid_mode=True,
    )
    z, y, x = np.meshgrid(
        *((np.arange(n) + 0.5) * side for n in solid.shape), indexing="ij", sparse=True
    )
    from_start = np.sqrt((x - START[0]) ** 2 + (y - START[1]) ** 2 + (z - START[2]) ** 2)
    ball = 0.6
    for share in (0.55, 0.65, 0.75, 0.85, 1.0):
        is_open = (rise > np.quantile(rise, 1.0 - share)) | (from_start < 1.3)
        room = ndimage.distance_transform_edt(np.pad(is_open, 1))[1:-1, 1:-1, 1:-1] * side
        labels, _ = ndimage.label(room > ball)
        start = tuple((np.array(START)[::-1] / side).astype(int))
        fits = labels == labels[start]
        free = ndimage.distance_transform_edt(~fits) * side < ball
        # Too small a cave is no task: then the level falls.
        if free.mean() > 0.35:
            break
    solid[:] = ~free


VOLUMES: dict[str, Callable[[Solid, np.ndarray, float, np.random.Generator, Block], None]] = {
    "forest": _forest,
    "warehouse": _warehouse,
    "office": _office,
    "maze": _maze,
    "cave": _cave,
}
"""Kinds of volumes that `generate_volume` can draw. The position of a kind is part of its seed."""
