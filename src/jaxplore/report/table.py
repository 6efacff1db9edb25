"""Tables as text."""


def markdown(rows: list[tuple[str, ...]]) -> str:
    """Return a table, header first, in Markdown."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]

    def line(cells: tuple[str, ...]) -> str:
        padded = [cell.ljust(width) for cell, width in zip(cells, widths, strict=True)]
        return f"| {' | '.join(padded)} |"

    rule = line(tuple("-" * width for width in widths))
    return "\n".join([line(rows[0]), rule, *(line(row) for row in rows[1:])])
