"""Read OctoMaps: `.bt`, free and occupied, and `.ot`, with log-odds.

The readers in C++ take a file at its word and crash on a damaged one. Source of the formats:
Hornung et al., "OctoMap: an efficient probabilistic 3D mapping framework based on octrees",
Autonomous Robots 2013, section 5.3, and its library, `OcTreeBaseImpl::writeNodesRecurs`.
"""

import math
import re
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

DEPTH = 16
"""Levels of the tree below its root: the root has 2^16 voxels on a side."""
MEMORY = 150
"""Memory to read a node of a tree [bytes]."""
_FREE, _OCCUPIED, _INNER = 1, 2, 3
"""Two bits of a child in `.bt`."""
_CHILDREN = np.arange(8)
_OFFSETS = np.stack([_CHILDREN & 1, _CHILDREN >> 1 & 1, _CHILDREN >> 2], axis=1).astype(np.int32)
"""Places (x, y, z) of the children of a node."""
_BITS = (2 * _CHILDREN).astype(np.uint16)
_AT_ONCE = 1 << 14
"""Nodes whose leaves are made voxels at a time."""
_SMALL = 4
"""Greatest leaf that is filled voxel by voxel [voxels]; greater ones are few."""
_NODES = {"OcTree": 5, "ColorOcTree": 8}
"""Bytes of a node in `.ot` by the kind of tree: the log-odds first, the children last."""


class Leaves(NamedTuple):
    """Leaves of one size: their corners (x, y, z) and their side [voxels].

    Those that are not free are occupied.
    """

    corners: NDArray[np.int32]
    size: int
    is_free: NDArray[np.bool_]


class OctoMap:
    """An OctoMap, whose box is known before its voxels are made.

    Voxels that are occupied or unknown are solid. The box is that around all known voxels. Reading
    it takes at most `memory` [bytes].

    Attributes:
        resolution: side of a voxel [m].
        shape: voxels (D, H, W) of the box.
        origin: corner (x, y, z) of the box [m].
    """

    def __init__(self, data: bytes, memory: float = math.inf) -> None:
        is_binary = data.startswith(b"# Octomap OcTree binary file")
        begin = re.search(rb"\ndata\r?\n", data[:10_000])
        if not (is_binary or data.startswith(b"# Octomap OcTree file")) or begin is None:
            raise ValueError("it does not begin as an OctoMap")
        header = data[: begin.start()].decode("ascii", "replace")
        found = re.search(r"^res\s+([0-9.eE+-]{1,50})\s*$", header, re.MULTILINE)
        self.resolution = float(found[1]) if found else math.nan
        if not (math.isfinite(self.resolution) and self.resolution > 0.0):
            raise ValueError("its header has no resolution above 0")
        width = 2
        if not is_binary:
            kind = re.search(r"^id\s+(\w{1,50})\s*$", header, re.MULTILINE)
            width = _NODES.get(kind[1] if kind else "", 0)
            if not width:
                raise ValueError(f"its header has no id of {' or '.join(_NODES)}")
        number = (len(data) - begin.end()) // width
        if number * MEMORY > memory:
            raise ValueError(
                f"it has {number} nodes, which need {number * MEMORY / 1e9:.3g} GB; there is "
                f"{memory / 1e9:.3g} GB"
            )
        rows = np.frombuffer(data, np.uint8, number * width, begin.end()).reshape(number, width)
        self._nodes = _Binary(rows) if is_binary else _Full(rows)
        self._levels = list(_levels(self._nodes))
        low, high = np.full(3, 1 << DEPTH), np.zeros(3, int)
        for leaves in self._leaves():
            if len(leaves.corners):
                low = np.minimum(low, leaves.corners.min(axis=0))
                high = np.maximum(high, leaves.corners.max(axis=0) + leaves.size)
        if (high <= low).any():
            raise ValueError("its tree is empty")
        self._low, shape = low, (high - low)[::-1].tolist()
        self.shape = (int(shape[0]), int(shape[1]), int(shape[2]))
        x, y, z = ((low - (1 << (DEPTH - 1))) * self.resolution).tolist()
        self.origin = (float(x), float(y), float(z))

    def solid(self) -> NDArray[np.bool_]:
        """Return whether each voxel (D, H, W) of the box is occupied or unknown."""
        solid = np.ones(self.shape, bool)
        for leaves in self._leaves():
            corners, size = leaves.corners[leaves.is_free] - self._low, leaves.size
            if size <= _SMALL:
                for x, y, z in np.ndindex(size, size, size):
                    solid[corners[:, 2] + z, corners[:, 1] + y, corners[:, 0] + x] = False
                continue
            for x, y, z in corners.tolist():
                solid[z : z + size, y : y + size, x : x + size] = False
        return solid

    def _leaves(self) -> Iterator[Leaves]:
        for nodes, corners, size in self._levels:
            for begin in range(0, len(nodes), _AT_ONCE):
                part = slice(begin, begin + _AT_ONCE)
                yield self._nodes.leaves(nodes[part], corners[part], size)


class _Binary:
    """The nodes of a `.bt`, depth first: two bits for each child. Leaves have no node."""

    def __init__(self, rows: NDArray[np.uint8]) -> None:
        self._codes = rows.view("<u2")[:, 0]

    def below(self, nodes: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which of the eight children (N, 8) of nodes are nodes as well."""
        return np.asarray(self._states(nodes) == _INNER)

    def counts(self) -> NDArray[np.int8]:
        """Return the number of these children, of all nodes."""
        return np.asarray(np.bitwise_count(self._codes & self._codes >> 1 & 0x5555), np.int8)

    def leaves(self, nodes: NDArray[np.int64], corners: NDArray[np.int32], size: int) -> Leaves:
        """Return the leaves below nodes of one size."""
        states, half = self._states(nodes), size // 2
        if not half:
            raise ValueError("its tree is damaged")
        which, child = np.nonzero((states == _FREE) | (states == _OCCUPIED))
        return Leaves(corners[which] + half * _OFFSETS[child], half, states[which, child] == _FREE)

    def _states(self, nodes: NDArray[np.int64]) -> NDArray[np.uint16]:
        return np.asarray(self._codes[nodes, None] >> _BITS & 3, np.uint16)


class _Full:
    """The nodes of an `.ot`, depth first: log-odds, and a bit for each child."""

    def __init__(self, rows: NDArray[np.uint8]) -> None:
        self._rows = rows

    def below(self, nodes: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which children (N, 8) nodes have."""
        return np.asarray((self._rows[nodes, -1, None] >> _CHILDREN & 1) == 1)

    def counts(self) -> NDArray[np.int8]:
        """Return the number of children of all nodes."""
        return np.asarray(np.bitwise_count(self._rows[:, -1]), np.int8)

    def leaves(self, nodes: NDArray[np.int64], corners: NDArray[np.int32], size: int) -> Leaves:
        """Return the leaves among nodes of one size."""
        is_leaf = self._rows[nodes, -1] == 0
        log_odds = np.ascontiguousarray(self._rows[nodes[is_leaf], :4]).view("<f4")[:, 0]
        # As in OctoMap, even odds are occupied, and so is what is no number.
        return Leaves(corners[is_leaf], size, log_odds < 0.0)


def _levels(nodes: _Binary | _Full) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int32], int]]:
    """Yield the nodes (N,) of each level of the tree, their corners (N, 3) and their size [voxels].

    Depth first, the first child of a node follows it, and each other one follows the last node
    below its elder sister. With c(i) children below node i, that is the first j >= i at which
    sum_{k <= j} (c(k) - 1) is less than before i.
    """
    sums = np.cumsum(nodes.counts().astype(np.int32) - 1, dtype=np.int64)
    number = int(np.argmax(sums < 0)) + 1 if len(sums) else 0
    if not number or sums[number - 1] >= 0:
        raise ValueError("its tree is damaged")
    sums = sums[:number]
    # Sums fall by one at most, so that what is less is equal to the next number below.
    keys = (sums + 1) * number + np.arange(number)
    order = np.sort(keys)

    def last_below(node: NDArray[np.int64]) -> NDArray[np.int64]:
        before = np.where(node > 0, sums[node - 1], 0)
        return np.asarray(order[np.searchsorted(order, before * number + node)] - before * number)

    level, corners = np.zeros(1, np.int64), np.zeros((1, 3), np.int32)
    for depth in range(DEPTH + 1):
        size = 1 << (DEPTH - depth)
        yield level, corners, size
        below, half = nodes.below(level), size // 2
        if not below.any():
            return
        found, places, follows = [], [], level + 1
        for child in range(8):
            has = below[:, child]
            found.append(follows[has])
            places.append(corners[has] + half * _OFFSETS[child])
            follows[has] = last_below(follows[has]) + 1
        level, corners = np.concatenate(found), np.concatenate(places)
    raise ValueError("its tree is damaged")
