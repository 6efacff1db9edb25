"""Generate warehouses, for `generate_map`."""

import itertools
import math

import numpy as np

from jaxplore.maps.generators._clutter import Clutter, Mask, block, interpolate, wall_cells

_SHELF = 1.0
"""Depth of a row of shelves [m]."""
_BLOCK = 8.0
"""Length of a row of shelves between two cross aisles, roughly [m]."""
_PALLET = (1.2, 0.8)
"""Sides of a Euro pallet [m]."""


def warehouse(
    rng: np.random.Generator, occupied: Mask, difficulty: float, resolution: float
) -> None:
    """Place rows of shelves with aisles between them, and pallets in the aisles."""
    # Transpose some maps, so that aisles run along either axis. The view writes into the same map.
    if rng.random() < 0.3:
        occupied = occupied.T
    height, width = occupied.shape
    wall = wall_cells(resolution)
    shelf = math.ceil(_SHELF / resolution)
    aisle = math.ceil(interpolate(2.2, 1.7, difficulty) / resolution)
    cross = math.ceil(interpolate(2.6, 1.8, difficulty) / resolution)

    # Distribute the remaining height evenly over the aisles, of which there is one more than rows.
    count = max(1, (height - 2 * wall - aisle) // (shelf + aisle))
    spare = height - 2 * wall - count * shelf
    aisles = np.rint(np.linspace(0, spare, count + 2)).astype(int)
    rows = [wall + int(aisles[index + 1]) + index * shelf for index in range(count)]
    inside = width - 2 * wall
    blocks = max(1, round((inside - cross) * resolution / (_BLOCK + cross * resolution)))
    edges = np.rint(np.linspace(0, inside - cross, blocks + 1)).astype(int)
    spans = [(wall + int(low) + cross, wall + int(high)) for low, high in itertools.pairwise(edges)]

    # A shelf that continues to a wall makes its aisles dead ends. All continue to the same wall, so
    # that the other ends stay open.
    is_left_wall = rng.random() < 0.5
    ends = [low for low, _ in spans] + [width - wall]
    for row in rows:
        is_missing = rng.random(blocks) < interpolate(0.1, 0.0, difficulty)
        is_joined = rng.random(blocks + 1) < interpolate(0.0, 0.5, difficulty)
        for index, (low, high) in enumerate(spans):
            if not is_missing[index]:
                occupied[row : row + shelf, low:high] = True
        for index in range(blocks + 1):
            is_wall = index in (0, blocks)
            if is_joined[index] and (not is_wall or is_left_wall == (index == 0)):
                first = wall if index == 0 else spans[index - 1][1]
                occupied[row : row + shelf, first : ends[index]] = True

    clutter = Clutter(occupied, 0.8, resolution, is_apart=False)
    pallet = block(*_PALLET, 0.0, resolution)
    share = interpolate(0.05, 0.6, difficulty)
    lows = [wall] + [row + shelf for row in rows]
    highs = [*rows, height - wall]
    for low, high in zip(lows, highs, strict=True):
        for first, last in spans:
            _leave_pallets(rng, clutter, pallet, (low, high, first, last), share)


def _leave_pallets(
    rng: np.random.Generator,
    clutter: Clutter,
    pallet: Mask,
    aisle: tuple[int, int, int, int],
    share: float,
) -> None:
    """Place pallets along both sides of an aisle, where a passage is left beside them."""
    low, high, first, last = aisle
    depth, length = pallet.shape
    if high - low - depth < clutter.passage or last - first < length:
        return
    places = max(1, (last - first) // (length + clutter.passage))
    for _ in range(int(rng.binomial(2 * places, share / 2))):
        row = low if rng.random() < 0.5 else high - depth
        clutter.put(pallet, row, int(rng.integers(first, last - length + 1)))
