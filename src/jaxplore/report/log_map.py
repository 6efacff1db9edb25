"""Metrics and figure of a log that was mapped."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.localisation.log_mapping import LogMap
from jaxplore.report.drawing.colours import SERIES, belief_colours
from jaxplore.report.drawing.scale_bar import add_scale_bar
from jaxplore.report.localisation import (
    AbsoluteError,
    absolute_error,
    aligned,
    map_agreement,
    relative_error,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PIECE = 5.0
"""Length of the pieces over which drift is measured [m]."""
BORDER = 1.0
"""Width of what is drawn around the known cells [m]."""
TRACKS = (
    ("dead_reckoned", "dead reckoning", SERIES[1], 1.2),
    ("true", "log", SERIES[2], 2.6),
    ("estimated", "localised", SERIES[0], 1.2),
)
"""Trajectories of the figure, from the lowest to the uppermost: name, label, colour, width."""


def log_metrics(mapped: LogMap) -> dict[str, Any]:
    """Return the metrics of a mapped log, for a JSON file.

    ATE and RPE are those of `absolute_error` and `relative_error`, the latter over 5 m; None for a
    way that is shorter. IoU and double walls are those of `map_agreement` with the map of the true
    poses, after the alignment of the trajectories.

    Args:
        mapped: the mapped log.
    """
    way = np.hypot(*np.diff(mapped.true[:, :2], axis=0).T).sum()
    walls = map_agreement(mapped.reference, mapped.map, aligned(mapped.true, mapped.estimated))
    return {
        "num_scans": len(mapped.times),
        "path_length": float(way),
        "dead_reckoned": _errors(mapped, mapped.dead_reckoned),
        "estimated": _errors(mapped, mapped.estimated),
        "num_loops": mapped.num_loops,
        "iou": walls.iou,
        "double_walls": walls.double_walls,
    }


def _errors(mapped: LogMap, poses: np.ndarray) -> dict[str, float | None]:
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

    Args:
        mapped: the mapped log.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    grid = mapped.map
    belief = grid.cropped(grid.probability)
    low, high = _extent(mapped, belief)
    size = high - low
    inches = np.clip(9.0 * size / size.max(), [3.6, 2.0], 9.0)
    figure = Figure(figsize=(inches[0] + 0.8, inches[1] + 1.1), layout="compressed")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    corner = np.asarray(grid.frame.origin, np.float64)[:2] + mapped.start
    side = np.array(belief.shape[::-1]) * grid.resolution
    colours = belief_colours()[np.round(255.0 * belief).astype(np.uint8)]
    axes.imshow(
        colours,
        extent=(corner[0], corner[0] + side[0], corner[1], corner[1] + side[1]),
        origin="lower",
        interpolation="antialiased",
    )
    # Beyond the map nothing is known.
    axes.set_facecolor([level / 255.0 for level in belief_colours()[128]])
    for name, label, colour, width in TRACKS:
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
    before, after = (
        absolute_error(mapped.true, poses).rms for poses in (mapped.dead_reckoned, mapped.estimated)
    )
    figure.suptitle(
        f"{len(mapped.times)} scans, {mapped.num_loops} loops closed, ATE {after:.2f} m, by dead "
        f"reckoning {before:.2f} m",
        fontsize=11,
    )
    return figure


def _extent(mapped: LogMap, belief: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of what is drawn: all known cells and all trajectories [m]."""
    origin = np.asarray(mapped.map.frame.origin, np.float64)[:2]
    known = np.argwhere(belief != 0.5)[:, ::-1]
    points = [getattr(mapped, name)[:, :2] for name, *_ in TRACKS]
    if len(known):
        ends = np.stack([known.min(axis=0), known.max(axis=0) + 1])
        points.append(origin + ends * mapped.map.resolution)
    both = np.concatenate(points) + mapped.start
    return both.min(axis=0) - BORDER, both.max(axis=0) + BORDER
