"""Tables of what was measured."""

from collections.abc import Sequence
from typing import Any

from rich.table import Table

Rows = list[dict[str, Any]]


def table(title: str, rows: Rows) -> Table:
    """Return a table of rows that have the same keys."""
    made = Table(title=title)
    names = _columns(rows)
    for name in names:
        made.add_column(name.replace("_", " "))
    for row in rows:
        made.add_row(*(_text(row.get(name)) for name in names))
    return made


def markdown(rows: Rows, columns: Sequence[str] = ()) -> str:
    """Return a table in Markdown.

    Args:
        rows: rows that have the same keys.
        columns: names of the columns that it has; all when empty.
    """
    names = columns or _columns(rows)
    lines = [[name.replace("_", " ") for name in names], ["---"] * len(names)]
    lines += [[_text(row.get(name)) for name in names] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |".replace("|  |", "| |") for line in lines)


def _columns(rows: Rows) -> list[str]:
    # The repetitions are for comparisons.
    return [name for name in rows[0] if name != "repeats"]


def _text(value: object) -> str:
    if value is None:
        return "-"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.2f}" if value == 0.0 or abs(value) >= 0.01 else f"{value:.1g}"
