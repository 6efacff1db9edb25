"""Logs of CARMEN and of GMapping: parse their lines, and choose and order their scans.

Source: the log formats of CARMEN, the Carnegie Mellon Robot Navigation Toolkit; GMapping's `gfs`
files as its grid SLAM processor writes them.
"""

import bisect
import math
from array import array
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxplore._limits import LONGEST, LONGEST_RANGE, MOST_BEAMS
from jaxplore._text import short_repr
from jaxplore.geometry.motion import accumulate_motions, motions_between

KINDS = (
    *("FLASER", "ROBOTLASER1", "RAWLASER1", "LASER_READING", "RLASER", "ROBOTLASER2"),
    *(f"RAWLASER{number}" for number in range(2, 6)),
)
"""Kinds of lines with a scan, the preferred one first."""
NO_ECHO = 80.0
"""Readings from here on mean that a beam of a SICK LMS got no echo [m]."""
MOST_SCANS = 200_000
"""Greatest number of scans of a log."""
MOST_ODOMETRY = 2_000_000
"""Greatest number of its lines ODOM."""
LONGEST_LINE = 4_000_000
"""Longest line that is read [bytes]."""
_PARAMS = {b"robot_frontlaser_offset": "front", b"robot_rearlaser_offset": "rear"}
_FORMS = {
    "FLASER": "the number n, n ranges, 6 numbers of two poses, a time, a host, a time",
    "LASER_READING": "the number n, n ranges, 3 numbers of a pose, a time",
    "RAWLASER": "7 numbers of the lidar, the number n, n ranges, the number m, m remissions, "
    "a time, a host, a time",
    "ROBOTLASER": "7 numbers of the lidar, the number n, n ranges, the number m, m remissions, "
    "6 numbers of two poses, 5 numbers of the robot, a time, a host, a time",
}
Floats = NDArray[np.float64]
LONGEST_STEP = 10.0
"""Greatest distance between neighbouring scans to which a log gives the same time [m]."""
FASTEST = 10.0
"""Speed that no log is believed to exceed [m/s]."""
MOUNT_ERROR = 0.02
"""Difference from a fixed mounting that the poses of a lidar and of its robot have by the few
digits of a log [m and rad]."""
SAME = 1e-4
"""Difference of the numbers of two lines up to which they are the same pose [m and rad]."""


class BadLineError(ValueError):
    """A line that is no scan: why, and in a word what is wrong with it, by which it is counted."""

    def __init__(self, reason: str, text: str) -> None:
        super().__init__(text)
        self.reason = reason


class Reading(NamedTuple):
    """A scan as a line has it: its number from 1, readings (B,) [m], the poses (x, y, yaw) of the
    lidar and of the robot by its odometry, the time [s], and the direction of the first beam and
    the angle between two [rad]; None for what the line lacks."""

    line: int
    ranges: Floats
    pose: Floats | None
    odometry: Floats | None
    time: float
    angles: tuple[float, float] | None


class LogLines:
    """What the lines of a log say, by their kinds.

    Attributes:
        readings: scans by kind.
        breaks: numbers of all lines of each kind, also of those that are no scan.
        bad: by kind how many lines are no scan, by reason.
        first_bad: by kind and reason the first of these lines, and what it has.
        odometry: rows (line, x, y, yaw, time) of the lines ODOM, one after the other.
        offsets: distance of the lidars ahead of the robot's centre [m].
    """

    def __init__(self) -> None:
        self.readings: dict[str, list[Reading]] = {}
        self.breaks: dict[str, array[int]] = {}
        self.bad: dict[str, Counter[str]] = {}
        self.first_bad: dict[tuple[str, str], str] = {}
        self.odometry: array[float] = array("d")
        self.offsets = {"front": 0.0, "rear": 0.0}

    def add(self, number: int, line: bytes) -> None:
        """Take in the line of a number, counted from 1; lines of other kinds are skipped.

        More scans, or more lines ODOM, than a log may have raise a `ValueError`.
        """
        kind = line[:40].split(None, 1)[0].upper() if line[:40].strip() else b""
        name = kind.decode("ascii", "replace")
        if name in KINDS:
            self._add_scan(number, name, line)
        elif name == "ODOM":
            self._add_odometry(number, line)
        elif name == "PARAM":
            words = line[:400].split()
            if len(words) > 2 and words[1] in _PARAMS:
                value = _number(words[2])
                if abs(value) < LONGEST_RANGE:
                    self.offsets[_PARAMS[words[1]]] = value

    def leave_out(self, kind: str, reason: str, number: int, text: str) -> None:
        """Count a line of a kind that is no scan."""
        self.bad.setdefault(kind, Counter())[reason] += 1
        self.first_bad.setdefault((kind, reason), f"line {number} {text}")

    def _add_scan(self, number: int, name: str, line: bytes) -> None:
        breaks = self.breaks.setdefault(name, array("q"))
        if len(breaks) == 2 * MOST_SCANS or len(self.readings.get(name, ())) == MOST_SCANS:
            raise ValueError(f"line {number} is one scan too many; accepted: at most {MOST_SCANS}")
        breaks.append(number)
        try:
            reading = _reading(number, name, line.rstrip(b"\r\n"))
        except BadLineError as error:
            self.leave_out(name, error.reason, number, str(error))
            return
        self.readings.setdefault(name, []).append(reading)

    def _add_odometry(self, number: int, line: bytes) -> None:
        words = line[:1000].split()
        values = [_number(word) for word in words[1:4]]
        time = _time(words[7:10])
        if len(values) < 3 or not all(abs(each) <= LONGEST for each in values):
            return
        if len(self.odometry) == 5 * MOST_ODOMETRY:
            raise ValueError(
                f"line {number} is one line ODOM too many; accepted: at most {MOST_ODOMETRY}"
            )
        self.odometry.extend((number, *values, time))


def _reading(number: int, name: str, line: bytes) -> Reading:
    """Return the scan of a line, or raise a `BadLineError` that tells what it has instead."""
    if len(line) > LONGEST_LINE:
        raise BadLineError(
            "length", f"has {len(line)} bytes; accepted: at most {LONGEST_LINE} bytes"
        )
    family = name.rstrip("12345")
    if family in ("RAWLASER", "ROBOTLASER"):
        return _long(number, family, line)
    words, beams = _split_line(line, 1)
    poses = 3 if name == "LASER_READING" else 6
    tail = words[2 + beams :]
    # Old logs end with a host or have none.
    if not poses < len(tail) <= poses + 3:
        form = "FLASER" if name == "RLASER" else name
        raise _columns(words, 2 + beams + poses + (1 if poses == 3 else 3), form, name)
    time = _time(tail[poses:])
    if not math.isfinite(time):
        raise _not_finite(tail[-1])
    values = _finite(tail[:poses])
    _check_poses(values)
    pose, odometry = values[:3], values[-3:]
    return Reading(number, _ranges(words[2 : 2 + beams], math.inf), pose, odometry, time, None)


def _long(number: int, family: str, line: bytes) -> Reading:
    """Return the scan of a line that describes the lidar."""
    words, beams = _split_line(line, 8, spare=MOST_BEAMS + 20)
    rest = words[9 + beams :]
    remissions = _whole(rest[0]) if rest else -1
    poses = 11 if family == "ROBOTLASER" else 0
    tail = rest[1 + remissions :]
    if remissions < 0 or not poses < len(tail) <= poses + 3:
        wanted = 9 + beams + 1 + max(remissions, 0) + poses + 3
        raise _columns(words, wanted, family, words[0].decode("ascii", "replace"))
    _, first, _, step, greatest, *_ = _finite(words[1:8])
    is_known = step > 0.0 and (beams - 1) * step <= math.tau + 1e-3 and abs(first) <= math.tau
    values, time = _finite(tail[:poses]), _time(tail[poses:])
    if not math.isfinite(time):
        raise _not_finite(tail[-1])
    _check_poses(values[:6])
    return Reading(
        number,
        _ranges(words[9 : 9 + beams], greatest if greatest > 0.0 else math.inf),
        values[:3] if poses else None,
        values[3:6] if poses else None,
        time,
        (first, step) if is_known else None,
    )


def _split_line(line: bytes, at: int, spare: int = 20) -> tuple[list[bytes], int]:
    """Return the words of a line, and the number of beams, which is the word at index `at`.

    The line is split at most `beams + at + spare` times, and the rest is one word.
    """
    head = line.split(None, at + 1)
    beams = _whole(head[at]) if len(head) > at else 0
    if not 1 <= beams <= MOST_BEAMS:
        shown = _show_word(head[at]) if len(head) > at else "no"
        raise BadLineError(
            "beams", f"has {shown} beams; accepted: a whole number from 1 to {MOST_BEAMS}"
        )
    return line.split(None, beams + at + spare), beams


def _whole(word: bytes) -> int:
    return int(word) if word.isdigit() and len(word) < 9 else -1


def _number(word: bytes) -> float:
    # `float` reads texts such as "1_0", and digits of other alphabets only from a text.
    try:
        return math.nan if b"_" in word else float(word)
    except ValueError:
        return math.nan


def _time(words: Sequence[bytes]) -> float:
    """Return the last of some words that is a finite number; NaN without any."""
    finite = [value for value in map(_number, words) if math.isfinite(value)]
    return finite[-1] if finite else math.nan


def _values(words: Sequence[bytes]) -> Floats:
    """Return numbers; NaN for what is none."""
    try:
        values = [float(word) for word in words]
    except ValueError:
        return np.array([_number(word) for word in words])
    if any(b"_" in word for word in words):
        values = [_number(word) for word in words]
    return np.array(values)


def _finite(words: Sequence[bytes]) -> Floats:
    values = _values(words)
    is_bad = ~np.isfinite(values)
    if is_bad.any():
        raise _not_finite(words[int(is_bad.argmax())])
    return values


def _ranges(words: Sequence[bytes], greatest: float) -> Floats:
    """Return readings; those that met nothing, from `greatest` [m] on, are at least `NO_ECHO`."""
    values = _values(words)
    for index in np.flatnonzero(~np.isfinite(values)).tolist():
        # What was converted from ROS has infinite readings where a beam met nothing.
        if words[index].lower() not in (b"inf", b"+inf"):
            raise _not_finite(words[index])
        values[index] = NO_ECHO
    if not (values.min() >= 0.0 and values.max() <= LONGEST_RANGE):
        wrong = values[(values < 0.0) | (values > LONGEST_RANGE)][0]
        raise BadLineError(
            "ranges", f"has a range of {wrong:g} m; accepted: 0 to {LONGEST_RANGE:g} m"
        )
    return np.where(values >= greatest, np.maximum(values, NO_ECHO), values)


def _check_poses(values: Floats) -> None:
    if len(values) and np.abs(values).max() > LONGEST:
        wrong = values[np.abs(values) > LONGEST][0]
        raise BadLineError("poses", f"has a pose with {wrong:g}; accepted: up to {LONGEST:g}")


def _not_finite(word: bytes) -> BadLineError:
    return BadLineError(
        "numbers", f"has {_show_word(word)} among its numbers; accepted: finite numbers"
    )


def _columns(words: Sequence[bytes], wanted: int, form: str, name: str) -> BadLineError:
    return BadLineError(
        "columns", f"has {len(words)} columns; accepted: {wanted}: {name}, {_FORMS[form]}"
    )


def _show_word(word: bytes) -> str:
    return short_repr(word[:200].decode("ascii", "backslashreplace"))


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

    In a corrected log of GMapping a line ODOM with the corrected pose follows each scan, and those
    up to the next scan continue by the odometry: the odometry between two scans is the motion from
    the first to the last. Where there are none, the motion between corrected poses stands for it.
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
