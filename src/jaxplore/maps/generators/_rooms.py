"""Generate rooms of different sizes with doors between them, for `generate_map`."""

import math

import numpy as np

from jaxplore.maps.generators._clutter import (
    DOOR_CLEARANCE,
    Clutter,
    Mask,
    block,
    interpolate,
    passage_cells,
    wall_cells,
)
from jaxplore.maps.generators.office import Box

_JAMB = 0.3
"""Least distance of a door from the corners of a room [m]."""


def rooms(rng: np.random.Generator, occupied: Mask, difficulty: float, resolution: float) -> None:
    """Divide a floor into rooms, open doors between them and furnish them."""
    wall = wall_cells(resolution)
    height, width = occupied.shape
    boxes = _divide(rng, (wall, height - wall, wall, width - wall), wall, difficulty, resolution)
    occupied[:] = True
    for bottom, top, left, right in boxes:
        occupied[bottom:top, left:right] = False
    clutter = Clutter(occupied, interpolate(1.3, 0.8, difficulty), resolution, is_apart=False)
    _cut_doors(rng, clutter, boxes, wall, difficulty)
    for box in boxes:
        _furnish(rng, clutter, box, interpolate(0.03, 0.18, difficulty))


def _divide(
    rng: np.random.Generator, floor: Box, wall: int, difficulty: float, resolution: float
) -> list[Box]:
    """Divide a floor into rooms by recursive random cuts."""
    shortest = math.ceil(interpolate(3.2, 2.4, difficulty) / resolution)
    small, large = (interpolate(*areas, difficulty) for areas in ((18.0, 9.0), (45.0, 22.0)))
    undivided, rooms = [floor], []
    while undivided:
        box = undivided.pop()
        sides = box[1] - box[0], box[3] - box[2]
        area = sides[0] * sides[1] * resolution**2
        # Cut the longer side, so that rooms stay compact; cut either side of a square room.
        axis = int(sides[1] > sides[0])
        if max(sides) < 1.3 * min(sides):
            axis = int(rng.integers(2))
        slack = sides[axis] - wall - 2 * shortest
        if slack < 0 or area < small or (area < large and rng.random() < 0.4):
            rooms.append(box)
            continue
        end = box[2 * axis] + shortest + int(rng.integers(slack + 1))
        low, high = list(box), list(box)
        low[2 * axis + 1], high[2 * axis] = end, end + wall
        undivided += [(low[0], low[1], low[2], low[3]), (high[0], high[1], high[2], high[3])]
    return rooms


def _cut_doors(
    rng: np.random.Generator, clutter: Clutter, boxes: list[Box], wall: int, difficulty: float
) -> None:
    """Open doors that connect all rooms and some more that make loops, and keep them clear."""
    resolution = clutter.resolution
    jamb = math.ceil(_JAMB / resolution)
    reach = max(clutter.passage, math.ceil(DOOR_CLEARANCE / resolution))
    door = passage_cells(interpolate(1.2, 0.9, difficulty), resolution)
    neighbours = []
    for first, a in enumerate(boxes):
        for second, b in enumerate(boxes):
            for across, along in ((0, 2), (2, 0)):
                if a[across + 1] + wall != b[across]:
                    continue
                low, high = max(a[along], b[along]) + jamb, min(a[along + 1], b[along + 1]) - jamb
                if high - low >= door:
                    neighbours.append((first, second, across, low, high))
    # Join the groups of connected rooms door by door, in random order (Kruskal's algorithm). All
    # rooms get connected: a wall of the division is at least a room long, and so are the first
    # rooms on both of its sides, so there is room for a door between them.
    group = np.arange(len(boxes))
    for index in rng.permutation(len(neighbours)):
        first, second, across, low, high = neighbours[index]
        is_loop = group[first] == group[second]
        if is_loop and rng.random() > interpolate(0.6, 0.05, difficulty):
            continue
        group[group == group[second]] = group[first]
        start = int(rng.integers(low, high - door + 1))
        spans = [slice(start, start + door)] * 2
        spans[across // 2] = slice(boxes[first][across + 1], boxes[second][across])
        clutter.occupied[spans[0], spans[1]] = False
        around = [slice(max(0, span.start - reach), span.stop + reach) for span in spans]
        clutter.taken[around[0], around[1]] = True


def _furnish(rng: np.random.Generator, clutter: Clutter, room: Box, share: float) -> None:
    """Place furniture at walls and in the middle until it covers a share of a room."""
    sides = room[1] - room[0], room[3] - room[2]
    wanted = share * sides[0] * sides[1]
    for _ in range(40):
        length, breadth = rng.uniform(0.6, 2.0), rng.uniform(0.4, 0.9)
        piece = block(length, breadth, 0.0, clutter.resolution)
        against = int(rng.integers(2))
        if against == 1:
            piece = np.ascontiguousarray(piece.T)
        start = []
        for axis in (0, 1):
            slack = sides[axis] - piece.shape[axis]
            # The long side lies along the wall. Along the other axis the piece stands in a corner
            # or leaves a passage.
            if slack < clutter.passage:
                break
            stands_at_wall = rng.random() < (0.75 if axis == against else 0.25)
            if stands_at_wall:
                start.append(int(rng.integers(2)) * slack)
            elif slack >= 2 * clutter.passage:
                start.append(int(rng.integers(clutter.passage, slack - clutter.passage + 1)))
        if len(start) < 2 or piece.sum() > 1.5 * wanted:
            continue
        if clutter.put(piece, room[0] + start[0], room[2] + start[1]):
            wanted -= np.count_nonzero(piece)
