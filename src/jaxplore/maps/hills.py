"""Compute the elevation of smooth hills, in double precision; not for traced code."""

import numpy as np
from numpy.typing import NDArray

from jaxplore._types import Rows, Vector

Values = NDArray[np.float64]


def hill_elevation(
    hills: Rows, shape: tuple[int, int], resolution: float, corner: Vector = (0.0, 0.0)
) -> Values:
    """Return the elevation (H, W) at the centre of each cell [m], the sum of hills

        z(d) = height cos^2(pi d / (2 radius))  for d < radius,  0 beyond

    with d the distance from the top of the hill. A hill is smooth and exactly 0 outside its radius.
    Its greatest slope is `|height| pi / (2 radius)`, half-way down. A negative height is a pit.

    Hills (N, 4) are finite numbers (x, y, height, radius) in the world [m], radius > 0; N may be 0.
    `corner` is the outer corner (x, y) of cell (0, 0) [m].
    """
    elevation = np.zeros(shape)
    for x, y, height, radius in np.reshape(np.asarray(hills, np.float64), (-1, 4)):
        gaps = _gaps((x, y), shape, resolution, corner)
        # Evaluate only the bounding box: hills are small compared with the map.
        rows, columns = (np.flatnonzero(np.abs(gap) < radius) for gap in gaps)
        share = np.hypot(gaps[0][rows, None], gaps[1][columns]) / radius
        rise = np.where(share < 1.0, height * np.cos(np.pi / 2 * share) ** 2, 0.0)
        elevation[np.ix_(rows, columns)] += rise
    return elevation


def is_on_map(
    hill: Vector, shape: tuple[int, int], resolution: float, corner: Vector = (0.0, 0.0)
) -> bool:
    """Return whether the centre of some cell is within a hill's radius; see `hill_elevation`."""
    x, y, _, radius = np.asarray(hill, np.float64)
    nearest = (np.abs(gap).min() for gap in _gaps((x, y), shape, resolution, corner))
    return bool(np.hypot(*nearest) < radius)


def _gaps(
    top: Vector, shape: tuple[int, int], resolution: float, corner: Vector
) -> tuple[Values, Values]:
    """Return the signed distances of rows (H,) and columns (W,) from the top along y and x [m]."""
    # Subtract the corner first, so that a world far from the origin gets exactly the same hills.
    x, y = np.asarray(top, np.float64) - np.asarray(corner, np.float64)
    rows, columns = ((np.arange(size) + 0.5) * resolution for size in shape)
    return rows - y, columns - x
