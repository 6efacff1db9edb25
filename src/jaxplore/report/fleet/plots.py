"""Figures of an exploration by a fleet: the map with all trails, and the coverage."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.report.coverage_levels import LEVELS
from jaxplore.report.drawing.colours import belief_colours
from jaxplore.report.drawing.palette import INK
from jaxplore.report.drawing.series import line_style, style_time
from jaxplore.report.exploration.localisation import ESTIMATE
from jaxplore.report.exploration.map_axes import (
    add_outline,
    map_figure_axes,
    map_inches,
    show_cells,
)
from jaxplore.report.exploration.overlays import add_ground, add_targets
from jaxplore.report.exploration.progress import is_known_map
from jaxplore.report.exploration.window import Window
from jaxplore.report.fleet.data import FleetData
from jaxplore.report.fleet.metrics import compute_metrics

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_POINTS = 2000
"""Greatest number of points of a trail in the figure."""


def map_figure(data: FleetData) -> "Figure":
    """Draw what the robots know together at the end, with the trail of each in its colour.

    A rotated map is drawn along its own axes.
    """
    window = Window.around_reachable(data)
    width, height = map_inches(window)
    figure, axes = map_figure_axes(width + 0.8, height + 1.2, window)
    levels = np.round(255.0 * window.crop(data.belief, 0.5)).astype(np.uint8)
    show_cells(axes, window, belief_colours()[levels])
    stride = max(1, -(-data.trails.shape[1] // MOST_POINTS))
    marks: dict[str, Any] = {"linestyle": "none", "markeredgecolor": "white", "zorder": 5.0}
    for number, (trail, length) in enumerate(zip(data.trails, data.lengths[:, -1], strict=True)):
        placed = window.place(np.concatenate([trail[::stride], trail[-1:]])) + window.corner
        style = line_style(number)
        name = f"robot {number + 1}: {length:.1f} m"
        axes.plot(*placed.T, linewidth=1.6, label=name, zorder=4.0, **style)
        axes.plot(*placed[0], marker="o", markersize=7.0, color=style["color"], **marks)
        axes.plot(*placed[-1], marker="s", markersize=8.0, color=style["color"], **marks)
        if data.localisation is not None:
            place = data.localisation[number].poses[:, :2]
            track = window.place(place) + window.corner
            axes.plot(*track.T, linestyle="--", linewidth=1.0, color=ESTIMATE, zorder=4.5)
    if data.localisation is not None:
        axes.plot([], [], linestyle="--", linewidth=1.0, color=ESTIMATE, label="estimated ways")
    if data.goal is not None:
        spot = (window.place(data.goal[None]) + window.corner)[0]
        axes.plot(*spot, marker="*", markersize=12.0, color="#e9a23b", label="goal", **marks)
    for marker, name in (("o", "start"), ("s", "end")):
        axes.plot([], [], marker=marker, color="0.4", linestyle="none", label=name)
    add_ground(axes, data, window)
    add_targets(axes, data, window)
    for each in data.parts.values():
        each.add_to_map(axes, data, window)
    add_outline(axes, data, window)
    columns = 4 if width > 5.0 else 2
    figure.legend(loc="outside lower center", ncols=columns, frameon=False, fontsize=9)
    driven = data.lengths[:, -1].sum()
    title = f"{data.time[-1]:.1f} s, {driven:.1f} m"
    if not is_known_map(data):
        title = f"{100.0 * data.coverage[-1]:.1f} % covered, {title}"
    if len(data.targets):
        title += f", targets {int(data.frames[-1].is_found.sum())} of {len(data.targets)}"
    figure.suptitle(title, fontsize=11)
    return figure


def coverage_figure(data: FleetData) -> "Figure":
    """Draw the coverage by all robots together and by the map of each, and the distances driven."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.0, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1.0])
    duration, metrics = max(float(data.time[-1]), data.control_period), compute_metrics(data)
    ink = np.asarray(INK) / 255.0
    # Wide and pale, below the curves of the robots that it is the upper bound of.
    above.plot(data.time, 100.0 * data.coverage, color="0.78", linewidth=5.0, label="together")
    for number, (rows, length) in enumerate(zip(data.coverages, data.lengths, strict=True)):
        style = line_style(number)
        above.plot(data.time, 100.0 * rows, linewidth=1.2, label=f"robot {number + 1}", **style)
        below.plot(data.time, length, linewidth=1.4, **style)
    if data.target_coverage is not None:
        level, name = 100.0 * data.target_coverage, f"target: {100.0 * data.target_coverage:.3g} %"
        above.axhline(level, color="0.6", linewidth=0.8, linestyle="--", label=name)
    for share in LEVELS:
        seconds = metrics.time_to[str(share)]
        if seconds is not None:
            label = f"{share} %: {seconds:.1f} s"
            above.plot([seconds], [share], "o", color=ink, markersize=5.0 + share / 50, label=label)
    above.set(ylim=(0.0, 104.0), ylabel="coverage [%]")
    below.set(ylabel="driven [m]", ylim=(0.0, None))
    for axes in (above, below):
        style_time(axes, duration)
    above.set_xlabel("")
    figure.legend(loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    return figure
