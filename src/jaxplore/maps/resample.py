"""Resample a map to another resolution without losing a wall."""

import numpy as np
from numpy.typing import NDArray

from jaxplore import _checks

CELL_LIMIT = 64_000_000
"""Largest map that is created [cells]."""

_OCCUPIED_THRESHOLD = 0.65
"""The `OCCUPIED_THRESHOLD` of `occupancy_grid`, which imports this module."""
SLIVER = 1e-6
"""Parts of a cell below this are rounding errors: 0.15 m is not 3 x 0.05 m in binary [cells]."""


def resample(
    probability: NDArray[np.floating], resolution: float, new_resolution: float
) -> NDArray[np.floating]:
    """Return a map with cells of another size [m] and the same outer corner of cell (0, 0).

    Each new cell takes the most cautious value among the old cells that it overlaps:

    - the largest probability, if one of them is occupied (`p > 0.65`);
    - else the value nearest to 0.5, if one of them is unknown (`0.25 <= p <= 0.65`); of two equally
      near values the larger;
    - else, all being free, the largest.

    So no wall is lost and no unknown cell becomes free. The last row and column may reach beyond
    the old map; the part beyond is ignored. The result has `ceil(H resolution / new_resolution)`
    rows, likewise columns, and the dtype of the input.
    """
    resolution = _checks.number("resolution", resolution, above=0.0)
    new_resolution = _checks.number("new_resolution", new_resolution, above=0.0)
    values = np.asarray(probability)
    if values.ndim != 2 or values.size == 0:
        raise ValueError(f"probability has shape {values.shape}; accepted: (H, W) with H, W >= 1")
    shrink = resolution / new_resolution
    height, width = (max(1.0, float(np.ceil((n - SLIVER) * shrink))) for n in values.shape)
    if height * width > CELL_LIMIT:
        raise ValueError(
            f"new_resolution is {new_resolution}; accepted: a resolution of at most {CELL_LIMIT} "
            f"cells, not {height:.6g} x {width:.6g}"
        )
    rows = _overlaps(values.shape[0], int(height), new_resolution / resolution)
    columns = _overlaps(values.shape[1], int(width), new_resolution / resolution)

    def reduce(operation: np.ufunc, cells: NDArray[np.floating]) -> NDArray[np.floating]:
        return _reduce(operation, _reduce(operation, cells, rows, 0), columns, 1)

    largest = reduce(np.maximum, values)
    # If no cell is occupied, these two are the values nearest to 0.5 on either side. If all are
    # free, `above` is infinite and `below` is the largest value.
    above = reduce(np.minimum, np.where(values >= 0.5, values, values.dtype.type(np.inf)))
    below = reduce(np.maximum, np.where(values < 0.5, values, values.dtype.type(-np.inf)))
    nearest = np.where(above - 0.5 <= 0.5 - below, above, below)
    return np.where(largest > _OCCUPIED_THRESHOLD, largest, nearest)


def _overlaps(size: int, new_size: int, ratio: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the first and last old cell along an axis that each new cell overlaps."""
    # A new cell larger than the whole axis covers all of it. The bound also avoids infinity here.
    edges = np.arange(new_size + 1) * min(ratio, float(size))
    first = np.floor(edges[:-1] + SLIVER).astype(np.intp)
    last = np.ceil(edges[1:] - SLIVER).astype(np.intp) - 1
    return np.clip(first, 0, size - 1), np.clip(last, 0, size - 1)


def _reduce(
    operation: np.ufunc,
    values: NDArray[np.floating],
    overlaps: tuple[NDArray[np.intp], NDArray[np.intp]],
    axis: int,
) -> NDArray[np.floating]:
    """Reduce the old cells that each new cell overlaps along an axis."""
    # One pass per offset, over all new cells at once: they overlap only a few old cells each.
    first, last = overlaps
    result = np.take(values, first, axis=axis)
    for offset in range(1, int((last - first).max()) + 1):
        operation(result, np.take(values, np.minimum(first + offset, last), axis=axis), out=result)
    return result
