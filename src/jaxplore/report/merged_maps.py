"""Figure of maps that were merged."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from jaxplore.maps.datum import Datum
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OCCUPIED_THRESHOLD, OccupancyGrid
from jaxplore.report.drawing.colours import SERIES, UNKNOWN, belief_colours, shade
from jaxplore.report.drawing.scale_bar import add_scale_bar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BORDER = 1.0
"""Width of what is drawn around the known cells [m]."""
INCHES = 9.0
"""Greatest side of the map in the figure."""


def merged_figure(
    merged: OccupancyGrid, parts: Sequence[tuple[str, OccupancyGrid, np.ndarray]], datum: Datum
) -> "Figure":
    """Draw a merged map, with the walls of each of its maps in a colour of its own.

    Args:
        merged: the merged map.
        parts: name, map, and pose of its frame in that of the merged one, of each map.
        datum: point to which the merged map is relative.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.transforms import Affine2D

    values = merged.crop(merged.probability)
    known = np.argwhere((values < FREE_THRESHOLD) | (values > OCCUPIED_THRESHOLD))
    origin = datum.to_map(np.asarray(merged.frame.origin, np.float64))
    outer = _placed(known + 0.5, merged.resolution, origin)
    low, high = outer.min(axis=0) - BORDER, outer.max(axis=0) + BORDER
    inches = np.clip(INCHES * (high - low) / (high - low).max(), 3.0, INCHES)
    figure = Figure(figsize=(inches[0] + 0.8, inches[1] + 0.9), layout="compressed")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    side = np.array(values.shape[::-1]) * merged.resolution
    axes.imshow(
        belief_colours()[np.round(255.0 * values).astype(np.uint8)],
        extent=(0.0, float(side[0]), 0.0, float(side[1])),
        origin="lower",
        interpolation="nearest",
        transform=Affine2D().rotate(float(origin[2])).translate(*origin[:2]) + axes.transData,
    )
    # Beyond the map nothing is known.
    axes.set_facecolor(shade(UNKNOWN))
    for index, (name, grid, pose) in enumerate(parts):
        walls = np.argwhere(grid.crop(grid.probability) > OCCUPIED_THRESHOLD)
        points = _placed(walls + 0.5, grid.resolution, np.asarray(grid.frame.origin, np.float64))
        x, y = datum.to_map(_moved(points, pose)).T
        colour = SERIES[index % len(SERIES)]
        axes.plot(
            x, y, "s", color=colour, markersize=1.1, alpha=0.5, markeredgewidth=0, rasterized=True
        )
        axes.plot([], [], "s", color=colour, markersize=6.0, label=f"walls of {name}")
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    add_scale_bar(axes)
    figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=9)
    return figure


def _placed(cells: np.ndarray, side: float, origin: np.ndarray) -> np.ndarray:
    """Return points (row, column) of a grid in its frame (N, 2) [m]."""
    return _moved(cells[:, ::-1] * side, origin)


def _moved(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Return points (N, 2) of the frame of a pose in the frame of that pose [m]."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return np.asarray(points @ np.array([[cos, sin], [-sin, cos]]) + pose[:2])
