"""A picture of a run: the map, the tour, and the driven path coloured by the kind of its metres."""

from typing import TYPE_CHECKING

import numpy as np

from benchmarks.bound.metres import KINDS
from benchmarks.bound.run import LEVELS, Bound, Driven
from jaxplore.report.drawing.colours import OCCUPIED, belief_colours, shade
from jaxplore.report.exploration.map_axes import (
    add_outline,
    map_figure_axes,
    map_inches,
    show_cells,
)
from jaxplore.report.exploration.window import Window

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = dict(zip(KINDS, ("#2a9d5c", "#e9a23b", "#d1495b", "#7d5690", "#1c64be"), strict=True))
"""Colour of each kind of metres."""
MOSTLY = 0.3
"""Share of dithering from which a step is drawn as dithering."""


def picture(driven: Driven, bound: Bound) -> "Figure":
    """Draw a run and the tour to the highest level.

    A step with more than `MOSTLY` of dithering has the colour of dithering. A rotated map is drawn
    along its own axes.

    Args:
        driven: the run.
        bound: bounds of its map.
    """
    from matplotlib.collections import LineCollection

    recording, split = driven.recording, driven.split
    window = Window.around_reachable(recording)
    corner = window.corner
    width, height = map_inches(window, least=4.2)
    figure, axes = map_figure_axes(width + 0.8, height + 1.5, window)
    levels = np.round(255.0 * window.crop(recording.world, 0.5)).astype(np.uint8)
    show_cells(axes, window, belief_colours()[levels])
    add_outline(axes, recording, window)
    tour = bound.tours[LEVELS[-1]]
    line = driven.problem.to_world(tour.line) + driven.offset
    axes.plot(
        *(window.place(line) + corner).T,
        color=shade(OCCUPIED),
        linewidth=1.6,
        linestyle=(0, (4, 1.5)),
        label=f"tour to {LEVELS[-1]} %: {tour.metres:.1f} m",
        zorder=4,
    )
    kind = np.where(split.dithering > MOSTLY, KINDS.index("dithering"), split.kind)
    track = window.place(recording.positions) + corner
    lengths = split.lengths()
    for index, name in enumerate(KINDS):
        # Each step between two scans is drawn with all the positions between them.
        lines = [
            track[driven.instants[step] : driven.instants[step + 1] + 1].tolist()
            for step in np.flatnonzero(kind == index)
        ]
        axes.add_collection(
            LineCollection(lines, colors=COLOURS[name], linewidths=2.6, capstyle="round", zorder=3),
            autolim=False,
        )
        axes.plot(
            [], [], color=COLOURS[name], linewidth=3.0, label=f"{name}: {lengths[name]:.1f} m"
        )
    axes.plot(
        *track[0],
        marker="o",
        markersize=9.0,
        color="#2a9d5c",
        markeredgecolor="white",
        linestyle="none",
        label="start",
        zorder=5,
    )
    columns = 4 if width > 5.0 else 2
    figure.legend(loc="outside lower center", ncols=columns, frameon=False, fontsize=9)
    metres = driven.metrics.path_length
    figure.suptitle(
        f"{driven.map_name}, {driven.settings.architecture}: {metres:.1f} m, "
        f"{100.0 * driven.metrics.coverage:.1f} % covered",
        fontsize=11,
    )
    return figure
