"""Read paths from files: waypoints in CSV, with or without track widths, and ROS paths in YAML."""

import math
from os import PathLike
from pathlib import Path as FilePath

import numpy as np

from jaxplore import _kinds
from jaxplore._files import read_bytes, read_yaml
from jaxplore._text import printable_path, short_repr
from jaxplore.geometry.curves import path_through
from jaxplore.geometry.path import Path
from jaxplore.maps.datum import ORIGIN, Datum

CSV_LIMIT = 10_000_000
"""Largest CSV file that is read [bytes]."""
YAML_LIMIT = 1_000_000
"""Largest YAML file that is read [bytes]: about 5000 poses."""
MOST_WAYPOINTS = 100_000
"""Greatest number of waypoints of a path."""
DEGREES = ("lat", "lon", "lng")
"""What names of columns begin with that are no metres."""
COLUMNS = {
    2: "x, y",
    3: "x, y and a column that is not read",
    4: "x, y, room to the right, room to the left",
}


@_kinds.check_arguments
def read_path(
    path: str | PathLike[str],
    *,
    method: str = "cubic",
    is_closed: bool | None = None,
    datum: Datum = ORIGIN,
) -> Path:
    """Read waypoints from a file and return the smooth path through them.

    - `.csv`, `.txt`: one waypoint per row, x, y [m], separated by commas, semicolons or spaces.
      Four columns are x, y, free width to the right, free width to the left [m], as in the centre
      lines of F1TENTH and TUM. `#` begins a comment, and a first row of column names is skipped;
      names of latitudes and longitudes are refused.
    - `.yaml`, `.yml`: a ROS `nav_msgs/Path` as `ros2 topic echo` prints it: `poses`, each with
      `pose: position: x, y`, or with `position` itself. z and orientation are not read.

    A waypoint equal to the one before is dropped: recorded paths repeat them while the robot
    stands still.

    Args:
        path: path of the file.
        method: spline method; see `path_through`.
        is_closed: whether the path is a lap. By default it is closed if the last waypoint equals
            the first, or if track widths are given and the last waypoint is at most twice the
            longest step away from the first.
        datum: point of the file's coordinates to which the path is relative, which a path far from
            the origin needs: `path_datum` chooses it.

    Raises:
        ValueError: a file that cannot be read, that holds something else or fewer than two
            different waypoints, and what `path_through` refuses; one line that names the file.
    """
    if is_closed is not None:
        _kinds.flag("is_closed", is_closed)
    rows = _rows(path)
    rows[:, :2] = datum.to_local(rows[:, :2])
    where = printable_path(FilePath(path))
    repeats = (np.diff(rows[:, :2], axis=0) == 0.0).all(axis=1)
    rows = rows[np.concatenate([[True], ~repeats])]
    if len(rows) < 2:
        raise ValueError(f"{where} has {len(rows)} different waypoints; accepted: two or more")
    # `path_through` closes the path itself, so a repeated first waypoint is dropped.
    ends_meet = len(rows) > 3 and bool((rows[0, :2] == rows[-1, :2]).all())
    if is_closed is None:
        is_closed = ends_meet or (rows.shape[1] == 4 and _nearly_meets(rows[:, :2]))
    if is_closed and ends_meet:
        rows = rows[:-1]
    # Files give the right width first, `Path` takes the left one first.
    widths = rows[:, [3, 2]] if rows.shape[1] == 4 else None
    try:
        return path_through(rows[:, :2], method=method, is_closed=is_closed, half_widths=widths)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None


def read_path_file(path: str | PathLike[str]) -> bytes:
    """Return the content of a path file, to send it to another machine.

    A file that cannot be read or is too large raises a `ValueError`.
    """
    return read_bytes(FilePath(path), "a path's", CSV_LIMIT)


def path_datum(path: str | PathLike[str]) -> Datum:
    """Return the datum for a path: (0, 0), or its first waypoint in whole metres if that is far
    away.

    Args:
        path: path of the file.

    Raises:
        ValueError: as of `read_path`, and a waypoint beyond 1e9 m.
    """
    x, y = _rows(path)[0, :2].tolist()
    return Datum.near(x, y, name=f"{printable_path(FilePath(path))}, waypoint 1")


@_kinds.check_arguments
def _rows(path: str | PathLike[str]) -> np.ndarray:
    file = FilePath(path)
    where = printable_path(file)
    suffix = file.suffix.lower()
    if suffix in (".csv", ".txt"):
        rows = _csv_rows(file)
    elif suffix in (".yaml", ".yml"):
        rows = _ros_rows(file)
    else:
        raise ValueError(f"path is {where}; accepted: a .csv, .txt, .yaml or .yml file")
    if not np.isfinite(rows).all():
        index = int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])
        raise ValueError(
            f"{where}, waypoint {index + 1} is {rows[index].tolist()}; accepted: finite numbers"
        )
    return rows


def _nearly_meets(points: np.ndarray) -> bool:
    steps = np.hypot(*np.diff(points, axis=0).T)
    return len(points) > 3 and math.dist(points[0], points[-1]) <= 2.0 * float(steps.max())


def _csv_rows(file: FilePath) -> np.ndarray:
    where = printable_path(file)
    data = read_bytes(file, "a path's CSV", CSV_LIMIT)
    try:
        # Spreadsheets may write a byte order mark before the first number.
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{where} is not text; accepted: numbers in UTF-8") from None
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        content = line.partition("#")[0].strip()
        if not content:
            continue
        content = content.replace(";", ",")
        cells = content.split(",") if "," in content else content.split()
        try:
            row = [float(cell) for cell in cells if cell.strip()]
        except ValueError:
            if not rows and not any(_is_number(cell) for cell in cells):
                # Column names. Degrees read as metres would be a path of some micrometres.
                if any(cell.strip().lower().startswith(DEGREES) for cell in cells):
                    raise ValueError(
                        f"{where} has the columns {short_repr(content)}; accepted: x, y [m], in a "
                        "projection such as UTM"
                    ) from None
                continue
            raise ValueError(
                f"{where}, line {number} is {short_repr(content)}; accepted: numbers"
            ) from None
        if rows and len(row) != len(rows[0]):
            raise ValueError(
                f"{where}, line {number} has {len(row)} columns; accepted: {len(rows[0])}, as in "
                "the lines before"
            )
        if len(row) not in COLUMNS:
            raise ValueError(
                f"{where}, line {number} has {len(row)} columns; accepted: "
                + "; ".join(f"{count}: {names}" for count, names in COLUMNS.items())
            )
        if len(rows) == MOST_WAYPOINTS:
            raise ValueError(
                f"{where}, line {number} is one waypoint too many; accepted: at most "
                f"{MOST_WAYPOINTS} waypoints"
            )
        rows.append(row)
    if not rows:
        raise ValueError(f"{where} has no waypoints; accepted: two or more")
    return np.array(rows, np.float64)


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _ros_rows(file: FilePath) -> np.ndarray:
    where = printable_path(file)
    poses = read_yaml(file, "path", YAML_LIMIT).get("poses")
    if not isinstance(poses, list) or not poses:
        raise ValueError(
            f"{where} has poses {short_repr(poses)}; accepted: a list, as in nav_msgs/Path"
        )
    if len(poses) > MOST_WAYPOINTS:
        raise ValueError(f"{where} has {len(poses)} waypoints; accepted: at most {MOST_WAYPOINTS}")
    rows = []
    for index, stamped in enumerate(poses):
        pose = stamped.get("pose", stamped) if isinstance(stamped, dict) else None
        position = pose.get("position") if isinstance(pose, dict) else None
        try:
            if not isinstance(position, dict):
                raise TypeError
            rows.append([_coordinate(position["x"]), _coordinate(position["y"])])
        except (KeyError, TypeError):
            raise ValueError(
                f"{where}, poses[{index}] is {short_repr(stamped)}; accepted: pose: position: x, y"
            ) from None
    return np.array(rows, np.float64)


def _coordinate(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise TypeError
    return float(value)
