"""Rows of results, one for each run of a comparison on maps."""

import io
from typing import Any, NamedTuple

import numpy as np

from jaxplore._files import parse_json
from jaxplore._optional import import_optional
from jaxplore.report.coverage_levels import LEVELS
from jaxplore.report.exploration.data import ExplorationData
from jaxplore.report.exploration.metrics import ExplorationMetrics
from jaxplore.report.exploration.progress import progress
from jaxplore.report.metrics import CURVE_PERIOD
from jaxplore.study.comparison.episodes import FORMAT, MapEpisode, canonical
from jaxplore.study.comparison.replay import make_replay
from jaxplore.tasks.exploration.settings import Settings

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
columns of results are empty. Times are in s, paths and distances in m, coverage is a share of the
reachable cells and entropy in nat, as in `ExplorationMetrics`. `area_under_curve` is the mean
coverage over the time limit; a run that has ended keeps its last value. Curves and positions are
those at the start, every half second and at the end. `seen` is the time each cell was first seen,
as an index of `seen_time`: see `Replay`. `settings` and `versions` are JSON: all settings of the
run, the software and the machine.
"""

TIMING = ("step_ms_p50", "step_ms_p99", "loop_step_ms", "compile_seconds")
"""Columns of wall-clock times. All others are equal to the bit when a run is repeated."""


def make_row(
    episode: MapEpisode,
    recording: ExplorationData,
    metrics: ExplorationMetrics,
    *,
    settings: Settings,
) -> Row:
    """Make the row of a run from its recording, its metrics and its settings, with the start."""
    time, coverage, _, _ = progress(recording)
    stride = max(1, round(CURVE_PERIOD / recording.control_period))
    kept = np.unique(np.append(np.arange(0, len(time), stride), len(time) - 1))
    replay = make_replay(recording)
    compute, curve, path = metrics.compute, metrics.coverage_curve, metrics.path_length
    return {
        **_first_columns(episode, None),
        "is_finished": metrics.is_finished,
        "coverage": metrics.coverage,
        **{f"time_to_{level}": metrics.time_to[str(level)] for level in LEVELS},
        **{f"path_to_{level}": metrics.path_to[str(level)] for level in LEVELS},
        "path_length": path,
        "duration": metrics.duration,
        "final_entropy": metrics.final_entropy,
        "area_under_curve": _mean_over(time, coverage, settings.time_limit),
        "collisions": metrics.collisions,
        "collisions_per_100m": 100.0 * metrics.collisions / path if path > 0.0 else None,
        "minimum_clearance": metrics.minimum_clearance,
        "information_per_metre": metrics.information_per_metre,
        "command_jerk": metrics.command_jerk,
        "step_ms_p50": compute.step_ms_p50,
        "step_ms_p99": compute.step_ms_p99,
        "loop_step_ms": compute.loop_step_ms,
        "compile_seconds": compute.compile_seconds,
        "time_limit": settings.time_limit,
        **{f"curve_{name}": curve[name] for name in ("time", "coverage", "path", "entropy")},
        "positions_x": recording.positions[kept, 0].tolist(),
        "positions_y": recording.positions[kept, 1].tolist(),
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
    entries = {**episode.entries, "map": episode.path}
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
        radius = parse_json(row["settings"])["robot"]["radius"]
        numbers = [row["duration"], row["time_limit"], radius]
        return (
            all(len(a) == len(b) > 0 and np.isfinite([*a, *b]).all() for a, b in lists)
            and bool(np.isfinite([*numbers, *row["seen_time"]]).all())
            and isinstance(row["seen"], bytes)
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
