"""Read OctoMaps from their binary format, `.bt`.

The readers in C++ take a file at its word and crash on a damaged one. Source of the format:
Hornung et al., "OctoMap: an efficient probabilistic 3D mapping framework based on octrees",
Autonomous Robots 2013, section 5.3.
"""

import math
import re

import numpy as np
from numpy.typing import NDArray

DEPTH = 16
"""Levels of the tree below its root: the root has 2^16 voxels on a side."""
_FREE, _INNER = 1, 3
"""Bits of a child: 1 for free, 2 for occupied, both for one with children of its own."""


def read_octomap(
    data: bytes, most_voxels: int
) -> tuple[NDArray[np.bool_], float, tuple[float, float, float]]:
    """Return the solid voxels (D, H, W), the side of a voxel [m] and the corner (x, y, z) [m].

    Voxels that are occupied or unknown are solid. The box is that around all known voxels.

    Args:
        data: content of the file.
        most_voxels: greatest number of voxels of the box.

    Raises:
        ValueError: a file of another kind, a damaged tree, too many voxels.
    """
    begin = data.find(b"\ndata\n")
    if not data.startswith(b"# Octomap OcTree binary file") or begin < 0:
        raise ValueError("it does not begin as a binary OctoMap")
    header = data[:begin].decode("ascii", "replace")
    found = re.search(r"^res\s+([0-9.eE+-]+)\s*$", header, re.MULTILINE)
    side = float(found[1]) if found else math.nan
    if not (math.isfinite(side) and side > 0.0):
        raise ValueError("its header has no resolution above 0")
    leaves = _leaves(data, begin + len(b"\ndata\n"))
    if not len(leaves):
        raise ValueError("its tree is empty")
    corner, size = leaves[:, :3], leaves[:, 3:4]
    low, high = corner.min(axis=0), (corner + size).max(axis=0)
    shape = high - low
    if math.prod(shape.tolist()) > most_voxels:
        raise ValueError(f"its box has {math.prod(shape.tolist())} voxels, more than {most_voxels}")
    solid = np.ones(tuple(shape[::-1].tolist()), bool)
    for x, y, z, width, what in (leaves - [*low, 0, 0]).tolist():
        if what == _FREE:
            solid[z : z + width, y : y + width, x : x + width] = False
    middle = 1 << (DEPTH - 1)
    origin = (low - middle) * side
    return solid, side, (float(origin[0]), float(origin[1]), float(origin[2]))


def _leaves(data: bytes, begin: int) -> NDArray[np.int64]:
    """Return the corner (x, y, z), size and state of each known leaf (N, 5) [voxels].

    Each inner node stands in the file as two bytes, two bits for each child, and its inner children
    follow, depth first.
    """
    leaves: list[tuple[int, int, int, int, int]] = []
    stack = [(0, 0, 0, 1 << DEPTH)]
    at = begin
    while stack:
        x, y, z, size = stack.pop()
        if at + 2 > len(data) or size < 2:
            raise ValueError("its tree is damaged")
        children = data[at] | data[at + 1] << 8
        at += 2
        half = size // 2
        inner = []
        for child in range(8):
            what = children >> 2 * child & 3
            where = (x + half * (child & 1), y + half * (child >> 1 & 1), z + half * (child >> 2))
            if what == _INNER:
                inner.append((*where, half))
            elif what:
                leaves.append((*where, half, what))
        stack.extend(reversed(inner))
    return np.array(leaves, np.int64).reshape(-1, 5)
