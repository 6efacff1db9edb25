"""The results of a benchmark as tables: one for each map, one row for each explorer."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from jaxplore.study.comparison.rows import Row
from jaxplore.study.comparison.statistics import Quartiles, Ratio, paired_ratio, quartiles

REFERENCE = "nearest-frontier"
"""The explorer that the others are compared with where it is there."""


class Column(NamedTuple):
    """One column of numbers.

    Args:
        name: in the results.
        header: name and unit in the table.
        digits: behind the point.
        factor: of what is shown.
        has_ratio: whether it is compared with the reference.
    """

    name: str
    header: str
    digits: int = 1
    factor: float = 1.0
    has_ratio: bool = False


COLUMNS = (
    Column("time_to_90", "90 % after [s]", has_ratio=True),
    Column("path_to_90", "90 % path [m]", has_ratio=True),
    Column("time_to_99", "99 % after [s]", has_ratio=True),
    Column("path_to_99", "99 % path [m]", has_ratio=True),
    Column("coverage", "coverage [%]", factor=100.0),
    Column("collisions_per_100m", "collisions per 100 m", digits=2),
)

NEEDED = ("map", "explorer", "seed", "error", "is_finished", *(each.name for each in COLUMNS))
"""Columns of the results that the tables are made from."""


class MapTable(NamedTuple):
    """Results on one map.

    Args:
        map: name of the map.
        rows: header, then a row for each explorer. A cell has a line each for the median, the
            quartiles if they differ, and the ratio to the reference's median.
    """

    map: str
    rows: list[tuple[str, ...]]


def map_tables(results: Sequence[Row]) -> list[MapTable]:
    """Return a table for each map on which any run was made.

    Args:
        results: rows with the columns `NEEDED`; failed ones are left out.
    """
    runs = [row for row in results if row["error"] is None]
    return [
        MapTable(name, _rows([row for row in runs if row["map"] == name]))
        for name in _in_order(row["map"] for row in runs)
    ]


def failures(results: Sequence[Row]) -> list[str]:
    """Return a line for each map, explorer and reason of failed runs, with their number."""
    counts: dict[tuple[str, str, str], int] = {}
    for row in results:
        if row["error"] is not None:
            key = (row["map"], row["explorer"], row["error"])
            counts[key] = counts.get(key, 0) + 1
    return [
        f"{map_}, {explorer}: {number} run{'s' if number > 1 else ''} failed: {error}"
        for (map_, explorer, error), number in counts.items()
    ]


def _rows(runs: Sequence[Row]) -> list[tuple[str, ...]]:
    by_explorer = {
        name: [row for row in runs if row["explorer"] == name]
        for name in _in_order(row["explorer"] for row in runs)
    }
    reference = by_explorer.get(REFERENCE)
    table = [("", "finished", *(column.header for column in COLUMNS))]
    for name, own in by_explorer.items():
        finished = f"{sum(bool(row['is_finished']) for row in own)} of {len(own)}"
        other = None if name == REFERENCE else reference
        table.append((name, finished, *(_cell(column, own, other) for column in COLUMNS)))
    return table


def _cell(column: Column, runs: Sequence[Row], reference: Sequence[Row] | None) -> str:
    lines = _spread(quartiles([row[column.name] for row in runs]), column)
    if reference is not None and column.has_ratio:
        ours, theirs = (
            {row["seed"]: row[column.name] for row in some} for some in (runs, reference)
        )
        lines += _times(paired_ratio(ours, theirs))
    return "\n".join(lines)


def _spread(spread: Quartiles, column: Column) -> list[str]:
    low, median, high = (_text(column.factor * value, column.digits) for value in spread)
    return [median] if low == high else [median, f"[{low}, {high}]"]


def _times(ratio: Ratio | None) -> list[str]:
    # Where one of them never gets there, their own cells say so.
    if ratio is None or not 0.0 < ratio.value < math.inf:
        return []
    value, low, high = (_text(each, 2) for each in ratio)
    return [f"x {value} [{low}, {high}]"]


def _text(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _in_order(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))
