"""Rows of results, one for each run of a comparison on maps."""

import io
from typing import Any, NamedTuple

import numpy as np

from jaxplore._files import parse_json
from jaxplore._optional import import_optional
from jaxplore.report.coverage_levels import LEVELS, reach_levels
from jaxplore.report.metrics import CURVE_PERIOD, Metrics, thin_series
from jaxplore.report.recording import Recording
from jaxplore.settings.sections import RunSettings
from jaxplore.study.comparison.episodes import FORMAT, MapEpisode, canonical
from jaxplore.study.comparison.replay import Replay, make_replay

Row = dict[str, Any]
"""Values of a run by column; None where there is no value."""

KEYS = ("map", "explorer", "seed")
"""Columns by which results are sorted."""

COLUMNS = {
    "format": "int32",
    "id": "string",
    "map": "string",
    "explorer": "string",
    "seed": "int64",
    "error": "string",
    "is_finished": "bool",
    "coverage": "double",
    **{f"time_to_{level}": "double" for level in LEVELS},
    **{f"path_to_{level}": "double" for level in LEVELS},
    "path_length": "double",
    "duration": "double",
    "final_entropy": "double",
    "area_under_curve": "double",
    "collisions": "int64",
    "collisions_per_100m": "double",
    "minimum_clearance": "double",
    "information_per_metre": "double",
    "command_jerk": "double",
    "step_ms_p50": "double",
    "step_ms_p99": "double",
    "loop_step_ms": "double",
    "compile_seconds": "double",
    "time_limit": "double",
    "curve_time": "list",
    "curve_coverage": "list",
    "curve_path": "list",
    "curve_entropy": "list",
    "positions_x": "list",
    "positions_y": "list",
    "seen_time": "list",
    "seen": "binary",
    "settings": "string",
    "versions": "string",
}
"""Type of each column. A `list` has several numbers for a run, `binary` is a PNG.

`format` is the version of the rows. `error` is the reason of a failure in one line; then the
columns of results are empty. Times are in s, paths and distances in m, coverage is the share of the
task that is done (see `Course`) and entropy in nat. Of a fleet, paths are those of all robots
together, collisions are also those of robots with one another, and positions are those of one robot
after the other. A number that a kind of task does not have is empty. `area_under_curve` is the mean
coverage over the time limit; a run that has ended keeps its last value. Curves and positions are
those at the start, every half second and at the end. `seen` is the time each cell was first seen,
as an index of `seen_time`: see `Replay`. `settings` and `versions` are JSON: all settings of the
run, the software and the machine.
"""

_NUMBERS = (
    "is_finished",
    "duration",
    "final_entropy",
    "minimum_clearance",
    "information_per_metre",
    "command_jerk",
)
"""Columns that are metrics of the same name, where a kind of task has them."""
TIMING = ("step_ms_p50", "step_ms_p99", "loop_step_ms", "compile_seconds")
"""Columns of wall-clock times. All others are equal to the bit when a run is repeated."""


def make_row(
    episode: MapEpisode,
    recording: Recording,
    metrics: Metrics,
    *,
    settings: RunSettings,
) -> Row:
    """Make the row of a run from its recording, its metrics and its settings, with the start.

    A recording without a `course` raises a `ValueError`.
    """
    course = recording.course()
    if course is None:
        raise ValueError(
            f"recording is {type(recording).__name__}, without a course; accepted: one with it"
        )
    time, done, period = recording.time, course.done, recording.control_period
    stride = max(1, round(CURVE_PERIOD / period))
    kept = np.unique(np.append(np.arange(0, len(time), stride), len(time) - 1))
    replay = (
        Replay([], None) if course.known is None else make_replay(recording.frames, course.known)
    )
    curve = {"time": time, "coverage": done, "path": course.path}
    curve |= {} if course.entropy is None else {"entropy": course.entropy}
    compute, path = metrics.compute, float(course.path[-1])
    x, y = (course.positions[:, kept, axis].reshape(-1).tolist() for axis in (0, 1))
    numbers = {name: getattr(metrics, name, None) for name in _NUMBERS}
    contacts = [getattr(metrics, name, 0) for name in ("collisions", "contacts")]
    levels = reach_levels(done, course.path, period)
    return {
        **dict.fromkeys(COLUMNS),
        **_first_columns(episode, None),
        **numbers,
        "coverage": float(done[-1]),
        **{f"{name}_{level}": levels[name][str(level)] for name in levels for level in LEVELS},
        "path_length": path,
        "area_under_curve": _mean_over(time, done, settings.time_limit),
        "collisions": sum(contacts),
        "collisions_per_100m": 100.0 * sum(contacts) / path if path > 0.0 else None,
        "step_ms_p50": compute.step_ms_p50,
        "step_ms_p99": compute.step_ms_p99,
        "loop_step_ms": compute.loop_step_ms,
        "compile_seconds": compute.compile_seconds,
        "time_limit": settings.time_limit,
        **{f"curve_{name}": values for name, values in thin_series(curve, period).items()},
        "positions_x": x,
        "positions_y": y,
        "seen_time": replay.times,
        "seen": replay.picture,
        "settings": canonical(settings.model_dump(mode="json")),
        "versions": canonical(metrics.versions),
    }


def make_failed_row(episode: MapEpisode, error: str) -> Row:
    """Make the row of a failed run; the reason is joined to one line."""
    row: Row = dict.fromkeys(COLUMNS)
    row |= _first_columns(episode, " ".join(error.split()) or "unknown")
    # The results name the user's file and not its copy on another machine.
    entries = {**episode.entries, episode.selector: episode.path}
    row |= {"time_limit": episode.settings.get("time_limit"), "settings": canonical(entries)}
    return row


class StoredRow(NamedTuple):
    """A row as a Parquet file, as it is sent and stored; `error` is None if the run succeeded."""

    id: str
    map: str
    error: str | None
    data: bytes


def store_row(row: Row) -> StoredRow:
    """Convert a row to the form in which it is sent and stored."""
    pyarrow, parquet = (
        import_optional("pyarrow", "comparison"),
        import_optional("pyarrow.parquet", "comparison"),
    )
    file = io.BytesIO()
    # The checksums show damage that leaves a file readable.
    table = pyarrow.Table.from_pylist([row], schema=schema())
    parquet.write_table(table, file, write_page_checksum=True)
    return StoredRow(row["id"], row["map"], row["error"], file.getvalue())


def is_row(row: Row, id_: str) -> bool:
    """Check that a row that was read is one of a run, with all or nothing of what a page shows."""
    if row["id"] != id_ or any(row[name] is None for name in KEYS):
        return False
    if row["error"] is not None or row["curve_time"] is None:
        return True
    try:
        lists = [
            [np.asarray(row[name], np.float64) for name in together]
            for together in (("curve_time", "curve_coverage"), ("positions_x", "positions_y"))
        ]
        is_whole = len(lists[1][0]) % len(lists[0][0]) == 0
        radius = parse_json(row["settings"])["robot"]["radius"]
        numbers = [row["duration"], row["time_limit"], radius]
        return (
            is_whole
            and all(len(a) == len(b) > 0 and np.isfinite([*a, *b]).all() for a, b in lists)
            and bool(np.isfinite([*numbers, *row["seen_time"]]).all())
            and isinstance(row["seen"], bytes | None)
        )
    except (ValueError, TypeError, LookupError):
        return False


def schema() -> Any:
    """Return the pyarrow schema of the columns."""
    pyarrow = import_optional("pyarrow", "comparison")
    kinds = {
        "int32": pyarrow.int32(),
        "int64": pyarrow.int64(),
        "string": pyarrow.string(),
        "bool": pyarrow.bool_(),
        "double": pyarrow.float64(),
        "list": pyarrow.list_(pyarrow.float64()),
        "binary": pyarrow.binary(),
    }
    return pyarrow.schema([(name, kinds[kind]) for name, kind in COLUMNS.items()])


def _first_columns(episode: MapEpisode, error: str | None) -> Row:
    return {
        "format": FORMAT,
        "id": episode.id,
        "map": episode.map,
        "explorer": episode.explorer,
        "seed": episode.seed,
        "error": error,
    }


def _mean_over(time: np.ndarray, values: np.ndarray, time_limit: float) -> float:
    """Compute the mean of a step function from 0 to the time limit; the last value is held."""
    # Time beyond the limit counts nothing, and the last value lasts until the limit.
    instants = np.append(np.minimum(time, time_limit), time_limit)
    return float(np.sum(np.diff(instants) * values.astype(np.float64)) / time_limit)
