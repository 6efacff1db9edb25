"""`jaxplore settings`: prints defaults as YAML, or what is known of a setting or a section."""

import textwrap

import click

from jaxplore.parameters import nearest
from jaxplore.report.table import print_table
from jaxplore.settings.commented import commented_yaml
from jaxplore.settings.exploration import OFFICE
from jaxplore.settings.reference import (
    PLACES,
    TASKS,
    Row,
    find_rows,
    place_settings,
    plain,
    section_names,
    sections,
    setting_names,
)

_WORDS = {"exploration": "exploration", "path": "along a path"}
"""Kinds of tasks in the titles of tables."""
_MOST_SHOWN = 60
"""Length to which an unknown name is cut in a message."""


def known_names() -> tuple[str, ...]:
    """Return all names that `show_settings` accepts, each once."""
    return tuple(dict.fromkeys((*PLACES, *section_names(), *setting_names())))


def show_settings(name: str | None) -> None:
    """Print defaults as YAML, or a table of a setting or a section.

    Args:
        name: a scenario, `path`, a section or a dotted setting; all settings when absent.

    Raises:
        ValueError: an unknown name; the message has the nearest ones.
    """
    if name is None or name in PLACES:
        click.echo(commented_yaml(place_settings(name or OFFICE)), nl=False)
        return
    found = find_rows(name)
    if not found:
        # A message is short, however long the name is.
        shown = name if len(name) <= _MOST_SHOWN else name[:_MOST_SHOWN] + "..."
        raise ValueError(
            f"setting {shown!r} is not known; accepted: such as {nearest(shown, known_names())}"
        )
    for task in TASKS:
        rows = [row for row in found if row.task == task]
        if rows and rows[0].name == name:
            print_table(_of_setting(rows[0]), title=f"{name} ({_WORDS[task]})", has_header=False)
        elif rows:
            meaning = sections()[task, name].removesuffix(".")
            print_table(
                _of_section(rows), title=f"{name} ({_WORDS[task]}): {meaning}", has_lines=True
            )


def _of_setting(row: Row) -> list[tuple[str, str]]:
    lines = [
        ("meaning", _wrapped(row.short_meaning, 72)),
        ("unit", row.unit or "-"),
        ("default", default_text(row)),
        ("accepted", _wrapped(row.accepted, 72)),
        ("read by", _wrapped(row.read_by, 72)),
        *(("note", _wrapped(note, 72)) for note in row.notes),
    ]
    if row.owner is not None:
        lines.append(("owner", row.owner))
    return lines


def _of_section(rows: list[Row]) -> list[tuple[str, ...]]:
    table: list[tuple[str, ...]] = [
        ("setting", "meaning", "unit", "default", "accepted", "read by")
    ]
    for row in rows:
        texts = (row.short_meaning, *row.notes)
        table.append(
            (
                row.name.rpartition(".")[2],
                "\n".join(_wrapped(text, 44) for text in texts),
                row.unit or "-",
                default_text(row),
                _wrapped(row.accepted, 20),
                _wrapped(row.read_by, 20),
            )
        )
    return table


def default_text(row: Row) -> str:
    """Return the default of a setting in words; some settings must be given."""
    return "must be given" if row.is_required else plain(row.default)


def _wrapped(text: str, width: int) -> str:
    return textwrap.fill(text, width, break_long_words=False, break_on_hyphens=False)
