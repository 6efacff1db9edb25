"""Generate mazes, for `generate_map`."""

import itertools
import math

import numpy as np

from jaxplore.maps.generators._clutter import Mask, interpolate, passage_cells, wall_cells

Place = tuple[int, int]
"""Row and column of a square of the maze."""

_NEWEST = 0.75
"""Probability that the tree grows at its newest square, which makes corridors long."""


def maze(rng: np.random.Generator, occupied: Mask, difficulty: float, resolution: float) -> None:
    """Carve corridors along a random spanning tree, and open some dead ends."""
    wall = wall_cells(resolution)
    breadth = _corridor_cells(interpolate(2.0, 1.2, difficulty), resolution)
    rows, columns = (_tracks(extent, wall, breadth) for extent in occupied.shape)
    shape = len(rows), len(columns)
    ways = _tree(rng, shape)
    _braid(rng, ways, shape, 1.0 - difficulty)
    # Start from solid rock: corridors and openings are carved out of it.
    occupied[:] = True
    for (row, column), others in ways.items():
        occupied[slice(*rows[row]), slice(*columns[column])] = False
        for other in others:
            low, high = min((row, column), other), max((row, column), other)
            occupied[
                rows[low[0]][0] : rows[high[0]][1], columns[low[1]][0] : columns[high[1]][1]
            ] = False


def _corridor_cells(breadth: float, resolution: float) -> int:
    # An odd width has a middle cell, as far from both walls as possible.
    return max(passage_cells(breadth, resolution), 2 * math.ceil(0.5 / resolution + 0.5) - 1)


def _tracks(extent: int, wall: int, breadth: int) -> list[tuple[int, int]]:
    """Return the cells [low, high) of parallel corridors that fill an extent."""
    count = (extent - wall) // (breadth + wall)
    edges = np.rint(np.linspace(0, extent - wall, count + 1)).astype(int).tolist()
    return [(low + wall, high) for low, high in itertools.pairwise(edges)]


def _neighbours(place: Place, shape: tuple[int, int]) -> list[Place]:
    row, column = place
    around = ((row - 1, column), (row, column - 1), (row, column + 1), (row + 1, column))
    return [(r, c) for r, c in around if 0 <= r < shape[0] and 0 <= c < shape[1]]


def _tree(rng: np.random.Generator, shape: tuple[int, int]) -> dict[Place, set[Place]]:
    """Return the open neighbours of each square: a random spanning tree (growing tree method)."""
    root = int(rng.integers(shape[0])), int(rng.integers(shape[1]))
    ways: dict[Place, set[Place]] = {root: set()}
    growing = [root]
    while growing:
        index = -1 if rng.random() < _NEWEST else int(rng.integers(len(growing)))
        place = growing[index]
        new = [other for other in _neighbours(place, shape) if other not in ways]
        if not new:
            growing.pop(index)
            continue
        other = new[int(rng.integers(len(new)))]
        ways[place].add(other)
        ways[other] = {place}
        growing.append(other)
    return ways


def _braid(
    rng: np.random.Generator, ways: dict[Place, set[Place]], shape: tuple[int, int], share: float
) -> None:
    """Open a share of the dead ends, and a tenth of that share of the other squares."""
    for place, others in ways.items():
        closed = [other for other in _neighbours(place, shape) if other not in others]
        is_dead_end = len(others) == 1
        if closed and rng.random() < (share if is_dead_end else 0.1 * share):
            other = closed[int(rng.integers(len(closed)))]
            others.add(other)
            ways[other].add(place)
