"""Tables of what was measured."""

from typing import Any

from rich.table import Table


def table(title: str, rows: list[dict[str, Any]]) -> Table:
    """Return a table of rows that have the same keys."""
    made = Table(title=title)
    for name in rows[0]:
        made.add_column(name.replace("_", " "))
    for row in rows:
        made.add_row(*(_text(row.get(name)) for name in rows[0]))
    return made


def _text(value: object) -> str:
    if value is None:
        return "-"
    if not isinstance(value, float):
        return str(value)
    return f"{value:.2f}" if value == 0.0 or abs(value) >= 0.01 else f"{value:.1g}"
