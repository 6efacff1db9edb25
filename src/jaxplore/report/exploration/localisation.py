"""Data, metrics and drawing of a robot that found its pose by itself."""

from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.exploration.data import ExplorationData, LocalisationData
from jaxplore.report.exploration.progress import find_carried_steps
from jaxplore.report.exploration.window import Window
from jaxplore.report.localisation import (
    SAME_FRAME,
    absolute_error,
    align,
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
RECOVERED_ERROR, RECOVERED_FOR = 0.5, 1.0
"""Error of the position below which a robot that was carried away has found itself again [m], and
for how long it must stay below [s]."""
CARRIED = "#8a8a8a"
"""Colour of where the robot was carried."""


def localisation_metrics(recording: ExplorationData) -> dict[str, Any]:
    """Return the metrics of the localisation, as in `ExplorationMetrics`."""
    found = recording.localisation
    names = (
        *("carried_at", "recovered_after"),
        "ate",
        "odometry_ate",
        "rpe",
        "map_iou",
        "double_walls",
        "aligned_coverage",
        "num_loops",
    )
    if found is None or not len(found.poses):
        return dict.fromkeys(names) | _recovery(recording)
    origin, side = np.asarray(recording.origin, np.float64), recording.resolution

    def grid(values: np.ndarray) -> OccupancyGrid:
        return OccupancyGrid(np.asarray(values, np.float32), side, origin.tolist())

    is_own = found.num_loops is not None
    motion = align(found.true_poses, found.poses) if is_own else SAME_FRAME
    agreement = map_agreement(grid(found.reference), grid(recording.belief), motion)
    return {
        **_recovery(recording),
        **trajectory_errors(found),
        "map_iou": agreement.iou,
        "double_walls": agreement.double_walls,
        "aligned_coverage": aligned_coverage(
            grid(recording.world),
            np.asarray(recording.reachable, bool),
            grid(recording.belief),
            motion,
        )
        if is_own
        else None,
        "num_loops": found.num_loops,
    }


def trajectory_errors(found: LocalisationData) -> dict[str, float | None]:
    """Return the errors of the poses at the stored scans, as in `ExplorationMetrics`."""
    # On a known map there are no loops, and poses are in its frame.
    alignment = SAME_FRAME if found.num_loops is None else None
    relative = relative_error(found.true_poses, found.poses, RPE_LENGTH)
    return {
        "ate": absolute_error(found.true_poses, found.poses, alignment).rms,
        "odometry_ate": absolute_error(found.true_poses, found.reckoned, alignment).rms,
        "rpe": None if relative is None else relative.translation,
    }


def _recovery(recording: ExplorationData) -> dict[str, float | None]:
    """Return when a fault carried the robot away, and how long it took to find itself again."""
    steps = np.flatnonzero(find_carried_steps(recording))
    if not len(steps):
        return {"carried_at": None, "recovered_after": None}
    # The record of a step has the error at its beginning, and the robot is carried at its end.
    period, first = recording.control_period, int(steps[0]) + 1
    error = recording.records.pose_error
    after: float | None = None
    if error is not None:
        is_off = ~(np.asarray(error)[first:] < RECOVERED_ERROR)
        wanted = max(1, round(RECOVERED_FOR / period))
        off = np.flatnonzero(is_off)
        # From the start, and from behind each step with a greater error to the next one.
        begins, ends = np.append(0, off + 1), np.append(off, len(is_off))
        long = np.flatnonzero(ends - begins >= wanted)
        after = float(begins[long[0]]) * period if len(long) else None
    return {"carried_at": first * period, "recovered_after": after}


def add_estimate(axes: "Axes", recording: ExplorationData, window: Window) -> None:
    """Draw where the robot took itself to be, as a line beside its true way."""
    for step in np.flatnonzero(find_carried_steps(recording)).tolist():
        ends = window.place(recording.positions[[step, step + 1]]) + window.corner
        axes.plot(*ends.T, ":", color=CARRIED, linewidth=1.0, zorder=4.0, label="carried away")
    found = recording.localisation
    if found is None or not len(found.poses):
        return
    for poses, style, label in (
        (found.reckoned, ":", "by odometry alone"),
        (found.poses, "--", "estimated way"),
    ):
        track = window.place(poses[:, :2]) + window.corner
        # A pose that jumps was none on the way: the line ends there.
        moves = np.hypot(*np.diff(poses[:, :2], axis=0).T)
        jumps = np.flatnonzero(moves > np.diff(found.way) + RECOVERED_ERROR) + 1
        track = np.insert(track, jumps, np.nan, axis=0)
        axes.plot(*track.T, color=ESTIMATE, linewidth=1.1, linestyle=style, zorder=4.0, label=label)
