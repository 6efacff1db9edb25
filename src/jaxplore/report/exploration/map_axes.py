"""What the figures of a map have in common: their size, axes, picture and true outline."""

from typing import TYPE_CHECKING

import numpy as np

from jaxplore.maps.occupancy_grid import FREE_THRESHOLD
from jaxplore.report.drawing.colours import OUTLINE
from jaxplore.report.drawing.scale_bar import add_scale_bar
from jaxplore.report.exploration.window import MapData, Window

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LONGEST_SIDE = 9.0
"""Size of the longer side of a map in a figure [inches]."""


def map_inches(window: Window, least: float = 3.2) -> tuple[float, float]:
    """Return the width and height of a map [inches], at least `least` wide for a legend below."""
    size = np.asarray(window.size)
    width, height = np.clip(LONGEST_SIDE * size / size.max(), [least, 2.0], LONGEST_SIDE)
    return float(width), float(height)


def map_figure_axes(width: float, height: float, window: Window) -> tuple["Figure", "Axes"]:
    """Return a new figure of a width and height [inches], with the axes of a map."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="compressed")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    frame_map(axes, window)
    return figure, axes


def frame_map(axes: "Axes", window: Window) -> None:
    """Give axes the limits, the labels and the scale bar of a map.

    The axes are the world's, or the grid's own if it is rotated.
    """
    left, right, bottom, top = window.extent
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    prefix = "grid " if window.is_turned else ""
    axes.set_xlabel(f"{prefix}x [m]")
    axes.set_ylabel(f"{prefix}y [m]")
    add_scale_bar(axes)


def show_cells(axes: "Axes", window: Window, colours: np.ndarray) -> None:
    """Draw the cells of a window in their colours (rows, columns, 3)."""
    axes.imshow(colours, extent=window.extent, origin="lower", interpolation="nearest")


def add_outline(axes: "Axes", recording: MapData, window: Window) -> None:
    """Draw the outline of the true free space, with an entry of the legend."""
    from matplotlib.collections import LineCollection

    outline = true_outline(recording, window) + window.corner
    axes.add_collection(
        LineCollection(outline.tolist(), colors=OUTLINE, linewidths=0.7, zorder=1.5), autolim=False
    )
    axes.plot([], [], color=OUTLINE, linewidth=1.2, label="true outline")


def true_outline(
    recording: MapData, window: Window, beside: np.ndarray | None = None
) -> np.ndarray:
    """Return the edges (N, 2, 2) between solid cells and the free space around the reachable cells.

    They are in metres from the window's corner, along the grid's axes. With `beside` (H, W), an
    edge must be at one of these cells of the map.
    """
    import scipy.ndimage  # slow to import, and few need it

    labels, _ = scipy.ndimage.label(np.asarray(recording.world) < FREE_THRESHOLD)
    seen = np.unique(labels[np.asarray(recording.reachable, bool)])
    # A rim of cells outside closes the outline at the border of the map.
    inside = np.pad(window.crop(np.isin(labels, seen[seen > 0]), False), 1)
    near = np.ones_like(inside)
    if beside is not None:
        near = np.pad(window.crop(beside, False), 1)
    differs = (inside[1:-1, 1:] != inside[1:-1, :-1]) & (near[1:-1, 1:] | near[1:-1, :-1])
    row, column = np.nonzero(differs)
    upright = np.stack([column, row, column, row + 1], axis=-1)
    differs = (inside[1:, 1:-1] != inside[:-1, 1:-1]) & (near[1:, 1:-1] | near[:-1, 1:-1])
    row, column = np.nonzero(differs)
    level = np.stack([column, row, column + 1, row], axis=-1)
    edges = np.concatenate([upright, level]).reshape(-1, 2, 2)
    return np.asarray(edges * recording.resolution)
