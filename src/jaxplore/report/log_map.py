"""Metrics and figure of a log that was mapped."""

import dataclasses
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.localisation.log_mapping import LogMap
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD, OccupancyGrid
from jaxplore.report.drawing.colours import SERIES, UNKNOWN, belief_colours, shade
from jaxplore.report.drawing.scale_bar import add_scale_bar
from jaxplore.report.localisation import (
    AbsoluteError,
    absolute_error,
    align,
    map_agreement,
    relative_error,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PIECE = 5.0
"""Length of the pieces over which drift is measured [m]."""
MOST_PIXELS = 900
"""Greatest number of blocks of cells along a side of the figure."""
BORDER = 1.0
"""Width of what is drawn around the known cells [m]."""
TRACKS = (
    ("dead_reckoned", "dead reckoning", SERIES[1], 1.2),
    ("true", "log", SERIES[2], 2.6),
    ("estimated", "localised", SERIES[0], 1.2),
)
"""Trajectories of the figure, from the lowest to the uppermost: name, label, colour, width."""


def log_metrics(mapped: LogMap) -> dict[str, Any]:
    """Return the metrics of a mapped log, for a JSON file: ATE, RPE over 5 m (None for a shorter
    way), and IoU and double walls by `map_agreement` with the map of the true poses, after the
    alignment of the trajectories. All are None where the log has no true poses."""
    poses = mapped.estimated if mapped.true is None else mapped.true
    walls = None
    if mapped.true is not None and mapped.reference is not None:
        alignment = align(mapped.true, mapped.estimated)
        walls = map_agreement(mapped.reference, mapped.map, alignment)
    return {
        "num_scans": len(mapped.times),
        "path_length": float(np.hypot(*np.diff(poses[:, :2], axis=0).T).sum()),
        "dead_reckoned": _errors(mapped, mapped.dead_reckoned),
        "estimated": _errors(mapped, mapped.estimated),
        "num_loops": mapped.num_loops,
        "iou": None if walls is None else walls.iou,
        "double_walls": None if walls is None else walls.double_walls,
        "odometry": {
            field.name: float(getattr(mapped.odometry, field.name))
            for field in dataclasses.fields(mapped.odometry)
        },
        "trust": mapped.trust._asdict(),
    }


def _errors(mapped: LogMap, poses: np.ndarray) -> dict[str, float | None] | None:
    if mapped.true is None:
        return None
    whole: AbsoluteError = absolute_error(mapped.true, poses)
    piece = relative_error(mapped.true, poses, PIECE)
    return {
        "ate": whole.rms,
        "greatest_error": whole.greatest,
        "ate_yaw": whole.rms_yaw,
        "rpe": None if piece is None else piece.translation,
        "rpe_yaw": None if piece is None else piece.yaw,
    }


def log_figure(mapped: LogMap) -> "Figure":
    """Draw the map with the trajectories of the log, of dead reckoning and of the localisation.

    The trajectories begin at the same pose, and none is aligned.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    grid = mapped.map
    belief = grid.crop(grid.probability)
    low, high = _extent(mapped, belief)
    size = high - low
    inches = np.clip(9.0 * size / size.max(), [3.6, 2.0], 9.0)
    figure = Figure(figsize=(inches[0] + 0.8, inches[1] + 1.1), layout="compressed")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    corner = np.asarray(grid.frame.origin, np.float64)[:2] + mapped.start
    blocks, factor = _coarser(belief, size, grid)
    side = np.array(blocks.shape[::-1]) * factor * grid.resolution
    colours = belief_colours()[np.round(255.0 * blocks).astype(np.uint8)]
    axes.imshow(
        colours,
        extent=(corner[0], corner[0] + side[0], corner[1], corner[1] + side[1]),
        origin="lower",
        interpolation="nearest",
    )
    # Beyond the map nothing is known.
    axes.set_facecolor(shade(UNKNOWN))
    for name, label, colour, width in TRACKS:
        if getattr(mapped, name) is None:
            continue
        x, y = (getattr(mapped, name)[:, :2] + mapped.start).T
        axes.plot(x, y, color=colour, linewidth=width, label=label)
    axes.plot(
        *mapped.start,
        marker="o",
        color="#2a9d5c",
        label="start",
        markersize=8.0,
        markeredgecolor="white",
        linestyle="none",
        zorder=5.0,
    )
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    add_scale_bar(axes)
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    title = f"{len(mapped.times)} scans, {mapped.num_loops} loops closed"
    if mapped.true is not None:
        before, after = (
            absolute_error(mapped.true, poses).rms
            for poses in (mapped.dead_reckoned, mapped.estimated)
        )
        title += f", ATE {after:.2f} m, by dead reckoning {before:.2f} m"
    if mapped.trust.warning:
        title += "\n" + textwrap.fill(mapped.trust.warning, 80)
    figure.suptitle(title, fontsize=11)
    return figure


def _coarser(belief: np.ndarray, size: np.ndarray, grid: OccupancyGrid) -> tuple[np.ndarray, int]:
    """Return the belief in blocks that are no smaller than pixels, and the cells along a block.

    `size` is the width and height of what is drawn [m]. A block with an occupied cell is occupied,
    so that walls of one cell stay visible.
    """
    factor = max(1, round(float(size.max()) / grid.resolution / MOST_PIXELS))
    # Rows and columns of unknown cells fill the last blocks.
    short = [-count % factor for count in belief.shape]
    padded = np.pad(belief, [(0, each) for each in short], constant_values=0.5)
    height, width = (count // factor for count in padded.shape)
    blocks = padded.reshape(height, factor, width, factor)
    highest = blocks.max(axis=(1, 3))
    coarse: np.ndarray = np.where(highest > OCCUPIED_THRESHOLD, highest, blocks.mean(axis=(1, 3)))
    return coarse, factor


def _extent(mapped: LogMap, belief: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of what is drawn: all known cells and all trajectories [m]."""
    origin = np.asarray(mapped.map.frame.origin, np.float64)[:2]
    known = np.argwhere(belief != 0.5)[:, ::-1]
    tracks = (getattr(mapped, name) for name, *_ in TRACKS)
    points = [track[:, :2] for track in tracks if track is not None]
    if len(known):
        ends = np.stack([known.min(axis=0), known.max(axis=0) + 1])
        points.append(origin + ends * mapped.map.resolution)
    both = np.concatenate(points) + mapped.start
    return both.min(axis=0) - BORDER, both.max(axis=0) + BORDER
