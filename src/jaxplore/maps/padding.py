"""Shapes to which maps are padded, so that maps of similar size share a compiled program."""

import numpy as np

from jaxplore import _checks

SMALLEST = 32
"""Step between the smallest sides, and the smallest side [cells]."""


def choose_padded_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Return the rows and columns to which a map is padded.

    Each side is rounded up to 32, 64, 96, 128, 160, ..., 256, 320, 384, 448, 512, 640, ...: there
    are four sizes between a power of two and the next. A side grows by less than a quarter, or 32.
    """
    rows, columns = (_pad_side(side) for side in shape)
    return rows, columns


def _pad_side(side: int) -> int:
    step = max(SMALLEST, (1 << (side - 1).bit_length()) // 8)
    return -(-side // step) * step


def pad_cells(
    name: str, values: np.ndarray, shape: tuple[int, int], value: float | bool
) -> np.ndarray:
    """Return an array (H, W, ...) with rows and columns of a value added at its end.

    `shape` has the rows and columns after padding; messages call it `name`.
    """
    shape = _checks.rows_and_columns(name, shape)
    more = [wanted - given for wanted, given in zip(shape, values.shape[:2], strict=True)]
    if min(more) < 0:
        raise ValueError(f"{name} is {shape}; accepted: at least {values.shape[:2]}")
    rest = [(0, 0)] * (values.ndim - 2)
    padded: np.ndarray = np.pad(values, [(0, more[0]), (0, more[1]), *rest], constant_values=value)
    return padded


def common_shapes(shapes: dict[str, tuple[int, int]], most: int) -> dict[str, tuple[int, int]]:
    """Choose a padded shape for each of several maps, with at most `most` different shapes in all.

    Begins with `choose_padded_shape` of each map. While there are more shapes, the two whose maps
    need the fewest additional cells in a common one are merged.
    """
    groups: dict[tuple[int, int], list[str]] = {}
    for name, shape in shapes.items():
        groups.setdefault(choose_padded_shape(shape), []).append(name)
    while len(groups) > most:
        pairs = [
            (_cost(groups, one, other), one, other)
            for one in groups
            for other in groups
            if one < other
        ]
        _, one, other = min(pairs)
        both = groups.pop(one) + groups.pop(other)
        groups.setdefault(_union(one, other), []).extend(both)
    return {name: shape for shape, names in groups.items() for name in names}


def _union(one: tuple[int, int], other: tuple[int, int]) -> tuple[int, int]:
    return max(one[0], other[0]), max(one[1], other[1])


def _cost(
    groups: dict[tuple[int, int], list[str]], one: tuple[int, int], other: tuple[int, int]
) -> int:
    rows, columns = _union(one, other)
    return sum(
        len(groups[shape]) * (rows * columns - shape[0] * shape[1]) for shape in (one, other)
    )
