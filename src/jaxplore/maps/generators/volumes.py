"""Generate volumes from a seed, for examples, tests and benchmarks."""

import numpy as np

from jaxplore import _checks
from jaxplore.maps.voxel_grid import VoxelGrid

VOLUMES = ("forest", "warehouse")
"""Kinds of volumes that `generate_volume` can draw. The position of a kind is part of its seed."""
_CLEAR = 1.2
"""Distance around the start within which nothing stands [m]."""
START = (2.0, 2.0, 1.5)
"""Place (x, y, z) that is free in every volume [m]."""


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

    Args:
        kind: name of the kind.
        seed: seed of the random numbers.
        size: extents (x, y, z) [m], at least 5 m by 5 m by 2 m.
        resolution: side of a voxel [m].

    Raises:
        ValueError: an unknown kind, a size below the least one, a seed that is negative.
    """
    if kind not in VOLUMES:
        raise ValueError(f"kind is {kind!r}; accepted: {', '.join(VOLUMES)}")
    extents = np.asarray(_checks.vector("size", size, 3), np.float64)
    if (extents < [5.0, 5.0, 2.0]).any():
        raise ValueError(f"size is {tuple(size)}; accepted: at least (5, 5, 2) m")
    side = _checks.number("resolution", resolution, above=0.0)
    number = _checks.whole_number("seed", seed, at_least=0)
    rng = np.random.default_rng([VOLUMES.index(kind), number])
    width, height, depth = (max(3, round(each / side)) for each in extents)
    solid = np.zeros((depth, height, width), bool)
    y, x = (np.arange(n) + 0.5 for n in (height, width))
    y, x = np.meshgrid(y * side, x * side, indexing="ij")
    if kind == "forest":
        for _ in range(round(0.15 * extents[0] * extents[1])):
            at = rng.uniform(0.5, extents[:2] - 0.5)
            radius = rng.uniform(0.15, 0.35)
            if np.hypot(*(at - START[:2])) > _CLEAR + radius:
                solid[:, np.hypot(x - at[0], y - at[1]) < radius] = True
    else:
        _shelves(solid, extents, side, rng)
    solid[[0, -1]] = solid[:, [0, -1]] = solid[:, :, [0, -1]] = True
    return VoxelGrid.solid(solid, side)


def _shelves(solid: np.ndarray, size: np.ndarray, side: float, rng: np.random.Generator) -> None:
    """Put rows of shelves along x into a volume."""

    def block(low: tuple[float, float, float], high: tuple[float, float, float]) -> None:
        begin, end = (np.round(np.asarray(each) / side).astype(int) for each in (low, high))
        solid[begin[2] : end[2], begin[1] : end[1], begin[0] : end[0]] = True

    boards = np.arange(0.9, size[2] - 0.6, 0.9)
    for y in np.arange(3.4, size[1] - 2.0, 2.8):
        x = 1.6
        while x < size[0] - 3.0:
            end = min(x + rng.uniform(3.0, 5.0), size[0] - 1.6)
            for board in (0.0, *boards):
                block((x, y, board), (end, y + 1.0, board + 0.1))
                at = x
                while at < end - 0.5:
                    length = rng.uniform(0.4, 0.9)
                    if rng.random() < 0.7:
                        top = board + 0.1 + rng.uniform(0.3, 0.7)
                        block((at, y, board), (min(at + length, end), y + 1.0, top))
                    at += length
            x = end + rng.uniform(1.6, 2.2)
