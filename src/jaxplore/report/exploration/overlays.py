"""Overlays of a map: the ground, moving obstacles, the robot's outline."""

from typing import TYPE_CHECKING

import numpy as np

from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD
from jaxplore.report.drawing.colours import (
    CLOSED,
    CLOSED_SHARE,
    FREE,
    MOVER,
    MOVER_EDGE,
    blend,
    shade,
)
from jaxplore.report.drawing.picture import outline_at
from jaxplore.report.exploration.data import ExplorationData, RobotRun
from jaxplore.report.exploration.mission import MissionData
from jaxplore.report.exploration.window import Window

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CONTOURS = 8
"""Approximate number of contour lines of the elevation."""
LEAST_RELIEF = 0.02
"""Least range of the elevation for contour lines [m]."""
MAX_CONTOUR_CELLS = 250
"""Approximate number of cells along each axis from which contour lines are computed."""
CONTOUR = "#6b7f5e"
"""Colour of contour lines."""


def find_closed_cells(recording: MissionData, window: Window) -> np.ndarray:
    """Return the window's cells (R, C) of untraversable open ground."""
    if recording.traversable is None:
        return np.zeros(window.shape, bool)
    is_open = np.asarray(recording.world) <= OCCUPIED_THRESHOLD
    return window.crop(is_open & ~np.asarray(recording.traversable, bool), False)


def add_ground(axes: "Axes", recording: MissionData, window: Window) -> None:
    """Draw contour lines with their heights, and hatch untraversable ground."""
    if recording.elevation is not None:
        _add_contours(axes, np.asarray(recording.elevation), window)
    closed = find_closed_cells(recording, window)
    if not closed.any():
        return
    # One more row of cells on each side closes the hatched area at the picture's edge.
    x, y = _middles(window, around=1)
    hatched = axes.contourf(
        x,
        y,
        np.pad(closed, 1).astype(np.float64),
        levels=[0.5, 1.5],
        colors="none",
        hatches=["////"],
        zorder=1.2,
    )
    hatched.set_edgecolor(shade(CLOSED))
    hatched.set_linewidth(0.0)
    axes.fill(
        [np.nan],
        [np.nan],
        facecolor=shade(blend(CLOSED, FREE, CLOSED_SHARE)),
        edgecolor=shade(CLOSED),
        hatch="////",
        linewidth=0.0,
        label="not traversable",
    )


def _add_contours(axes: "Axes", elevation: np.ndarray, window: Window) -> None:
    from matplotlib.ticker import MaxNLocator

    stride = max(1, -(-max(window.shape) // MAX_CONTOUR_CELLS))
    height = window.crop(elevation.astype(np.float64), np.nan)[::stride, ::stride]
    if min(height.shape) < 2 or not np.isfinite(height).any():
        return
    lowest, highest = float(np.nanmin(height)), float(np.nanmax(height))
    # A contour at the lowest or the highest point would be a point and not a line.
    levels = np.asarray(MaxNLocator(CONTOURS).tick_values(lowest, highest))
    levels = levels[(levels > lowest) & (levels < highest)]
    if highest - lowest < LEAST_RELIEF or not levels.size:
        return
    x, y = _middles(window)
    lines = axes.contour(
        x[::stride],
        y[::stride],
        height,
        levels=levels,
        colors=CONTOUR,
        linewidths=0.6,
        linestyles="solid",
        alpha=0.9,
        zorder=1.3,
    )
    axes.clabel(lines, fontsize=6, fmt=lambda level: f"{level:g}", inline_spacing=2)
    axes.plot([], [], color=CONTOUR, linewidth=0.8, label="height [m]")


def _middles(window: Window, around: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return x (C,) and y (R,) of the cells' centres, with `around` more on each side [m]."""
    rows, columns = (np.arange(-around, count + around) + 0.5 for count in window.shape)
    return (
        window.corner[0] + window.resolution * columns,
        window.corner[1] + window.resolution * rows,
    )


def add_moving_obstacles(axes: "Axes", recording: ExplorationData, window: Window) -> None:
    """Draw the last positions of the moving obstacles, and faintly those in the frames."""
    from matplotlib.patches import Circle

    if not len(recording.mover_radii):
        return
    places = np.stack([frame.movers for frame in recording.frames])
    places = window.place(places) + window.corner
    dark = shade(MOVER)
    for trail, radius in zip(places.swapaxes(0, 1), recording.mover_radii.tolist(), strict=True):
        axes.plot(*trail.T, color=dark, linewidth=0.7, linestyle=":", zorder=1.6)
        disc = Circle(
            (float(trail[-1, 0]), float(trail[-1, 1])),
            radius,
            facecolor=dark,
            edgecolor=shade(MOVER_EDGE),
            linewidth=1.2,
            zorder=3.0,
        )
        axes.add_patch(disc)
    axes.plot(
        [],
        [],
        marker="o",
        color=dark,
        markeredgecolor=shade(MOVER_EDGE),
        markersize=7.0,
        linestyle=":",
        linewidth=0.7,
        label="moving obstacle",
    )


def add_footprint(axes: "Axes", robot: RobotRun, window: Window) -> None:
    """Draw the outline of a rectangular robot at the start and at the end."""
    from matplotlib.patches import Polygon

    if not len(robot.footprint) or "yaw" not in robot.columns:
        return
    headings = robot.states[[0, -1], robot.columns["yaw"]]
    for position, heading in zip(robot.positions[[0, -1]], headings, strict=True):
        corners = outline_at(robot.footprint, position, float(heading))
        outline = Polygon(
            window.place(corners) + window.corner,
            fill=False,
            edgecolor=shade(MOVER),
            linewidth=1.2,
            zorder=4.5,
        )
        axes.add_patch(outline)
    axes.plot(
        [],
        [],
        marker="s",
        markerfacecolor="none",
        markeredgecolor=shade(MOVER),
        linestyle="none",
        label="robot",
    )
