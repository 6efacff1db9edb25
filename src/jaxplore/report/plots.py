"""Pictures of a run as a whole."""

import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.ndimage

from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OCCUPIED_THRESHOLD
from jaxplore.report.metrics import LEVELS, compute_metrics, progress
from jaxplore.simulation.recording import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARGIN = 1.0
"""Drawn around the reachable cells [m]."""
FREE, UNKNOWN, OCCUPIED = (252, 252, 250), (190, 195, 203), (43, 48, 58)
"""Colours of a belief of 0, 1/2 and 1."""
MISSED = (209, 73, 91)
"""Colour of a true wall that the belief does not hold."""
OUTLINE = "#4f8fc0"
"""Colour of the outline of the true free space."""
MAX_SEGMENTS = 2000
"""Pieces of the path that are coloured by time."""


@dataclasses.dataclass(frozen=True)
class Window:
    """The part of a grid that is drawn; it may reach beyond the grid.

    Args:
        first: row and column of its first cell.
        shape: its rows and columns.
        origin: pose of the grid [m, m, rad].
        resolution: side of a cell [m].
    """

    first: tuple[int, int]
    shape: tuple[int, int]
    origin: np.ndarray
    resolution: float

    @classmethod
    def around_reachable(cls, recording: Recording) -> "Window":
        """Return the box around the reachable cells and a margin; all of the grid without any."""
        cells = recording.reachable
        rows, columns = np.nonzero(cells if cells.any() else np.ones_like(cells, bool))
        margin = round(MARGIN / recording.resolution)
        first = (int(rows.min()) - margin, int(columns.min()) - margin)
        last = (int(rows.max()) + margin, int(columns.max()) + margin)
        shape = (last[0] - first[0] + 1, last[1] - first[1] + 1)
        return cls(first, shape, recording.origin, recording.resolution)

    @property
    def size(self) -> tuple[float, float]:
        """Extent along the grid's x and y axes [m]."""
        return self.shape[1] * self.resolution, self.shape[0] * self.resolution

    @property
    def is_turned(self) -> bool:
        """The grid's axes are not the world's."""
        return bool(self.origin[2] != 0.0)

    @property
    def corner(self) -> np.ndarray:
        """(2,) the window's first corner on the axes that are drawn [m].

        They are the world's, or the grid's own if it is turned.
        """
        corner = np.asarray(self.first[::-1], np.float64) * self.resolution
        return corner if self.is_turned else corner + self.origin[:2]

    def crop(self, cells: np.ndarray, fill: float | bool) -> np.ndarray:
        """Return the window's cells, `fill` where it reaches beyond the grid."""
        rows, columns = (
            np.arange(start, start + count)
            for start, count in zip(self.first, self.shape, strict=True)
        )
        inside = np.ix_(
            (rows >= 0) & (rows < cells.shape[0]), (columns >= 0) & (columns < cells.shape[1])
        )
        cropped = np.full(self.shape, fill, cells.dtype)
        cropped[inside] = cells[
            np.ix_(
                rows[(rows >= 0) & (rows < cells.shape[0])],
                columns[(columns >= 0) & (columns < cells.shape[1])],
            )
        ]
        return cropped

    def place(self, points: np.ndarray) -> np.ndarray:
        """Turn world points (..., 2) into metres from the window's corner along the grid's axes."""
        return to_frame(points, self.origin) - np.asarray(self.first[::-1]) * self.resolution


def to_frame(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Turn world points (..., 2) [m] into (x, y) [m] along the axes of a pose [m, m, rad]."""
    yaw = float(pose[2])
    shifted = np.asarray(points, np.float64) - np.asarray(pose[:2], np.float64)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return np.asarray(shifted @ turn)


def true_outline(recording: Recording, window: Window) -> np.ndarray:
    """Return the edges (N, 2, 2) between solid cells and the free space that reachable cells are
    part of, in metres from the window's corner along the grid's axes."""
    labels, _ = scipy.ndimage.label(np.asarray(recording.world) < FREE_THRESHOLD)
    seen = np.unique(labels[np.asarray(recording.reachable, bool)])
    inside = np.pad(window.crop(np.isin(labels, seen[seen > 0]), False), 1)
    row, column = np.nonzero(inside[1:-1, 1:] != inside[1:-1, :-1])
    upright = np.stack([column, row, column, row + 1], axis=-1)
    row, column = np.nonzero(inside[1:, 1:-1] != inside[:-1, 1:-1])
    level = np.stack([column, row, column + 1, row], axis=-1)
    edges = np.concatenate([upright, level]).reshape(-1, 2, 2)
    return np.asarray(edges * recording.resolution)


def belief_colours() -> np.ndarray:
    """Return the (256, 3) colours of a belief in 256 levels, free to occupied."""
    level = np.linspace(0.0, 1.0, 256)
    nodes = np.array([FREE, UNKNOWN, OCCUPIED], np.float64)
    channels = [np.interp(level, [0.0, 0.5, 1.0], nodes[:, channel]) for channel in range(3)]
    return np.round(np.stack(channels, axis=-1)).astype(np.uint8)


def map_figure(recording: Recording) -> "Figure":
    """Return the final belief with the robot's path and the outline of the true free space.

    In red, the walls that were not seen.

    A map that is turned is drawn along its own axes.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.collections import LineCollection
    from matplotlib.figure import Figure

    window = Window.around_reachable(recording)
    size = np.asarray(window.size)
    left, bottom = window.corner
    right, top = window.corner + size
    inches = np.clip(9.0 * size / size.max(), [3.2, 2.0], 9.0)
    figure = Figure(figsize=(inches[0] + 1.8, inches[1] + 1.1), layout="compressed")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()

    levels = np.round(255.0 * window.crop(recording.belief, 0.5)).astype(np.uint8)
    colours = belief_colours()[levels]
    colours[window.crop(_unseen_walls(recording), False)] = MISSED
    axes.imshow(
        colours,
        extent=(left, right, bottom, top),
        origin="lower",
        interpolation="nearest",
    )
    time, coverage, _, path = progress(recording)
    stride = max(1, -(-len(time) // MAX_SEGMENTS))
    kept = np.unique(np.append(np.arange(0, len(time), stride), len(time) - 1))
    track = (window.place(recording.positions) + window.corner)[kept]
    duration = max(float(time[-1]), recording.control_period)
    lines = LineCollection(
        np.stack([track[:-1], track[1:]], axis=1).tolist(), cmap="viridis", linewidths=1.8
    )
    lines.set_array(time[kept[:-1]])
    lines.set_clim(0.0, duration)
    lines.set_capstyle("round")
    axes.add_collection(lines, autolim=False)
    marks: dict[str, Any] = {
        "markersize": 9.0,
        "markeredgecolor": "white",
        "linestyle": "none",
        "zorder": 5.0,
    }
    axes.plot(*track[0], marker="o", color="#2a9d5c", label="start", **marks)
    if recording.goal is not None:
        spot = (window.place(recording.goal[None]) + window.corner)[0]
        axes.plot(*spot, marker="*", color="#e9a23b", label="goal", **marks)
    axes.plot(*track[-1], marker="s", color="#e07a1f", label="end", **marks)
    outline = true_outline(recording, window) + window.corner
    axes.add_collection(
        LineCollection(outline.tolist(), colors=OUTLINE, linewidths=0.7, zorder=1.5), autolim=False
    )
    axes.plot([], [], color=OUTLINE, linewidth=1.2, label="true outline")
    missed = np.asarray(MISSED) / 255.0
    axes.plot([], [], "s", color=missed.tolist(), markersize=5.0, label="wall not seen")
    axes.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    prefix = "grid " if window.is_turned else ""
    axes.set_xlabel(f"{prefix}x [m]")
    axes.set_ylabel(f"{prefix}y [m]")
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    figure.colorbar(lines, ax=axes, label="time [s]", shrink=0.9, pad=0.02, aspect=30)
    figure.suptitle(
        f"{100.0 * coverage[-1]:.1f} % covered, {time[-1]:.1f} s, {path[-1]:.1f} m", fontsize=11
    )
    return figure


def _unseen_walls(recording: Recording) -> np.ndarray:
    """Return the solid cells that face the free space around the reachable cells and that the
    belief does not hold to be solid."""
    from scipy.ndimage import binary_dilation, binary_propagation

    free = (recording.world < 0.5) | recording.reachable
    # What lies behind the walls' faces can neither be seen nor missed.
    open_space = binary_propagation(recording.reachable, mask=free)
    faces = (recording.world > OCCUPIED_THRESHOLD) & binary_dilation(open_space)
    return np.asarray(faces & (recording.belief < OCCUPIED_THRESHOLD))


def coverage_figure(recording: Recording) -> "Figure":
    """Return coverage and entropy over time, and when each level of coverage was reached."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    blue, brown = "#1f6fb2", "#b5651d"
    time, coverage, entropy, path = progress(recording)
    metrics = compute_metrics(recording)
    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    duration = max(float(time[-1]), recording.control_period)
    right = axes.twinx()
    right.plot(time, entropy, color=brown, linewidth=1.4)
    right.set_ylabel("entropy [nat]", color=brown)
    right.tick_params(axis="y", colors=brown)
    highest = max(recording.initial_entropy, float(np.nanmax(entropy)), 1e-6)
    right.set_ylim(0.0, 1.05 * highest)
    # The coverage is drawn last, over the entropy.
    axes.set_zorder(right.get_zorder() + 1)
    axes.patch.set_visible(False)
    axes.plot(time, 100.0 * coverage, color=blue, linewidth=2.0)
    axes.axhline(100.0 * recording.target_coverage, color="0.6", linewidth=0.8, linestyle="--")
    for level, colour in zip(LEVELS, ("#7fb7be", "#3d9a8b", "#2a7f5f", "#14532d"), strict=True):
        seconds, metres = metrics.time_to[str(level)], metrics.path_to[str(level)]
        if seconds is None or metres is None:
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
    axes.legend(loc="center right", fontsize=9, framealpha=0.95)
    axes.set(xlim=(0.0, duration), ylim=(0.0, 104.0), xlabel="time [s]")
    axes.set_ylabel("coverage [%]", color=blue)
    axes.tick_params(axis="y", colors=blue)
    axes.grid(color="0.2", alpha=0.12, linewidth=0.6)
    above = axes.twiny()
    ticks = np.linspace(0.0, duration, 7)
    above.set_xlim(0.0, duration)
    above.set_xticks(ticks, [f"{metres:.1f}" for metres in np.interp(ticks, time, path)])
    above.set_xlabel("distance travelled [m]")
    return figure
