"""Data, metrics and drawing of a robot that found its pose by itself."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.exploration.data import ExplorationData, LocalisationData, RobotRun
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
    found = _join([each.localisation for each in recording.robots if each.localisation])
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
        **_greatest_errors(recording.robots),
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


def _join(places: Sequence[LocalisationData]) -> LocalisationData | None:
    """Return where all robots were, one after the other, on the map of the scans of all."""
    if len(places) < 2:
        return places[0] if places else None
    loops = [each.num_loops for each in places if each.num_loops is not None]
    joined = {
        name: np.concatenate([getattr(each, name) for each in places])
        for name in ("true_poses", "poses", "reckoned", "way")
    }
    reference = merge_known([each.reference for each in places])
    return LocalisationData(**joined, reference=reference, num_loops=sum(loops) if loops else None)


def merge_known(maps: Sequence[np.ndarray]) -> np.ndarray:
    """Return of each cell the probability (H, W) that is the farthest from 1/2 on any map."""
    known = np.asarray(maps[0])
    for other in maps[1:]:
        known = np.where(np.abs(other - 0.5) > np.abs(known - 0.5), other, known)
    return known


def _greatest_errors(robots: Sequence[RobotRun]) -> dict[str, float | None]:
    """Return the greatest errors of any robot's poses, each of which is aligned by itself."""
    errors = [
        trajectory_errors(each.localisation)
        for each in robots
        if each.localisation and len(each.localisation.poses)
    ]
    rows = {name: [each[name] for each in errors] for name in errors[0]}
    return {
        name: max((each for each in found if each is not None), default=None)
        for name, found in rows.items()
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
    """Return when a fault carried the robots away, and how long the last of them took to find
    itself again."""
    period = recording.control_period
    found = [_find_recovery(each, period) for each in recording.robots if each.is_carried.any()]
    if not found:
        return {"carried_at": None, "recovered_after": None}
    times = [after for _, after in found if after is not None]
    return {
        "carried_at": min(at for at, _ in found),
        "recovered_after": max(times) if len(times) == len(found) else None,
    }


def _find_recovery(robot: RobotRun, period: float) -> tuple[float, float | None]:
    """Return when a robot was carried away, and how long it took to find itself again [s]."""
    # The record of a step has the error at its beginning, and the robot is carried at its end.
    first = int(robot.is_carried.argmax()) + 1
    if robot.pose_error is None:
        return first * period, None
    is_off = ~(robot.pose_error[first:] < RECOVERED_ERROR)
    wanted = max(1, round(RECOVERED_FOR / period))
    off = np.flatnonzero(is_off)
    # From the start, and from behind each step with a greater error to the next one.
    begins, ends = np.append(0, off + 1), np.append(off, len(is_off))
    long = np.flatnonzero(ends - begins >= wanted)
    return first * period, float(begins[long[0]]) * period if len(long) else None


def add_estimate(axes: "Axes", robot: RobotRun, window: Window) -> None:
    """Draw where a robot took itself to be, as a line beside its true way."""
    for step in np.flatnonzero(robot.is_carried).tolist():
        ends = window.place(robot.positions[[step, step + 1]]) + window.corner
        axes.plot(*ends.T, ":", color=CARRIED, linewidth=1.0, zorder=4.0, label="carried away")
    found = robot.localisation
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
