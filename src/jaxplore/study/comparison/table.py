"""Tables of a comparison on maps, one for each map, with a row for each variant."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from jaxplore.report.metrics import Column
from jaxplore.report.statistics import Ratio, paired_ratio
from jaxplore.study.comparison.rows import Row

REFERENCE = "nearest-frontier"
"""Reference variant, with which the others are compared; without it the first one by name."""


def _column(name: str, header: str, *, digits: int = 1, scale: float = 1.0) -> Column:
    return Column.quartiles(
        name, header, digits=digits, scale=scale, number=lambda row: row[name], separator="\n"
    )


COMPARED = (
    _column("time_to_90", "90 % after [s]"),
    _column("path_to_90", "90 % path [m]"),
    _column("time_to_99", "99 % after [s]"),
    _column("path_to_99", "99 % path [m]"),
)
"""Columns that show the ratio to the reference."""
COLUMNS = (
    *COMPARED,
    _column("coverage", "coverage [%]", scale=100.0),
    _column("collisions_per_100m", "collisions per 100 m", digits=2),
)

NEEDED = ("map", "explorer", "seed", "error", "is_finished", *(each.name for each in COLUMNS))
"""Columns of the results that the tables need."""


class MapTable(NamedTuple):
    """Table of the results on one map: the header, then a row for each variant.

    The lines of a cell are the median, the quartiles if they differ, and the ratio to the
    reference's median.
    """

    map: str
    rows: list[tuple[str, ...]]

    @property
    def title(self) -> str:
        """Title of the table: the map and the kind of numbers."""
        return f"{self.map}: medians [quartiles]"


def map_tables(results: Sequence[Row]) -> list[MapTable]:
    """Make a table for each map with a successful run, from rows with the columns `NEEDED`."""
    runs = [row for row in results if row["error"] is None]
    reference = find_reference(results)
    return [
        MapTable(name, _rows([row for row in runs if row["map"] == name], reference))
        for name in _in_order(row["map"] for row in runs)
    ]


def find_reference(results: Sequence[Row]) -> str:
    """Return the variant with which the others are compared."""
    names = {row["explorer"] for row in results}
    return REFERENCE if REFERENCE in names else min(names, default=REFERENCE)


def list_failures(results: Sequence[Row]) -> list[str]:
    """Summarise failed runs: one line for each map, variant and reason, with their number."""
    counts: dict[tuple[str, str, str], int] = {}
    for row in results:
        if row["error"] is not None:
            key = (row["map"], row["explorer"], row["error"])
            counts[key] = counts.get(key, 0) + 1
    return [
        f"{map_}, {explorer}: {number} run{'s' if number > 1 else ''} failed: {error}"
        for (map_, explorer, error), number in counts.items()
    ]


def _rows(runs: Sequence[Row], compared_with: str) -> list[tuple[str, ...]]:
    by_variant = {
        name: [row for row in runs if row["explorer"] == name]
        for name in _in_order(row["explorer"] for row in runs)
    }
    reference = by_variant.get(compared_with)
    table = [("", "finished", *(column.header for column in COLUMNS))]
    for name, own in by_variant.items():
        finished = f"{sum(bool(row['is_finished']) for row in own)} of {len(own)}"
        other = None if name == compared_with else reference
        table.append((name, finished, *(_cell(column, own, other) for column in COLUMNS)))
    return table


def _cell(column: Column, runs: Sequence[Row], reference: Sequence[Row] | None) -> str:
    lines = [column.text(column.value(runs))]
    if reference is not None and column in COMPARED:
        ours, theirs = (
            {row["seed"]: row[column.name] for row in some} for some in (runs, reference)
        )
        lines += _times(paired_ratio(ours, theirs))
    return "\n".join(lines)


def _times(ratio: Ratio | None) -> list[str]:
    # Without a finite ratio the cells of the two variants already show which one never finished.
    if ratio is None or not 0.0 < ratio.value < math.inf:
        return []
    value, low, high = (f"{each:.2f}" if math.isfinite(each) else "-" for each in ratio)
    return [f"x {value} [{low}, {high}]"]


def _in_order(names: Iterable[str]) -> list[str]:
    return list(dict.fromkeys(names))
