"""Choose the scans of a log: those of one lidar, alike, with poses, and in order."""

import bisect
import math
from collections import Counter
from collections.abc import Sequence

import numpy as np

from jaxplore.geometry.motion import accumulate_motions, motions_between
from jaxplore.sensing.carmen import KINDS, Floats, LogLines, Reading

LONGEST_STEP = 10.0
"""Greatest distance between neighbouring scans to which a log gives the same time [m]."""
FASTEST = 10.0
"""Speed that no log is believed to exceed [m/s]."""
MOUNT_ERROR = 0.02
"""Difference from a fixed mounting that the poses of a lidar and of its robot have by the few
digits of a log [m and rad]."""
SAME = 1e-4
"""Difference of the numbers of two lines up to which they are the same pose [m and rad]."""


def choose_kind(lines: LogLines) -> str:
    """Return the kind of lines to read; empty without any."""
    most = max((len(each) for each in lines.breaks.values()), default=0)
    return next((kind for kind in KINDS if 2 * len(lines.breaks.get(kind, ())) >= most > 0), "")


def select_alike(lines: LogLines, kind: str) -> list[Reading]:
    """Return the scans with the most frequent number and angles of beams."""
    readings = lines.readings.get(kind, [])
    count = Counter((len(each.ranges), each.angles) for each in readings)
    if not count:
        return []
    (beams, angles), _ = count.most_common(1)[0]
    for each in readings:
        found = len(each.ranges)
        if found != beams:
            text = f"has {found} beams; accepted: {beams}, as in most lines"
            lines.leave_out(kind, "beams", each.line, text)
        elif each.angles != angles:
            lines.leave_out(kind, "angles", each.line, "has other angles of its beams than most")
    return [each for each in readings if (len(each.ranges), each.angles) == (beams, angles)]


def find_poses(readings: list[Reading], lines: LogLines, kind: str) -> list[Reading]:
    """Return scans with poses: by the lines ODOM where their own have none.

    Between two of these lines the pose changes evenly with time.
    """
    if not readings or readings[0].pose is not None:
        return readings
    rows = np.frombuffer(lines.odometry).reshape(-1, 5)
    rows = rows[np.isfinite(rows[:, 4])]
    if not len(rows):
        return []
    times, order = np.unique(rows[:, 4], return_index=True)
    known = rows[order, 1:4]
    known[:, 2] = np.unwrap(known[:, 2])
    at = np.array([each.time for each in readings])
    odometry = np.stack([np.interp(at, times, column) for column in known.T], axis=1)
    is_front = kind.endswith("1")
    offset = lines.offsets["front" if is_front else "rear"]
    yaw = odometry[:, 2]
    poses = odometry + offset * np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=1)
    if not is_front:
        poses[:, 2] += math.pi
    return [
        each._replace(pose=pose, odometry=own)
        for each, pose, own in zip(readings, poses, odometry, strict=True)
    ]


def select_in_order(readings: list[Reading], lines: LogLines, kind: str) -> list[Reading]:
    """Return the most scans whose times do not decrease, without those far from the one before."""
    kept = _longest_order([each.time for each in readings])
    found: list[Reading] = []
    latest = -math.inf
    for index, each in enumerate(readings):
        if index not in kept:
            text = f"has the time {each.time:.10g}; accepted: at least {latest:.10g}"
            if each.time >= latest:
                text = f"has the time {each.time:.10g}, after that of later lines"
            lines.leave_out(kind, "times", each.line, text)
            continue
        latest = each.time
        taken, step = 0.0, 0.0
        before = found[-1] if found else each
        if each.pose is not None and before.pose is not None:
            taken = each.time - before.time
            step = math.dist(each.pose[:2], before.pose[:2])
        if step > LONGEST_STEP + FASTEST * taken:
            text = f"has a position {step:.1f} m and {taken:.3g} s after that of the scan before"
            accepted = f"accepted: at most {LONGEST_STEP:g} m and {FASTEST:g} m/s"
            lines.leave_out(kind, "positions", each.line, f"{text}; {accepted}")
            continue
        found.append(each)
    return found


def _longest_order(times: Sequence[float]) -> set[int]:
    """Return the indices of the longest subsequence of times that does not decrease."""
    # For each length the least last time, and which one that is.
    tails: list[float] = []
    ends: list[int] = []
    before: list[int] = []
    for index, time in enumerate(times):
        at = bisect.bisect_right(tails, time)
        before.append(ends[at - 1] if at else -1)
        tails[at : at + 1] = [time]
        ends[at : at + 1] = [index]
    kept, index = set(), ends[-1]
    while index >= 0:
        kept.add(index)
        index = before[index]
    return kept


def is_mounted(poses: Floats, odometry: Floats) -> bool:
    """Check whether a lidar at poses (N, 3) is fixed to a robot at others, within a few digits."""
    mount = motions_between(odometry, poses)
    apart = mount - np.median(mount, axis=0)
    apart[:, 2] = np.sin(0.5 * apart[:, 2])
    return bool(np.abs(apart).max() <= MOUNT_ERROR)


def odometry_by_lines(
    lines: LogLines, kind: str, readings: Sequence[Reading], poses: Floats
) -> Floats | None:
    """Return the odometry (N, 3) of a corrected log by its lines ODOM; None if it has none.

    GMapping writes a corrected log so: after each scan a line ODOM with its corrected pose, from
    which the lines up to the next scan go on by the odometry. What a scan lacks of these lines is
    the motion between the corrected poses. `kind` is that of the lines with scans, and `poses` (N,
    3) are those of `readings`.
    """
    rows = np.frombuffer(lines.odometry).reshape(-1, 5)
    if len(rows) < 2 or len(readings) < 2:
        return None
    # Between two lines with scans the first of the lines ODOM and the last one. All such lines
    # count, also those that were left out: the poses of the others begin anew after them too.
    breaks = np.asarray(lines.breaks[kind], np.int64)
    first = np.searchsorted(rows[:, 0], breaks[:-1])
    last = np.searchsorted(rows[:, 0], breaks[1:]) - 1
    has_lines = last >= first
    within = np.zeros((len(breaks), 3))
    some = np.flatnonzero(has_lines)
    within[some + 1] = motions_between(rows[first[some], 1:4], rows[last[some], 1:4])
    at = np.searchsorted(breaks, [each.line for each in readings])
    segments = accumulate_motions(np.zeros(3), within)
    motions = motions_between(segments[at[:-1]], segments[at[1:]])
    missing = np.concatenate([[0], np.cumsum(~has_lines)])
    lacks = missing[at[1:]] > missing[at[:-1]]
    corrected = motions_between(poses[:-1], poses[1:])
    begins = rows[np.minimum(first, len(rows) - 1), 1:4][at[:-1]]
    follows = (np.abs(motions_between(begins, poses[:-1])) <= SAME).all(axis=1) | lacks
    differs = (np.abs(motions - corrected) > 10.0 * SAME).any(axis=1) & ~lacks
    if follows.mean() < 0.9 or differs.mean() < 0.5:
        return None
    motions[lacks] = corrected[lacks]
    return accumulate_motions(poses[0], np.concatenate([np.zeros((1, 3)), motions]))
