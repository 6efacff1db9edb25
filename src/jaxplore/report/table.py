"""Summaries of several controllers as a table."""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from jaxplore.report.summary import Spread, Summary


class Column(NamedTuple):
    """One column.

    Args:
        header: its name and unit.
        cell: what stands in it.
        applies: whether there is anything to say of a controller's runs; a column of which there
            is not, for any controller, is left out. None: there always is.
    """

    header: str
    cell: Callable[[Summary], str]
    applies: Callable[[Summary], bool] | None = None


COLUMNS = (
    Column("finished", lambda each: f"{each.num_finished} of {each.num_runs}"),
    Column("after [s]", lambda each: _spread(each.finished_at, 1)),
    Column("90 % after [s]", lambda each: _spread(each.time_to_90, 1)),
    Column("coverage [%]", lambda each: _spread(_percent(each.coverage), 1)),
    Column("path [m]", lambda each: _spread(each.path_length, 1)),
    Column("nat/m", lambda each: _spread(each.information_per_metre, 1)),
    Column("unknown [%]", lambda each: _spread(_percent(each.final_unknown), 1)),
    Column(
        "targets",
        lambda each: f"{_spread(each.targets_seen, 1)} of {each.num_targets}",
        lambda each: each.num_targets > 0,
    ),
    Column(
        "idle mean [s]",
        lambda each: _spread(each.mean_idleness, 1),
        lambda each: math.isfinite(each.mean_idleness[0]),
    ),
    Column(
        "idle worst [s]",
        lambda each: _spread(each.worst_idleness, 1),
        lambda each: math.isfinite(each.worst_idleness[0]),
    ),
    Column("collisions", lambda each: str(each.collisions)),
    Column(
        "untraversable [steps]",
        lambda each: str(each.untraversable_steps),
        lambda each: each.untraversable_steps > 0,
    ),
    Column("clearance [m]", lambda each: _number(each.minimum_clearance, 2)),
    Column("jerk [1/s²]", lambda each: _spread(each.command_jerk, 0)),
    Column("step [ms]", lambda each: _spread(each.step_ms, 1)),
)


def table_rows(summaries: Mapping[str, Summary]) -> list[tuple[str, ...]]:
    """Return a header, then one row for each controller; median [quartiles].

    Args:
        summaries: by controller.
    """
    columns = [
        column
        for column in COLUMNS
        if column.applies is None or any(map(column.applies, summaries.values()))
    ]
    rows: list[tuple[str, ...]] = [("", *(column.header for column in columns))]
    rows += [(name, *(column.cell(each) for column in columns)) for name, each in summaries.items()]
    return rows


def markdown(rows: list[tuple[str, ...]]) -> str:
    """Return a table, header first, in Markdown."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]

    def line(cells: tuple[str, ...]) -> str:
        padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=True)]
        return f"| {' | '.join(padded)} |"

    rule = line(tuple("-" * width for width in widths))
    return "\n".join([line(rows[0]), rule, *(line(row) for row in rows[1:])])


def _spread(values: tuple[float, ...], digits: int) -> str:
    low, median, high = (_number(value, digits) for value in values)
    return median if low == high else f"{median} [{low}, {high}]"


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else "-"


def _percent(shares: Spread) -> Spread:
    low, median, high = (100.0 * share for share in shares)
    return low, median, high
