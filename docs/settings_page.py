"""Write the page of settings, `settings.md`, and the names that the help of the command line shows:
`python docs/settings_page.py`."""

from pathlib import Path

import jaxplore
from jaxplore.tasks.reference import Row, plain, rows, sections, titles

PAGE = Path(__file__).parent / "settings.md"
KNOWN = Path(jaxplore.__file__).parent / "cli" / "known.json"
BEGINNING = """\
<!-- Written from the settings and their owners. To renew it: python docs/settings_page.py -->

# Settings

Every setting of a run, with its default. [First run](first_run.md#settings) says how to give one.
`jaxplore settings NAME` prints the row of a setting such as `robot.max_speed`, a section such as
`lidar`, or the defaults of a scenario such as `warehouse` as a settings file.

The owner of a setting is the function or class whose parameter it is. Meaning and default are the
owner's. Where the default is another one, the row says why. *Quadrotors* are the architectures
`two-layer`, `parallel`, `sequential`, `random-walk` and `goal`. The last column says which runs
read a setting. In brackets are the scenarios that do with their own defaults, unless all do.

The bounds of sizes are in the column *accepted*. All other numbers are at most 1e12 in size, and
what must be above 0 is at least 1e-12; see [Limits](limits.md).
"""


def page() -> str:
    """Return the page."""
    parts = [BEGINNING]
    for task, title in titles().items():
        parts.append(f"## {title}\n")
        of_task = [row for row in rows() if row.task == task]
        if any(not row.section for row in of_task):
            parts.append(_table([row for row in of_task if not row.section]))
        for name in dict.fromkeys(row.section for row in of_task if row.section):
            meaning = sections()[task, name]
            sentence = _ended(meaning[0].upper() + meaning[1:])
            parts.append(f"### {name} ({title.lower()})\n\n{_escaped(sentence)}\n")
            parts.append(_table([row for row in of_task if row.section == name]))
    return "\n".join(parts)


def _table(of_section: list[Row]) -> str:
    lines = [("setting", "meaning", "unit", "default", "accepted", "owner", "read by")]
    lines.append(("---",) * len(lines[0]))
    for row in of_section:
        default = "must be given" if row.is_required else f"`{plain(row.default)}`"
        lines.append(
            (
                f"`{row.name}`",
                " ".join(map(_escaped, (_ended(row.short_meaning), *row.notes))),
                row.unit or "",
                default,
                row.accepted,
                "" if row.owner is None else f"`{row.owner}`",
                row.read_by,
            )
        )
    # Not aligned: one long description would make every line as long.
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _ended(text: str) -> str:
    return text if text.endswith(".") else f"{text}."


def _escaped(text: str) -> str:
    """Escape what a table or Markdown takes for markup; `code` stays."""
    return text.replace("|", r"\|").replace("*", r"\*")


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    # The command line shows what the file says, and an old file may lack names.
    KNOWN.unlink(missing_ok=True)
    from jaxplore.cli import _known

    _known.FILE.write_text(_known.as_text(_known.from_settings()), encoding="utf-8")
