"""Figures of an exploration run: the map and the coverage."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD
from jaxplore.report.coverage_levels import LEVELS
from jaxplore.report.drawing.colours import (
    CLOSED,
    CLOSED_SHARE,
    MISSED,
    SERIES,
    belief_colours,
    shade,
)
from jaxplore.report.drawing.series import line_style, style_count
from jaxplore.report.exploration.data import TEAM, ExplorationData, RobotRun
from jaxplore.report.exploration.evaluation import compute_metrics
from jaxplore.report.exploration.localisation import add_estimate
from jaxplore.report.exploration.map_axes import (
    add_outline,
    map_figure_axes,
    map_inches,
    show_cells,
    true_outline,
)
from jaxplore.report.exploration.overlays import (
    add_footprint,
    add_ground,
    add_moving_obstacles,
    find_closed_cells,
)
from jaxplore.report.exploration.progress import is_known_map, progress
from jaxplore.report.exploration.window import Window
from jaxplore.report.part import Tally

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

MARKS: dict[str, Any] = {
    "markersize": 9.0,
    "markeredgecolor": "white",
    "linestyle": "none",
    "zorder": 5.0,
}
"""Style of the marks of the start, the end and the goal."""
MAX_SEGMENTS = 2000
"""Number of segments of the path that are coloured by time."""


def map_figure(recording: ExplorationData) -> "Figure":
    """Draw the final belief with the robot's path and the outline of the true free space.

    Walls that the belief lacks are red, with a line that is as wide in the picture of a large map:
    they were not seen, or a robot that estimates its pose has drawn them elsewhere. Of several
    robots each has a colour; the path of one is coloured by time. A rotated map is drawn along its
    own axes.
    """
    window = Window.around_reachable(recording)
    width, height = map_inches(window)
    figure, axes = map_figure_axes(width + 1.8, height + 1.1, window)
    levels = np.round(255.0 * window.crop(recording.belief, 0.5)).astype(np.uint8)
    colours = belief_colours()[levels]
    closed = find_closed_cells(recording, window)
    tint = CLOSED_SHARE * (np.asarray(CLOSED) - colours[closed].astype(np.float64))
    colours[closed] = np.round(colours[closed] + tint).astype(np.uint8)
    unseen = _unseen_walls(recording)
    colours[window.crop(unseen, False)] = MISSED
    show_cells(axes, window, colours)
    time, coverage, _, path = progress(recording)
    lines = None if TEAM in recording.parts else _time_lines(recording, window, time)
    if lines is not None:
        axes.add_collection(lines, autolim=False)
    for each in recording.robots:
        _add_track(axes, each, window, is_one=lines is not None)
    if lines is None:
        for marker, name in (("o", "start"), ("s", "end")):
            axes.plot([], [], marker=marker, color="0.4", linestyle="none", label=name)
    if recording.goal is not None:
        spot = (window.place(recording.goal[None]) + window.corner)[0]
        axes.plot(*spot, marker="*", color="#e9a23b", label="goal", **MARKS)
    add_outline(axes, recording, window)
    _draw_missed_walls(axes, recording, window, unseen)
    add_ground(axes, recording, window)
    add_moving_obstacles(axes, recording, window)
    for part in recording.parts.values():
        part.add_to_map(axes, recording, window)
    for each in recording.robots:
        add_footprint(axes, each, window)
        add_estimate(axes, each, window)
    handles, labels = axes.get_legend_handles_labels()
    # What is drawn of each robot has one entry.
    entries = dict(zip(reversed(labels), reversed(handles), strict=True))
    names = sorted(entries, key=labels.index)
    figure.legend(
        [entries[name] for name in names],
        names,
        loc="outside lower center",
        ncols=4 if len(names) <= 5 or width > 5.0 else 3,
        frameon=False,
        fontsize=9,
    )
    if lines is not None:
        figure.colorbar(lines, ax=axes, label="time [s]", shrink=0.9, pad=0.02, aspect=30)
    title = f"{time[-1]:.1f} s, {path[-1]:.1f} m"
    if not is_known_map(recording):
        title = f"{100.0 * coverage[-1]:.1f} % covered, {title}"
    for tally in recording.tallies():
        title += f", {tally.label} {tally.values[-1]:.0f} of {tally.number}"
    figure.suptitle(title, fontsize=11)
    return figure


def _kept_instants(number: int) -> np.ndarray:
    """Return the instants that are drawn of a way with so many."""
    stride = max(1, -(-number // MAX_SEGMENTS))
    return np.unique(np.append(np.arange(0, number, stride), number - 1))


def _time_lines(recording: ExplorationData, window: Window, time: np.ndarray) -> "LineCollection":
    """Return the path of one robot, coloured by time."""
    from matplotlib.collections import LineCollection

    kept, robot = _kept_instants(len(time)), recording.robots[0]
    track = (window.place(robot.positions) + window.corner)[kept]
    # Where the robot was carried it left no track.
    number = np.append(0, np.cumsum(robot.is_carried))[kept]
    is_driven = number[:-1] == number[1:]
    pieces = np.stack([track[:-1], track[1:]], axis=1)[is_driven]
    lines = LineCollection(pieces.tolist(), cmap="viridis", linewidths=1.8)
    lines.set_array(time[kept[:-1]][is_driven])
    lines.set_clim(0.0, max(float(time[-1]), recording.control_period))
    lines.set_capstyle("round")
    return lines


def _add_track(axes: "Axes", robot: RobotRun, window: Window, *, is_one: bool) -> None:
    """Draw where a robot starts and ends; of several robots also its way, in its colour."""
    ends = window.place(robot.positions[[0, -1]]) + window.corner
    if is_one:
        axes.plot(*ends[0], marker="o", color="#2a9d5c", label="start", **MARKS)
        axes.plot(*ends[1], marker="s", color="#e07a1f", label="end", **MARKS)
        return
    style = line_style(robot.number)
    name = f"robot {robot.number + 1}: {robot.lengths[-1]:.1f} m"
    for piece in robot.ways(len(robot.positions)):
        way = window.place(piece[_kept_instants(len(piece))]) + window.corner
        axes.plot(*way.T, linewidth=1.6, label=name, zorder=4.0, **style)
    for place, marker in zip(ends, "os", strict=True):
        axes.plot(*place, marker=marker, color=style["color"], **MARKS)


def _draw_missed_walls(
    axes: "Axes", recording: ExplorationData, window: Window, unseen: np.ndarray
) -> None:
    from matplotlib.collections import LineCollection

    missed = true_outline(recording, window, unseen) + window.corner
    axes.add_collection(
        LineCollection(missed.tolist(), colors=[shade(MISSED)], linewidths=2.2, zorder=1.6),
        autolim=False,
    )
    if len(missed):
        # What a robot saw from poses with errors may be on its map beside where it is.
        label = "wall not seen" if recording.localisation is None else "true wall, not on the map"
        axes.plot([], [], color=shade(MISSED), linewidth=3.0, label=label)


def _unseen_walls(recording: ExplorationData) -> np.ndarray:
    """Return the solid cells beside the free space around the reachable cells that the belief does
    not hold to be solid."""
    from scipy.ndimage import binary_dilation, binary_propagation

    free = (recording.world < 0.5) | recording.reachable
    # Cells behind the faces of walls cannot be seen, so they are not missed.
    open_space = binary_propagation(recording.reachable, mask=free)
    faces = (recording.world > OCCUPIED_THRESHOLD) & binary_dilation(open_space)
    return np.asarray(faces & (recording.belief < OCCUPIED_THRESHOLD))


def coverage_figure(recording: ExplorationData) -> "Figure":
    """Draw coverage and entropy over time, and the times at which levels of coverage were reached.

    Of several robots it shows the coverage by the map of each in place of the entropy. A panel
    below shows how many targets had been found, if there are any.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    blue, brown = SERIES[0], SERIES[3]
    time, coverage, entropy, path = progress(recording)
    metrics = compute_metrics(recording)
    tallies = recording.tallies()
    figure = Figure(figsize=(8.0, 4.6 + 1.4 * len(tallies)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(1 + len(tallies), 1, height_ratios=[3.2, *(1.0 for _ in tallies)])
    axes = figure.add_subplot(grid[0])
    duration = max(float(time[-1]), recording.control_period)
    if entropy is not None:
        right = axes.twinx()
        (loss,) = right.plot(time, entropy, color=brown, linewidth=1.4, label="entropy")
        right.set_ylabel("entropy [nat]", color=brown)
        right.tick_params(axis="y", colors=brown)
        highest = max(recording.initial_entropy, float(np.nanmax(entropy)), 1e-6)
        right.set_ylim(0.0, 1.05 * highest)
        # The coverage is drawn last, over the entropy.
        axes.set_zorder(right.get_zorder() + 1)
        axes.patch.set_visible(False)
        (gain,) = axes.plot(time, 100.0 * coverage, color=blue, linewidth=2.0, label="coverage")
        first = [gain, loss]
    else:
        # Wide and pale, below the curves of the robots that it is the upper bound of.
        style: dict[str, Any] = {"color": "0.78", "linewidth": 5.0}
        first = axes.plot(time, 100.0 * coverage, label="together", **style)
        for number, (name, rows) in enumerate(recording.parts[TEAM].series(recording).items()):
            axes.plot(time, 100.0 * rows, linewidth=1.2, label=name, **line_style(number))
    if recording.target_coverage is not None:
        level = 100.0 * recording.target_coverage
        axes.axhline(
            level, color="0.6", linewidth=0.8, linestyle="--", label=f"target: {level:.3g} %"
        )
    for level, colour in zip(LEVELS, ("#7fb7be", "#3d9a8b", "#2a7f5f", "#14532d"), strict=True):
        seconds, metres = metrics.time_to[str(level)], metrics.path_to[str(level)]
        if seconds is None or metres is None:
            # The level stays in the legend, so that all figures have the same entries.
            axes.plot([], [], "o", color="0.8", label=f"{level} %: not reached")
            continue
        axes.plot([seconds, seconds], [0.0, level], color=colour, linewidth=0.8, linestyle=":")
        label = f"{level} %: {seconds:.1f} s, {metres:.1f} m"
        axes.plot(
            [seconds],
            [level],
            "o",
            color=colour,
            markersize=6.5,
            label=label,
            zorder=5,
            clip_on=False,
        )
    # Outside, where it covers no curve.
    rest = [each for each in axes.get_legend_handles_labels()[0] if each not in first]
    handles = [*first, *rest]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    axes.set(xlim=(0.0, duration), ylim=(0.0, 104.0), xlabel="time [s]")
    axes.set_ylabel("coverage [%]", color="black" if entropy is None else blue)
    axes.tick_params(axis="y", colors="black" if entropy is None else blue)
    axes.grid(color="0.2", alpha=0.12, linewidth=0.6)
    above = axes.twiny()
    ticks = np.linspace(0.0, duration, 7)
    above.set_xlim(0.0, duration)
    above.set_xticks(ticks, [f"{metres:.1f}" for metres in np.interp(ticks, time, path)])
    above.set_xlabel("distance travelled [m]")
    last = axes
    for row, tally in enumerate(tallies, start=1):
        last.set_xlabel("")
        last.tick_params(axis="x", labelbottom=False)
        last = figure.add_subplot(grid[row], sharex=axes)
        _draw_tally(last, tally, time)
    return figure


def _draw_tally(axes: "Axes", tally: Tally, time: np.ndarray) -> None:
    most, colour = tally.number, shade(tally.colour)
    axes.step(time, tally.values, where="post", color=colour, linewidth=2.0)
    axes.axhline(most, color="0.6", linewidth=0.8, linestyle="--", zorder=0.5)
    axes.set(ylim=(0.0, 1.12 * most), xlabel="time [s]")
    axes.set_ylabel(f"{tally.label} found\nof {most}", color=colour)
    axes.tick_params(axis="y", colors=colour)
    style_count(axes.yaxis, 4)
    axes.grid(color="0.2", alpha=0.12, linewidth=0.6)
