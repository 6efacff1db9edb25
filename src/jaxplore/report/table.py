"""Text tables, as Markdown, HTML or on a terminal."""

import html
from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from jaxplore._text import printable

Rows = Sequence[Sequence[str]]
"""Rows of a table, the header first. A cell may have several lines."""


def to_markdown(rows: Rows) -> str:
    """Format a table as Markdown, with aligned columns."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]

    def line(cells: Sequence[str]) -> str:
        padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=True)]
        return f"| {' | '.join(padded)} |"

    rule = line(["-" * width for width in widths])
    return "\n".join([line(rows[0]), rule, *(line(row) for row in rows[1:])])


def to_html(rows: Rows) -> str:
    """Format a table as HTML."""

    def line(cells: Sequence[str], kind: str) -> str:
        return "<tr>" + "".join(f"<{kind}>{html.escape(cell)}</{kind}>" for cell in cells) + "</tr>"

    header, *others = rows
    body = "".join(line(row, "td") for row in others)
    return f"<table>{line(header, 'th')}{body}</table>"


def print_table(
    rows: Rows,
    *,
    title: str | None = None,
    has_header: bool = True,
    has_lines: bool = False,
    widest: int | None = None,
) -> None:
    """Print a table on the terminal, with the header as the first row.

    In a file only columns wider than `widest` [characters] are wrapped; None sets no bound.
    `has_lines` draws lines between rows.
    """
    heading = None if title is None else _plain(title)
    table = Table(title=heading, show_lines=has_lines, show_header=has_header)
    header, others = (rows[0], rows[1:]) if has_header else ([""] * len(rows[0]), rows)
    for cell in header:
        # A name that is too long is continued on the next line, not cut off.
        table.add_column(_plain(cell), max_width=widest, overflow="fold")
    for row in others:
        table.add_row(*map(_plain, row))
    console = Console()
    if not console.is_terminal:
        # A file has no width to wrap at.
        console = Console(width=Console(width=1000).measure(table).maximum)
    console.print(table)


def _plain(cell: str) -> Text:
    # Square brackets are units and quartiles here, not Rich's markup.
    return Text(printable(cell))


def transpose(rows: Rows) -> list[tuple[str, ...]]:
    """Transpose a table."""
    return list(zip(*rows, strict=True))
