"""Figures of a path-following run: the course and the errors."""

import itertools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jax.typing import ArrayLike

from jaxplore.report._numbers import finite_mean, text
from jaxplore.report.drawing.colours import (
    FREE,
    MISSED,
    MOVER,
    MOVER_EDGE,
    OUTLINE,
    SERIES,
    UNKNOWN,
    blend,
    shade,
)
from jaxplore.report.drawing.picture import outline_at
from jaxplore.report.drawing.scale_bar import add_scale_bar
from jaxplore.report.drawing.series import find_runs
from jaxplore.report.following.data import PathData, lap_starts, num_laps, speeds
from jaxplore.report.motion import episodes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.path import Path

MAX_SEGMENTS = 5000
"""Number of segments of the trail that are coloured by speed."""
NUM_FAINT, FAINT = 8, 0.13
"""Number of earlier frames whose obstacles are drawn faintly; their opacity."""
FLOOR = blend(UNKNOWN, FREE, 0.2)
"""Colour of a corridor on white paper."""
MARGIN, LEAST_RATIO = 0.03, 0.28
"""Margin around the course, and least side of the picture, as shares of its longest side."""
NEAR = 8.0
"""Upper end of the axis of room and gap, in radii of the robot."""
LEAST_LAP = 0.09
"""Shortest lap whose time is written over it, as a share of the axis."""


def course_box(recording: PathData) -> tuple[np.ndarray, np.ndarray]:
    """Return the bounding box of path, corridor and trail, and a margin: two corners (2,) [m]."""
    reach = max(recording.robot_radius, float(np.max(np.abs(recording.footprint), initial=0.0)))
    trail = recording.positions.astype(np.float64)
    drawn = [recording.centre, *recording.edges, trail - reach, trail + reach]
    points = np.concatenate(drawn).astype(np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    low, high = points.min(axis=0), points.max(axis=0)
    longest = max(float((high - low).max()), 1e-3)
    size = np.maximum(high - low, LEAST_RATIO * longest) + 2.0 * MARGIN * longest
    middle = 0.5 * (low + high)
    return middle - 0.5 * size, middle + 0.5 * size


def worst_steps(margins: ArrayLike) -> np.ndarray:
    """Return the step of the least margin in each interval of successive negative margins (N,)."""
    values = np.asarray(margins, np.float64)
    runs = find_runs(values < 0.0)
    return np.asarray([each.start + np.argmin(values[each]) for each in runs], int)


def path_figure(recording: PathData) -> "Figure":
    """Draw the course (path and corridor), the trail coloured by speed, and the obstacles.

    Obstacles are dark at their last position, and faint at their positions in some of the frames.
    Positions out of the corridor are red; a cross marks the deepest point of each contact.
    """
    # Matplotlib is slow to import, and its Agg canvas needs no display.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    low, high = course_box(recording)
    size = high - low
    inches = np.clip(9.0 * size / size.max(), [3.2, 1.6], 9.0)
    figure = Figure(figsize=(inches[0] + 1.8, inches[1] + 1.4), layout="compressed")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    _add_course(axes, recording)
    _add_obstacles(axes, recording)
    speed, positions = speeds(recording), recording.positions.astype(np.float64)
    stride = max(1, -(-len(speed) // MAX_SEGMENTS))
    kept = np.unique(np.append(np.arange(0, len(speed), stride), len(speed) - 1))
    trail = positions[kept]
    lines = LineCollection(
        np.stack([trail[:-1], trail[1:]], axis=1).tolist(),
        cmap="viridis",
        linewidths=1.8,
        zorder=2.0,
    )
    lines.set_array(0.5 * (speed[kept[:-1]] + speed[kept[1:]]))
    lines.set_clim(0.0, max(float(speed.max()), 0.1))
    lines.set_capstyle("round")
    axes.add_collection(lines, autolim=False)
    _add_marks(axes, recording)
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set(xlabel="x [m]", ylabel="y [m]")
    add_scale_bar(axes)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside lower center",
        ncols=len(labels) if inches[0] > 8.0 else 3,
        frameon=False,
        borderpad=0.9,
        fontsize=9,
    )
    figure.colorbar(lines, ax=axes, label="speed [m/s]", shrink=0.9, pad=0.02, aspect=30)
    figure.suptitle(_title(recording), fontsize=11)
    return figure


def _title(recording: PathData) -> str:
    records, laps = recording.records, num_laps(recording)
    way = f"{recording.progress[-1]:.1f} of {recording.end:.1f} m"
    if laps:
        way = f"laps {len(lap_starts(recording)) - 1} of {laps}"
    error = text(finite_mean(np.abs(records.contouring)), 3)
    title = f"{recording.time[-1]:.2f} s, {way}\nmean |contouring| {error} m"
    if len(recording.edges):
        title += f", violations {episodes(records.room < 0.0)}"
    if len(recording.obstacle_radii):
        title += f", contacts {episodes(records.gap < 0.0)}"
    return title


def _add_course(axes: "Axes", recording: PathData) -> None:
    from matplotlib.collections import PolyCollection

    if len(recording.edges):
        left, right = recording.edges.astype(np.float64)
        quads = np.stack([left[:-1], left[1:], right[1:], right[:-1]], axis=1)
        floor = shade(FLOOR)
        pieces = quads[np.isfinite(quads).all(axis=(1, 2))].tolist()
        # The edges close the seams between the quads.
        ground = PolyCollection(
            pieces, facecolors=floor, edgecolors=floor, linewidths=0.5, zorder=0.5
        )
        axes.add_collection(ground, autolim=False)
        for edge, label in ((left, "corridor"), (right, None)):
            axes.plot(*edge.T, color=OUTLINE, linewidth=1.0, zorder=1.0, label=label)
    axes.plot(
        *recording.centre.T, color="0.55", linewidth=0.8, linestyle="--", zorder=1.1, label="path"
    )


def _add_obstacles(axes: "Axes", recording: PathData) -> None:
    from matplotlib.patches import PathPatch
    from matplotlib.patheffects import Normal, Stroke

    radii = recording.obstacle_radii.tolist()
    if not radii:
        return
    dark, light = shade(MOVER), shade(MOVER_EDGE)
    frames = recording.frames
    # The last frame is left out: its obstacles are drawn dark below.
    some = np.unique(np.linspace(0, len(frames) - 1, NUM_FAINT + 1).round().astype(int))[:-1]
    for index in some.tolist():
        for corners, radius in zip(frames[index].corners, radii, strict=True):
            outline = thick_outline(corners, radius)
            axes.add_patch(
                PathPatch(outline, facecolor=dark, alpha=FAINT, linewidth=0.0, zorder=1.5)
            )
    for corners, radius in zip(frames[-1].corners, radii, strict=True):
        # The edge is drawn beneath the fill: above it would show where pieces of the outline
        # overlap.
        rim = [Stroke(linewidth=2.4, foreground=light), Normal()]
        outline = thick_outline(corners, radius)
        patch = PathPatch(outline, facecolor=dark, edgecolor="none", linewidth=0.0, zorder=3.0)
        patch.set_path_effects(rim)
        axes.add_patch(patch)
    # Patches have no entry in the legend, so empty curves stand for them.
    for label, edge, alpha in (("obstacle", light, 1.0), ("obstacle earlier", "none", 2.0 * FAINT)):
        axes.plot(
            [],
            [],
            marker="o",
            color=dark,
            alpha=alpha,
            markeredgecolor=edge,
            markersize=7.0,
            linestyle="none",
            label=label,
        )


def thick_outline(corners: np.ndarray, radius: float) -> "Path":
    """Return the outline of a polygon (V, 2), or of a point, inflated by a radius [m], as
    counterclockwise pieces. Filled by the nonzero rule they give their union: the polygon, a strip
    along each of its edges and a disc around each of its corners."""
    from matplotlib.path import Path

    points = np.asarray(corners, np.float64)
    following = np.roll(points, -1, axis=0)
    twice_area = float(np.sum(points[:, 0] * following[:, 1] - points[:, 1] * following[:, 0]))
    # All pieces must turn the same way: by the nonzero rule opposite turns would leave holes.
    pieces = [points if twice_area >= 0.0 else points[::-1]] if len(points) > 2 else []
    for start, end in zip(points, following, strict=True):
        along = end - start
        length = float(np.hypot(*along))
        if radius > 0.0 and length > 0.0:
            aside = radius / length * np.array([-along[1], along[0]])
            pieces.append(np.stack([start - aside, end - aside, end + aside, start + aside]))
    paths = [Path(np.concatenate([piece, piece[:1]]), closed=True) for piece in pieces]
    if radius > 0.0:
        paths += [Path.circle((float(x), float(y)), radius) for x, y in np.unique(points, axis=0)]
    return Path.make_compound_path(*paths)


def _add_marks(axes: "Axes", recording: PathData) -> None:
    """Draw the start and the end, the robot at both, violations and contacts."""
    from matplotlib.patches import Circle, Polygon

    records, positions = recording.records, recording.positions.astype(np.float64)
    after, red = positions[1:], shade(MISSED)
    outside = after[np.asarray(records.room) < 0.0]
    if len(outside):
        axes.plot(
            *outside.T,
            marker="o",
            color=red,
            markersize=4.5,
            linestyle="none",
            zorder=2.5,
            label="out of the corridor",
        )
    edged: dict[str, Any] = {"markeredgecolor": "white", "linestyle": "none"}
    for position, marker, colour, size, label in (
        (positions[0], "o", "#2a9d5c", 11.0, "start"),
        (positions[-1], "s", "#e07a1f", 7.0, "end"),
    ):
        axes.plot(
            *position,
            marker=marker,
            color=colour,
            markersize=size,
            zorder=4.0,
            label=label,
            **edged,
        )
    heading = recording.frames[-1].heading
    line: dict[str, Any] = {"edgecolor": shade(MOVER), "linewidth": 1.2, "zorder": 4.5}
    if len(recording.footprint) and np.isfinite(heading):
        corners = outline_at(recording.footprint, positions[-1], heading)
        axes.add_patch(Polygon(corners, fill=False, **line))
    else:
        x, y = positions[-1].tolist()
        axes.add_patch(Circle((x, y), recording.robot_radius, fill=False, **line))
    axes.plot(
        [],
        [],
        marker="s" if len(recording.footprint) else "o",
        markerfacecolor="none",
        markeredgecolor=shade(MOVER),
        linestyle="none",
        label="robot",
    )
    touched = after[worst_steps(records.gap)]
    if len(touched):
        axes.plot(
            *touched.T, marker="X", color=red, markersize=10.0, zorder=5.0, label="contact", **edged
        )


def errors_figure(recording: PathData) -> "Figure":
    """Draw errors, speed and accelerations over time, or over the progress of an open path.

    If present, it also shows the room to the corridor's edge and the gap to the nearest obstacle;
    both are negative where violated. Vertical lines separate laps.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    records = recording.records
    along, label = recording.time, "time [s]"
    if not recording.is_closed:
        along, label = np.asarray(recording.progress, np.float64), "progress [m]"
    after = along[1:]
    felt = np.asarray(records.acceleration, np.float64).reshape(-1, 2)
    margins = {
        name: np.asarray(values, np.float64)
        for name, values in (("room", records.room), ("gap", records.gap))
        if np.isfinite(values).any()
    }
    is_felt = bool(np.isfinite(felt).any())
    count = 2 + is_felt + bool(margins)
    figure = Figure(figsize=(9.0, 0.8 + 1.6 * count), layout="constrained")
    FigureCanvasAgg(figure)
    panels = list(figure.subplots(count, 1, sharex=True))
    errors, speed, *others = panels
    _draw_curves(errors, after, {"contouring": records.contouring, "lag": records.lag})
    errors.set_ylabel("error [m]")
    speed.plot(along, speeds(recording), color=SERIES[2], linewidth=1.4)
    speed.set_ylim(bottom=0.0)
    speed.set_ylabel("speed\n[m/s]")
    if is_felt:
        panel, *others = others
        lateral, longitudinal = _draw_curves(
            panel, after, {"lateral": felt[:, 1], "longitudinal": felt[:, 0]}
        )
        # The longitudinal acceleration changes fast: it is drawn beneath, so that both can be read.
        longitudinal.set(linewidth=0.8, alpha=0.6, zorder=lateral.get_zorder() - 0.1)
        panel.set_ylabel("acceleration\n[m/s²]")
    for panel in others:
        _draw_margins(panel, after, margins, recording.robot_radius)
    first, last = float(along.min()), float(along.max())
    for panel in panels:
        # In a run without a step both ends are equal, which Matplotlib warns about.
        panel.set_xlim(first, last if last > first else first + 1.0)
        panel.grid(color="0.2", alpha=0.12, linewidth=0.6)
    panels[-1].set_xlabel(label)
    figure.align_ylabels(panels)
    _mark_laps(panels, lap_starts(recording))
    return figure


def _draw_curves(
    axes: "Axes", along: np.ndarray, curves: Mapping[str, ArrayLike]
) -> list["Line2D"]:
    axes.axhline(0.0, color="0.4", linewidth=0.8)
    lines = [
        axes.plot(along, np.asarray(values), color=colour, linewidth=1.2, label=name)[0]
        for colour, (name, values) in zip(SERIES, curves.items(), strict=False)
    ]
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=9, frameon=False)
    return lines


def _draw_margins(
    axes: "Axes", along: np.ndarray, margins: dict[str, np.ndarray], radius: float
) -> None:
    """Draw room and gap where they are small, and mark negative values."""
    names = {"room": "room to the edge", "gap": "gap to obstacles"}
    _draw_curves(axes, along, {names[name]: values for name, values in margins.items()})
    finite = {name: values[np.isfinite(values)] for name, values in margins.items()}
    most = max(float(values.max()) for values in finite.values())
    least = min(float(values.min()) for values in finite.values())
    # Far from obstacles the gap is large, but only small margins matter. The room is shown whole.
    near = max(NEAR * radius, 1.05 * float(finite["room"].max()) if "room" in finite else 0.0)
    top = max(min(1.05 * most, near), 1e-2)
    bottom = min(1.2 * least, -0.08 * top)
    axes.axhspan(bottom, 0.0, color=shade(MISSED), alpha=0.15, linewidth=0.0, zorder=0.5)
    axes.set_ylim(bottom, top)
    axes.set_ylabel("margin [m]")


def _mark_laps(panels: Sequence["Axes"], starts: np.ndarray) -> None:
    for panel in panels:
        for start in starts[1:].tolist():
            panel.axvline(start, color="0.3", linewidth=0.8)
    first, last = panels[0].get_xlim()
    # Labels over short laps would overlap.
    if np.min(np.diff(starts), initial=np.inf) < LEAST_LAP * (last - first):
        return
    for number, (start, end) in enumerate(itertools.pairwise(starts.tolist()), 1):
        panels[0].text(
            0.5 * (start + end),
            1.04,
            f"lap {number}\n{end - start:.2f} s",
            transform=panels[0].get_xaxis_transform(),
            ha="center",
            va="bottom",
            fontsize=9,
        )
