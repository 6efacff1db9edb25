"""One map of two, of which the relative pose is known."""

import math

import numpy as np
from numpy.typing import NDArray

from jaxplore import _checks, _kinds
from jaxplore._types import Vector
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OCCUPIED_THRESHOLD, OccupancyGrid
from jaxplore.maps.resample import CELL_LIMIT

CERTAIN = 0.001
"""Probabilities nearer to 0 or 1 count as this far from it: two certain maps can disagree."""
BESIDE = 0.2
"""Distance from a wall of a map within which that a cell is free there says nothing of a wall of
the other one [m]: the same wall may be a few cells off."""
PARTS = 2
"""Points along each side of a cell at which the other map is read, so that thin walls do not fall
between them."""


@_kinds.check_arguments
def unite_maps(one: OccupancyGrid, other: OccupancyGrid, pose: Vector) -> OccupancyGrid:
    """Return one map of all that two maps know, in the frame and with the cells of the one.

    Log-odds are added:

        l = l_one + l_other

    with probabilities of at least 0.001 from 0 and 1. So the scans of both count, those of maps
    that share scans twice. A cell that one map has seen free and the other one as a wall is unknown
    where both are equally certain. A wall a few cells off is no such case: within 0.2 m of its own
    walls a map does not call a wall of the other one free.

    Args:
        one: map in whose frame the result is.
        other: the other map.
        pose: pose (x, y, yaw) of the frame of the other map in that of the one [m, m, rad], as
            `jaxplore.localisation.match_maps` finds it.

    Raises:
        ValueError: a pose that is not three finite numbers; maps that are so far apart that the
            result has more than 64 million cells.
    """
    from scipy.ndimage import distance_transform_edt  # slow to import, and few need it

    x, y, yaw = np.asarray(_checks.vector("pose", pose, 3), np.float64).tolist()
    own, theirs = (each.crop(each.probability) for each in (one, other))
    cell = one.resolution
    # Of the grid of the other map as seen in the grid of the one, in cells of each.
    first, second = (np.asarray(each.frame.origin, np.float64) for each in (one, other))
    turn = yaw + second[2] - first[2]
    corner = _turned(second[:2], yaw) + np.array([x, y]) - first[:2]
    corner = _turned(corner, -first[2]) / cell
    ends = np.array([(a, b) for a in (0, theirs.shape[1]) for b in (0, theirs.shape[0])], float)
    ends = _turned(ends * (other.resolution / cell), turn) + corner
    low = np.minimum(np.floor(ends.min(axis=0)), 0.0)
    high = np.maximum(np.ceil(ends.max(axis=0)), own.shape[::-1])
    columns, rows = high - low
    if not rows * columns <= CELL_LIMIT:
        raise ValueError(
            f"pose is {[x, y, yaw]}, by which the maps together have {rows:.6g} x {columns:.6g} "
            f"cells; accepted: at most {CELL_LIMIT} cells"
        )
    height, width = int(rows), int(columns)
    known = np.full((height, width), 0.5, np.float32)
    right, up = (-low).astype(int)
    known[up : up + own.shape[0], right : right + own.shape[1]] = own
    # The most cautious of the points: a wall, else what is unknown.
    added = np.max(
        [
            _read(theirs, (height, width), low + shift, corner, turn, cell, other.resolution)
            for shift in (np.argwhere(np.ones((PARTS, PARTS))) + 0.5) / PARTS
        ],
        axis=0,
    )
    united = _add(known, added)
    for a, b in ((known, added), (added, known)):
        walls = a > OCCUPIED_THRESHOLD
        if not (b > OCCUPIED_THRESHOLD).any():
            continue
        beside = distance_transform_edt(b <= OCCUPIED_THRESHOLD) * cell <= BESIDE
        is_kept = walls & (b < FREE_THRESHOLD) & beside
        united[is_kept] = a[is_kept]
    corner = first[:2] + _turned(low * cell, first[2])
    return OccupancyGrid(united, cell, (*corner.tolist(), float(first[2])))


def _turned(points: np.ndarray, yaw: float) -> np.ndarray:
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.asarray(points @ np.array([[cos, sin], [-sin, cos]]))


def _read(
    values: np.ndarray,
    shape: tuple[int, int],
    begin: np.ndarray,
    corner: np.ndarray,
    turn: float,
    cell: float,
    side: float,
) -> NDArray[np.float32]:
    """Return the values of a map at the points of a lattice of another one; 0.5 off the map.

    Args:
        values: probabilities (H, W) of the map.
        shape: rows and columns of the lattice.
        begin: its first point (x, y) [cells of the lattice].
        corner: corner of the map there.
        turn: yaw of the map there [rad].
        cell: spacing of the lattice [m].
        side: side of a cell of the map [m].
    """
    cos, sin = math.cos(turn), math.sin(turn)
    x = (np.arange(shape[1]) + begin[0] - corner[0]) * (cell / side)
    y = ((np.arange(shape[0]) + begin[1] - corner[1]) * (cell / side))[:, None]
    columns = np.floor(cos * x + sin * y).astype(np.int64)
    rows = np.floor(cos * y - sin * x).astype(np.int64)
    is_on = (rows >= 0) & (rows < values.shape[0]) & (columns >= 0) & (columns < values.shape[1])
    found = values[np.where(is_on, rows, 0), np.where(is_on, columns, 0)]
    return np.where(is_on, found, np.float32(0.5)).astype(np.float32)


def _add(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return the probabilities of the sums of log-odds; where one map knows nothing, the other."""
    odds = [
        np.log(each / (1.0 - each))
        for each in (np.clip(p.astype(np.float64), CERTAIN, 1.0 - CERTAIN) for p in (one, other))
    ]
    total = (1.0 / (1.0 + np.exp(-(odds[0] + odds[1])))).astype(np.float32)
    total = np.where(other == 0.5, one, np.where(one == 0.5, other, total))
    return np.asarray(total, np.float32)
