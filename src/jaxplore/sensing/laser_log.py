"""Read logs of real planar lidars, in the text format of CARMEN."""

import io
import math
import zlib
from collections import Counter
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jaxplore import _checks, _kinds
from jaxplore._files import read_bytes
from jaxplore._text import error_reason, printable_path
from jaxplore.sensing.beams import Beams, Scan, angle_between, fan_angles
from jaxplore.sensing.carmen import (
    KINDS,
    NO_ECHO,
    LogLines,
    Reading,
    choose_kind,
    find_poses,
    is_mounted,
    odometry_by_lines,
    select_alike,
    select_in_order,
)

LOG_LIMIT = 100_000_000
"""Largest log that is read, unpacked [bytes]: hours of scans of 181 beams."""
MOST_BAD, MOST_ASTRAY = 0.5, 0.1
"""Greatest share of lines that are no scan, and of scans out of order or far from the one before,
that a log may have."""
FEW_ASTRAY = 3
"""Number of scans out of order that any log may have."""
ANGLES = {
    **dict.fromkeys((180, 181), (-90.0, 1.0)),
    **dict.fromkeys((360, 361), (-90.0, 0.5)),
    **dict.fromkeys((400, 401), (-50.0, 0.25)),
    **dict.fromkeys((540, 541), (-135.0, 0.5)),
    **dict.fromkeys((1080, 1081), (-135.0, 0.25)),
    **dict.fromkeys((682, 683), (-341.0 * 360.0 / 1024.0, 360.0 / 1024.0)),
}
"""Direction of the first beam and angle between neighbours by the number of beams [deg], of lidars
of SICK (half a circle, 100 and 270 degrees) and of Hokuyo (270 and 240 degrees)."""
_Floats = NDArray[np.float64]


class LaserLog(NamedTuple):
    """The scans of a planar lidar, and where it was. Arrays of NumPy in double precision.

    Beam i points in the direction `angle_min + i angle_increment`, counter-clockwise from the
    heading of the lidar.

    Args:
        times: times (N,) of the scans, in an order that never decreases [s].
        ranges: readings (N, B) [m]; from 80 m on the beam got no echo.
        poses: poses (N, 3) of the lidar as (x, y, yaw) [m, m, rad], as the log has them: of a
            corrected log those that a mapping program found.
        odometry: poses (N, 3) of the robot by its odometry [m, m, rad]. Where a corrected log
            repeats `poses` in their place, and has the odometry in lines ODOM between the scans,
            they are those of the lidar by these lines.
        angle_min: direction of the first beam [rad].
        angle_increment: angle between neighbouring beams [rad].
        offset: distance of the lidar ahead of the poses in `odometry` [m].
        kind: kind of the lines that were read, such as "FLASER".
        left_out: by reason the number of these lines that were left out.
        news: what was left out, and where first; empty without any.
    """

    times: _Floats
    ranges: _Floats
    poses: _Floats
    odometry: _Floats
    angle_min: float
    angle_increment: float
    offset: float = 0.0
    kind: str = "FLASER"
    left_out: tuple[tuple[str, int], ...] = ()
    news: str = ""

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

    @property
    def is_corrected(self) -> bool:
        """Whether `poses` are more than the odometry of a robot to which the lidar is fixed."""
        return not is_mounted(self.poses, self.odometry)

    @property
    def measured(self) -> _Floats:
        """Poses (N, 3) of the lidar by the odometry alone [m, m, rad]."""
        if not self.is_corrected:
            return self.poses
        yaw = self.odometry[:, 2]
        ahead = np.stack([np.cos(yaw), np.sin(yaw), np.zeros_like(yaw)], axis=1)
        measured: _Floats = self.odometry + self.offset * ahead
        return measured

    @_kinds.check_arguments
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
        ranges = np.where(self.ranges[index] >= NO_ECHO, math.inf, self.ranges[index])
        return Scan.from_ranges(ranges, self.angle_min, self.angle_increment, sensor)


@_kinds.check_arguments
def read_laser_log(path: str | PathLike[str], *, field_of_view: float | None = None) -> LaserLog:
    """Read the scans of a log in the format of CARMEN, or of GMapping (gfs); also packed (.gz).

        FLASER n r_1 ... r_n x y yaw odom_x odom_y odom_yaw ipc_time host logger_time
        RLASER: the same, of a lidar that looks back
        ROBOTLASER1 type angle_min view angle_increment max_range accuracy mode n r_1 ... r_n
            m remission_1 ... remission_m x y yaw odom_x odom_y odom_yaw tv rv 3 numbers, times
        RAWLASER1 as before, without poses, which follow from the times of the lines
        ODOM x y yaw tv rv acceleration, times
        LASER_READING n r_1 ... r_n odom_x odom_y odom_yaw time

    Of several lidars the first one of `carmen.KINDS` is read that has at least half as many lines
    as the one with most. The time of a scan is the last number. Logs may print it with few digits,
    so that many scans have the same; those that are neighbours are at most 10 m apart then.

    Lines that are no such scan are left out and counted, see `LaserLog.left_out`: with other
    columns, another number of beams than most, numbers that are not finite, a time before one that
    more scans agree with, a position too far from the scan before.

    Where the format has no angles they follow from the number of beams. 181 beams are from -90 to
    90 degrees, 1 degree apart, and 361 beams half a degree. 180 and 360 beams are those without the
    last one, so the first is at -90 degrees and the last at 89 or 89.5: not symmetric to the
    heading. 401, 541, 1081 and 683 beams, or one less, are those of other lidars of
    SICK and of Hokuyo, see `ANGLES`. Other numbers need a `field_of_view`.

    Source: the log format of CARMEN, the Carnegie Mellon Robot Navigation Toolkit.

    Args:
        path: path of the file.
        field_of_view: angle between the outermost beams, which are symmetric to the heading then;
            2 pi for a full circle, as of `Lidar` [rad]. By the log when absent.

    Raises:
        ValueError: a file that cannot be read, is larger than 100 MB (also unpacked), or has no
            line with a scan; more than half of the lines are no scan, or more than a tenth of the
            scans are out of order or far from the one before, as of two logs that were mixed; a
            number of beams whose angles are not known; scans without poses; a field of view outside
            (0, 2 pi]. One line that names the file, and a line of the file.
    """
    view = None
    if field_of_view is not None:
        view = _checks.number("field_of_view", field_of_view, above=0.0, at_most=math.tau)
    file = Path(path)
    where = printable_path(file)
    lines = LogLines()
    try:
        for at, line in enumerate(io.BytesIO(_unpack(file)), start=1):
            lines.add(at, line)
    except ValueError as error:
        raise ValueError(f"{where}, {error}") from None
    kind = choose_kind(lines)
    if not kind:
        known = ", ".join(KINDS[:4])
        raise ValueError(f"{where} has no scan; accepted: a CARMEN log with lines {known}")
    readings = select_alike(lines, kind)
    number = len(readings)
    if number < (1.0 - MOST_BAD) * len(lines.breaks[kind]):
        raise ValueError(_refusal(lines, kind, where))
    readings = find_poses(readings, lines, kind)
    if not readings:
        raise ValueError(f"{where} has {kind} without a pose; accepted: a log with lines ODOM")
    readings = select_in_order(readings, lines, kind)
    if number - len(readings) > max(FEW_ASTRAY, MOST_ASTRAY * number):
        raise ValueError(_refusal(lines, kind, where))
    first, spacing = _angles(readings[0], view, where)
    poses, odometry = (
        np.stack(rows)
        for rows in zip(*((each.pose, each.odometry) for each in readings), strict=True)
    )
    offset = lines.offsets["rear" if kind == "RLASER" else "front"]
    # In a corrected log both columns hold the corrected pose. The odometry is then in its lines
    # ODOM.
    if is_mounted(poses, odometry):
        found = odometry_by_lines(lines, kind, readings, poses)
        if found is not None:
            odometry, offset = found, 0.0
    return LaserLog(
        times=np.array([each.time for each in readings]),
        ranges=np.stack([each.ranges for each in readings]),
        poses=poses,
        odometry=odometry,
        angle_min=first,
        angle_increment=spacing,
        offset=offset,
        kind=kind,
        left_out=tuple(sorted(lines.bad.get(kind, Counter()).items())),
        news=_news(lines, kind),
    )


def _unpack(path: Path) -> bytes:
    """Return the text of a log in ASCII, unpacked.

    A `ValueError` refuses a file that cannot be read, is too large, or is packed and damaged at its
    start.
    """
    data = read_bytes(path, "a CARMEN log", LOG_LIMIT)
    if data[:2] == b"\x1f\x8b":
        data = _inflate(data)
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", "replace").encode("ascii", "replace")
    return data.removeprefix(b"\xef\xbb\xbf")


def _inflate(data: bytes) -> bytes:
    """Return what gzip has packed; of a damaged file what comes before the damage."""
    parts: list[bytes] = []
    size = 0
    while data[:2] == b"\x1f\x8b":
        unpacker = zlib.decompressobj(wbits=31)
        try:
            parts.append(unpacker.decompress(data, LOG_LIMIT + 1 - size))
        except zlib.error as error:
            if not any(parts):
                raise ValueError(
                    f"which is packed, cannot be read: {error_reason(error)}"
                ) from None
            break
        size += len(parts[-1])
        if size > LOG_LIMIT:
            raise ValueError(f"unpacked, is too large; accepted: at most {LOG_LIMIT} bytes")
        data = unpacker.unused_data
    return b"".join(parts)


def _refusal(lines: LogLines, kind: str, where: str) -> str:
    """Return why a log is refused: the most frequent reason to leave lines out, and the first."""
    count = lines.bad[kind]
    reason, _ = count.most_common(1)[0]
    return (
        f"{where}, {lines.first_bad[kind, reason]} ({sum(count.values())} of "
        f"{len(lines.breaks[kind])} lines {kind} are wrong)"
    )


def _news(lines: LogLines, kind: str) -> str:
    """Return what was left out and where first, in one line; empty without any."""
    count = lines.bad.get(kind, Counter())
    if not count:
        return ""
    parts = [
        f"{number} by their {reason} ({lines.first_bad[kind, reason]})"
        for reason, number in count.most_common()
    ]
    whole = f"{sum(count.values())} of {len(lines.breaks[kind])} lines {kind} were left out"
    return f"{whole}: {', '.join(parts)}"


def _angles(reading: Reading, view: float | None, where: str) -> tuple[float, float]:
    """Return the direction of the first beam and the angle between two [rad]."""
    beams = len(reading.ranges)
    if view is not None:
        return float(fan_angles(beams, view)[0]), angle_between(beams, view)
    if reading.angles is not None:
        return reading.angles
    if beams not in ANGLES:
        known = ", ".join(map(str, sorted(ANGLES)))
        raise ValueError(
            f"{where}, line {reading.line} has {beams} beams; accepted: {known}, or any number "
            "with a field_of_view"
        )
    first, spacing = ANGLES[beams]
    return math.radians(first), math.radians(spacing)
