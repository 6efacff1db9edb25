"""Read logs of real planar lidars, in the text format of CARMEN."""

import math
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxplore import _checks, _kinds
from jaxplore._files import read_bytes
from jaxplore._limits import LONGEST, LONGEST_RANGE, MOST_BEAMS
from jaxplore._text import printable_path, short_repr
from jaxplore.sensing.beams import Beams, Scan, angle_between, fan_angles

LOG_LIMIT = 100_000_000
"""Largest log that is read [bytes]: hours of scans of 181 beams."""
MOST_SCANS = 200_000
"""Greatest number of scans of a log."""
LONGEST_STEP = 10.0
"""Greatest distance between neighbouring scans to which a log gives the same time [m]."""
NO_ECHO = 80.0
"""Readings from here on mean that a beam of a SICK LMS got no echo [m]."""
SPACINGS = {180: 1.0, 181: 1.0, 360: 0.5, 361: 0.5}
"""Angle between neighbouring beams by their number, of lidars with half a circle of view [deg]."""
_FORM = "FLASER, the number n, n ranges, 6 numbers of two poses, a time, a host, a time"
_Floats = NDArray[np.float64]


class LaserLog(NamedTuple):
    """The scans of a planar lidar, and where it was. Arrays of NumPy in double precision.

    Beam i points in the direction `angle_min + i angle_increment`, counter-clockwise from the
    heading of the lidar.

    Args:
        times: times (N,) of the scans, in an order that never decreases [s].
        ranges: readings (N, B) [m]; of a SICK LMS, from 80 m on the beam got no echo.
        poses: poses (N, 3) of the lidar as (x, y, yaw) [m, m, rad], as the log has them: of a
            corrected log those that a mapping program found.
        odometry: poses (N, 3) of the robot by its odometry [m, m, rad]. In corrected logs they are
            often `poses` again.
        angle_min: direction of the first beam [rad].
        angle_increment: angle between neighbouring beams [rad].
    """

    times: _Floats
    ranges: _Floats
    poses: _Floats
    odometry: _Floats
    angle_min: float
    angle_increment: float

    @property
    def field_of_view(self) -> float:
        """Angle between the outermost beams [rad]."""
        return self.angle_increment * float(self.ranges.shape[1] - 1)

    @property
    def beam_angles(self) -> _Floats:
        """Direction of each beam (B,) relative to the heading [rad]."""
        steps = np.arange(self.ranges.shape[1], dtype=np.float64)
        angles: _Floats = self.angle_min + self.angle_increment * steps
        return angles

    def scan(self, index: int, sensor: Beams) -> Scan:
        """Return a scan of the log as one of a sensor; see `Scan.from_ranges`.

        A reading of `NO_ECHO` or more met nothing within the sensor's range.

        Args:
            index: number of the scan, from 0.
            sensor: sensor that the scan is for.

        Raises:
            ValueError: a number that no scan has, something else than a sensor.
        """
        last = len(self.times) - 1
        index = _checks.whole_number("index", index, at_least=0, at_most=last)
        _kinds.instance("sensor", sensor, Beams)
        ranges = np.where(self.ranges[index] >= NO_ECHO, math.inf, self.ranges[index])
        return Scan.from_ranges(ranges, self.angle_min, self.angle_increment, sensor)


def read_laser_log(path: str | PathLike[str], *, field_of_view: float | None = None) -> LaserLog:
    """Read the scans of a log in the format of CARMEN: its lines FLASER.

        FLASER n r_1 ... r_n x y yaw odom_x odom_y odom_yaw ipc_time host logger_time

    Other lines, such as ODOM, PARAM and comments after `#`, are skipped. The time of a scan is the
    last number. Logs may print it with few digits, so that many scans have the same; those that are
    neighbours are at most 10 m apart then.

    The format has no angles: they follow from the number of beams. 181 beams are from -90 to 90
    degrees, 1 degree apart, and 361 beams half a degree. 180 and 360 beams are those without the
    last one, so the first is at -90 degrees and the last at 89 or 89.5: not symmetric to the
    heading. Other numbers need a `field_of_view`.

    Source: the log format of CARMEN, the Carnegie Mellon Robot Navigation Toolkit.

    Args:
        path: path of the file.
        field_of_view: angle between the outermost beams, which are symmetric to the heading then;
            2 pi for a full circle, as of `Lidar` [rad]. By the number of beams when absent.

    Raises:
        ValueError: a file that cannot be read, is larger than 100 MB, or has no FLASER line; a line
            with other columns, another number of beams than the first, something else than finite
            numbers, a negative range, a time before the last one, or the last one's far from it; a
            number of beams whose angles are not known; a field of view outside (0, 2 pi]. One line
            that names the file, and the line of the file.
    """
    _kinds.instance("path", path, str, PathLike)
    view = None
    if field_of_view is not None:
        view = _checks.number("field_of_view", field_of_view, above=0.0, at_most=math.tau)
    file = Path(path)
    where = printable_path(file)
    rows: list[_Floats] = []
    count, before = 0, -math.inf
    lines = read_bytes(file, "a CARMEN log", LOG_LIMIT).split(b"\n")
    for number, line in enumerate(lines, start=1):
        if line[:6] != b"FLASER" or line[6:7] not in (b" ", b"\t"):
            continue
        try:
            row = _row(line.split(), count)
            if row[-1] < before:
                raise ValueError(f"has the time {row[-1]:.10g}; accepted: at least {before:.10g}")
            # Where equal times say nothing about the order, the way of the robot does.
            step = math.dist(row[count : count + 2], rows[-1][count : count + 2]) if rows else 0.0
            if row[-1] == before and step > LONGEST_STEP:
                raise ValueError(
                    f"has the time of the scan before, {step:.1f} m away; accepted: at most "
                    f"{LONGEST_STEP:g} m"
                )
            if len(rows) == MOST_SCANS:
                raise ValueError(f"is one scan too many; accepted: at most {MOST_SCANS}")
        except ValueError as error:
            raise ValueError(f"{where}, line {number} {error}") from None
        count, before = len(row) - 7, float(row[-1])
        if view is None and count not in SPACINGS:
            known = ", ".join(map(str, SPACINGS))
            raise ValueError(
                f"{where}, line {number} has {count} beams; accepted: {known}, or any number with "
                "a field_of_view"
            )
        rows.append(row)
    if not rows:
        raise ValueError(f"{where} has no scan; accepted: a CARMEN log with lines FLASER")
    first, spacing = _angles(count, view)
    made = np.stack(rows)
    return LaserLog(
        times=made[:, -1],
        ranges=made[:, :count],
        poses=made[:, count : count + 3],
        odometry=made[:, count + 3 : count + 6],
        angle_min=first,
        angle_increment=spacing,
    )


def _row(words: list[bytes], count: int) -> _Floats:
    """Return the ranges, the poses and the time of a line, n + 7 numbers.

    Args:
        words: the words of the line.
        count: number of beams of the lines before; 0 for the first line.

    Raises:
        ValueError: what the line has, without its place.
    """
    beams = int(words[1]) if len(words) > 1 and words[1].isdigit() and len(words[1]) < 9 else 0
    if not 1 <= beams <= MOST_BEAMS:
        shown = _shown(words[1]) if len(words) > 1 else "no"
        raise ValueError(f"has {shown} beams; accepted: a whole number from 1 to {MOST_BEAMS}")
    if len(words) != beams + 11:
        raise ValueError(f"has {len(words)} columns; accepted: {beams + 11}: {_FORM}")
    if count not in (0, beams):
        raise ValueError(f"has {beams} beams; accepted: {count}, as in the lines before")
    row = np.empty(beams + 7)
    for index, word in enumerate([*words[2 : beams + 8], words[-1]]):
        # `float` reads texts such as "1_0", and digits of other alphabets only from a text.
        try:
            row[index] = float("nan" if b"_" in word else word)
        except ValueError:
            row[index] = math.nan
        if not math.isfinite(row[index]):
            raise ValueError(f"has {_shown(word)} among its numbers; accepted: finite numbers")
    ranges, poses = row[:beams], row[beams:-1]
    if not (ranges.min() >= 0.0 and ranges.max() <= LONGEST_RANGE):
        bad = ranges[(ranges < 0.0) | (ranges > LONGEST_RANGE)][0]
        raise ValueError(f"has a range of {bad:g} m; accepted: 0 to {LONGEST_RANGE:g} m")
    if np.abs(poses).max() > LONGEST:
        bad = poses[np.abs(poses) > LONGEST][0]
        raise ValueError(f"has a pose with {bad:g}; accepted: numbers up to {LONGEST:g}")
    return row


def _shown(word: bytes) -> str:
    return short_repr(word.decode("ascii", "backslashreplace"))


def _angles(beams: int, view: float | None) -> tuple[float, float]:
    """Return the direction of the first beam and the angle between two [rad]."""
    if view is None:
        return -0.5 * math.pi, math.radians(SPACINGS[beams])
    return float(fan_angles(beams, view)[0]), angle_between(beams, view)
