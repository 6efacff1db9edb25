"""Rasterise shapes on a grid, in double precision; not for traced code.

No obstacle gets lost: if a shape contains no cell centre, the cell that contains the middle of the
shape is marked, provided that it is on the map.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from jaxplore import _checks
from jaxplore._types import Rows, Vector
from jaxplore.maps.frame import GridFrame

TOLERANCE = 1e-9
"""Distance beyond a boundary at which a centre still counts as on it [m].

Rounding makes it necessary: 3.5 x 0.1 is not 0.35 in binary."""

Mask = NDArray[np.bool_]
Points = NDArray[np.float64]
Window = tuple[slice, slice]


def segment_mask(segments: Rows, frame: GridFrame, shape: tuple[int, int], reach: float) -> Mask:
    """Return the cells (H, W) whose centre is within a distance `reach` [m] of a segment.

        min over t in [0, 1] of |c - a - t (b - a)| <= reach

    With a reach of at least half a cell a segment has no gaps: in each column that it crosses (row,
    if it is steep), the nearest centre is at most half a cell away. A segment with no centre within
    reach marks the cell of its midpoint.

    Segments (N, 4) are (x1, y1, x2, y2) in the world [m]; N may be 0. A row that is not four finite
    numbers, or a negative reach, raises a `ValueError`.
    """
    reach = _checks.number("reach", reach, at_least=0.0)
    mask = np.zeros(shape, bool)
    rows = _rows("segments", segments, 4, "(N, 4) finite numbers (x1, y1, x2, y2)")
    for a, b in rows.reshape(-1, 2, 2):
        window, centres = _cells_near(
            np.minimum(a, b) - reach, np.maximum(a, b) + reach, mask, frame
        )
        along = b - a
        # A segment of length zero is a point: keep the division finite.
        squared = max(float(along @ along), np.finfo(np.float64).tiny)
        share = np.clip((centres - a) @ along / squared, 0.0, 1.0)
        gap = centres - (a + share[..., None] * along)
        inside = np.hypot(gap[..., 0], gap[..., 1]) <= reach + TOLERANCE
        _mark(mask, window, inside, (a + b) / 2, frame)
    return mask


def rectangle_mask(
    rectangles: Rows, frame: GridFrame, shape: tuple[int, int], *, is_solid: bool = True
) -> Mask:
    """Return the cells (H, W) whose centre is in a rectangle, `[x_min, x_max) x [y_min, y_max)`.

    Rectangles are aligned with the axes of the world. Two that share an edge share no cell, as in
    `jaxplore.belief.Zones.from_rectangles`. With `is_solid` a side shorter than a cell is
    lengthened to one cell about the same middle, with both ends included, so that a thin wall has
    no gaps. On a grid without yaw this adds no cell where a centre is inside already. Otherwise a
    rectangle that contains no cell centre marks no cell.

    Rectangles (N, 4) are (x_min, y_min, x_max, y_max) in the world [m]; N may be 0. A row that is
    not four finite numbers, or a minimum that is not below its maximum, raises a `ValueError`.
    """
    mask = np.zeros(shape, bool)
    rows = _rows(
        "rectangles",
        rectangles,
        4,
        "(N, 4) finite numbers (x_min, y_min, x_max, y_max), min < max",
        lambda row: bool((row[:2] < row[2:]).all()),
    )
    half = frame.resolution / 2
    for low, high in rows.reshape(-1, 2, 2):
        middle = (low + high) / 2
        # The margin keeps a side of exactly one cell, up to rounding, half-open.
        is_thin = is_solid & (high - low < frame.resolution - 4 * TOLERANCE)
        first = np.where(is_thin, middle - half, low) - TOLERANCE
        last = np.where(is_thin, middle + half + TOLERANCE, high - TOLERANCE)
        window, centres = _cells_near(first, last, mask, frame)
        inside = ((centres >= first) & (centres < last)).all(axis=-1)
        if is_solid:
            _mark(mask, window, inside, middle, frame)
        else:
            mask[window] |= inside
    return mask


def disc_mask(discs: Rows, frame: GridFrame, shape: tuple[int, int]) -> Mask:
    """Return the cells (H, W) whose centre is in a disc, `|c - (x, y)| <= radius`.

    A disc that contains no cell centre marks the cell of its own centre. Discs (N, 3) are (x, y,
    radius) in the world [m], checked.
    """
    mask = np.zeros(shape, bool)
    accepted = "(N, 3) finite numbers (x, y, radius), radius > 0"
    for row in _rows("discs", discs, 3, accepted, lambda row: bool(row[2] > 0)):
        middle, radius = row[:2], float(row[2])
        window, centres = _cells_near(middle - radius, middle + radius, mask, frame)
        gap = centres - middle
        inside = np.hypot(gap[..., 0], gap[..., 1]) <= radius + TOLERANCE
        _mark(mask, window, inside, middle, frame)
    return mask


def cell_at(point: Vector, frame: GridFrame) -> tuple[int, int]:
    """Return the cell (row, column) that contains a world point (x, y) [m]; it may be off the map.

    It is `GridFrame.to_cell` in double precision. A point within rounding of an edge belongs to the
    cell with the greater index.
    """
    cell = np.floor(_to_grid(np.asarray(point, np.float64), frame) + TOLERANCE)
    return int(cell[0]), int(cell[1])


def _rows(
    name: str,
    value: Rows,
    count: int,
    accepted: str,
    is_accepted: Callable[[Points], bool] = lambda row: True,
) -> Points:
    try:
        rows = np.asarray(value, np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"{name} is {value!r}; accepted: {accepted}") from None
    if rows.size == 0:
        return np.zeros((0, count))
    if rows.ndim != 2 or rows.shape[1] != count:
        raise ValueError(f"{name} has shape {rows.shape}; accepted: {accepted}")
    for index, row in enumerate(rows):
        if not np.isfinite(row).all() or not is_accepted(row):
            raise ValueError(f"{name}[{index}] is {row.tolist()}; accepted: {accepted}")
    return rows


def _pose(frame: GridFrame) -> tuple[Points, float, float]:
    x, y, yaw = np.asarray(frame.origin, np.float64)
    return np.array([x, y]), float(np.cos(yaw)), float(np.sin(yaw))


def _to_grid(points: Points, frame: GridFrame) -> Points:
    corner, cos, sin = _pose(frame)
    x, y = np.moveaxis(points - corner, -1, 0)
    return np.stack([cos * y - sin * x, cos * x + sin * y], axis=-1) / frame.resolution


def _cells_near(low: Points, high: Points, mask: Mask, frame: GridFrame) -> tuple[Window, Points]:
    """Return the window of map cells around a box in the world, and their centres (x, y) [m]."""
    # The grid may have a yaw: take the bounding box of the corners in grid coordinates.
    corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    grid = _to_grid(corners, frame)
    # One more cell on each side makes up for rounding.
    first = np.clip(np.floor(grid.min(axis=0)) - 1, 0, mask.shape).astype(int)
    last = np.clip(np.ceil(grid.max(axis=0)) + 1, 0, mask.shape).astype(int)
    window = slice(first[0], last[0]), slice(first[1], last[1])
    y, x = (np.mgrid[window] + 0.5) * frame.resolution
    corner, cos, sin = _pose(frame)
    return window, np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1) + corner


def _mark(mask: Mask, window: Window, inside: Mask, middle: Points, frame: GridFrame) -> None:
    """Mark the cells inside a shape, or the cell of its middle if there are none."""
    mask[window] |= inside
    if not inside.any():
        row, column = cell_at(middle, frame)
        if 0 <= row < mask.shape[0] and 0 <= column < mask.shape[1]:
            mask[row, column] = True
