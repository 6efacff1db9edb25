"""`jaxplore settings`: prints defaults as YAML, or what is known of a setting or a section."""

from jaxplore.cli._known import load_known
from jaxplore.cli._terminal import say
from jaxplore.parameters import nearest
from jaxplore.report.table import print_table
from jaxplore.tasks.commented_yaml import to_commented_yaml
from jaxplore.tasks.exploration.settings import OFFICE
from jaxplore.tasks.reference import (
    Row,
    classes,
    find_rows,
    place_settings,
    plain,
    sections,
)
from jaxplore.tasks.registry import KINDS, places

_WIDEST = 80
"""Greatest width of a column, for the meanings of settings."""
_MOST_SHOWN = 60
"""Length to which an unknown name is cut in a message."""


def show_settings(name: str | None) -> None:
    """Print defaults as YAML, or a table of a setting or a section.

    The name is a scenario, `path`, a section or a dotted setting; without one all settings are
    printed. The error for an unknown name has the nearest ones.
    """
    if name is None or name in places():
        say(to_commented_yaml(place_settings(name or OFFICE)), nl=False)
        return
    found = find_rows(name)
    if not found:
        # A message is short, however long the name is.
        shown = name if len(name) <= _MOST_SHOWN else name[:_MOST_SHOWN] + "..."
        raise ValueError(
            f"setting {shown!r} is not known; accepted: such as "
            f"{nearest(shown, load_known().names)}"
        )
    for task in classes():
        place = KINDS[task].place if task in KINDS else "jaxplore node"
        rows = [row for row in found if row.task == task]
        if rows and rows[0].name == name:
            title = f"{name} ({place})"
            print_table(_of_setting(rows[0]), title=title, has_header=False, widest=_WIDEST)
        elif rows:
            title = f"{name} ({place}): {sections()[task, name].removesuffix('.')}"
            print_table(_of_section(rows), title=title, has_lines=True, widest=_WIDEST)


def _of_setting(row: Row) -> list[tuple[str, str]]:
    lines = [
        ("meaning", row.short_meaning),
        ("unit", row.unit or "-"),
        ("default", default_text(row)),
        ("accepted", row.accepted),
        ("read by", row.read_by),
        *(("note", note) for note in row.notes),
    ]
    if row.owner is not None:
        lines.append(("owner", row.owner))
    return lines


def _of_section(rows: list[Row]) -> list[tuple[str, ...]]:
    # Three columns fit on a terminal of 80 characters, where each of the texts has room.
    table: list[tuple[str, ...]] = [("setting", "default [unit]", "meaning")]
    for row in rows:
        unit = "" if row.unit is None else f" [{row.unit}]"
        limits = f"Accepted: {row.accepted}. Read by: {row.read_by}."
        text = "\n".join((row.short_meaning, limits, *row.notes))
        table.append((row.name.rpartition(".")[2], default_text(row) + unit, text))
    return table


def default_text(row: Row) -> str:
    """Return the default of a setting in words; some settings must be given."""
    return "must be given" if row.is_required else plain(row.default)
