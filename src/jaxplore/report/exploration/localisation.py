"""Data, metrics and drawing of a robot that found its pose by itself."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.exploration.data import ExplorationData
from jaxplore.report.exploration.window import Window
from jaxplore.report.localisation import (
    absolute_error,
    aligned,
    aligned_coverage,
    map_agreement,
    relative_error,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

ESTIMATE = "#7b2d8b"
"""Colour of where the robot took itself to be."""
RPE_LENGTH = 5.0
"""Length of the pieces of the relative pose error [m]."""


def localisation_metrics(recording: ExplorationData) -> dict[str, Any]:
    """Return the metrics of the localisation, as in `ExplorationMetrics`."""
    found = recording.localisation
    names = (
        "ate",
        "odometry_ate",
        "rpe",
        "map_iou",
        "double_walls",
        "aligned_coverage",
        "num_loops",
    )
    if found is None or not len(found.poses):
        return dict.fromkeys(names)
    origin, side = np.asarray(recording.origin, np.float64), recording.resolution

    def grid(values: np.ndarray) -> OccupancyGrid:
        return OccupancyGrid(np.asarray(values, np.float32), side, origin.tolist())

    motion = aligned(found.true_poses, found.poses)
    relative = relative_error(found.true_poses, found.poses, RPE_LENGTH)
    agreement = map_agreement(grid(found.reference), grid(recording.belief), motion)
    return {
        "ate": absolute_error(found.true_poses, found.poses).rms,
        "odometry_ate": absolute_error(found.true_poses, found.reckoned).rms,
        "rpe": None if relative is None else relative.translation,
        "map_iou": agreement.iou,
        "double_walls": agreement.double_walls,
        "aligned_coverage": aligned_coverage(
            grid(recording.world),
            np.asarray(recording.reachable, bool),
            grid(recording.belief),
            motion,
        ),
        "num_loops": found.num_loops,
    }


def add_estimate(axes: "Axes", recording: ExplorationData, window: Window) -> None:
    """Draw where the robot took itself to be, as a line beside its true way."""
    found = recording.localisation
    if found is None or not len(found.poses):
        return
    for poses, style, label in (
        (found.reckoned, ":", "by odometry alone"),
        (found.poses, "--", "estimated way"),
    ):
        track = window.place(poses[:, :2]) + window.corner
        axes.plot(*track.T, color=ESTIMATE, linewidth=1.1, linestyle=style, zorder=4.0, label=label)
