"""How controllers are compared on several paths."""

import numpy as np

from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.maps.files.path_file import path_datum, read_path_file
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.tasks.kind import OnMaps
from jaxplore.tasks.path.build import build_path, build_path_following
from jaxplore.tasks.path.settings import TRACK, PathSettings

SUFFIXES = (".csv", ".txt")
"""Endings of paths in a folder; YAML files there may be anything."""
WIDE = 500
"""Cells of the longer side of a plan."""


def plan_path(settings: PathSettings) -> tuple[OccupancyGrid, Datum]:
    """Return the corridor of a path, or a narrow band without one, and the datum.

    Cells are free where the nearest point of the path is nearer than its narrower side.
    """
    import scipy.spatial  # slow to import, and few need it

    datum = ORIGIN if settings.path == TRACK else path_datum(settings.path)
    path = build_path(settings, datum)
    points = np.asarray(path.points, np.float64)
    rooms = np.asarray(path.half_widths, np.float64).min(axis=1)
    size = float(np.ptp(points, axis=0).max())
    rooms = np.where(np.isfinite(rooms), rooms, 0.01 * size)
    margin = float(rooms.max()) + 0.02 * size
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    side = float((high - low).max()) / WIDE
    columns, rows = np.ceil((high - low) / side).astype(int)
    x, y = (low[axis] + side * (np.arange(n) + 0.5) for axis, n in enumerate((columns, rows)))
    cells = np.stack(np.meshgrid(x, y), axis=-1)
    distance, nearest = scipy.spatial.cKDTree(points).query(cells)
    corridor = np.where(distance <= rooms[nearest], 0.0, 0.5).astype(np.float32)
    return OccupancyGrid(corridor, side, (*low.tolist(), 0.0)), datum


ALONG_PATHS = OnMaps(
    files="path",
    accepted=f"files that end with {', '.join(SUFFIXES)}",
    is_file=lambda path: path.suffix.lower() in SUFFIXES,
    read=lambda path: (read_path_file(path),),
    plan=plan_path,
    build=lambda settings, _: build_path_following(settings),
    names=(TRACK,),
    shared=("robot", "track"),
)
