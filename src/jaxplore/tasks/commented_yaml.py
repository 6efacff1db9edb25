"""Settings as YAML with comments, which can be read again."""

import re
import textwrap
from collections.abc import Iterator

import yaml

from jaxplore.settings.readers import read_values
from jaxplore.settings.sections import RunSettings
from jaxplore.tasks.reference import Row, rows, sections
from jaxplore.tasks.registry import kind_of

_WIDTH = 100
_INDENT = "  "
_BEGINNING = (
    "Settings for jaxplore run --settings FILE: those that this run reads. One that is left out "
    "has its default. jaxplore settings NAME explains one."
)


def to_commented_yaml(settings: RunSettings) -> str:
    """Return the settings that a run reads as YAML, with the meaning of each above it."""
    task = kind_of(settings).name
    known = {row.name: row for row in rows() if row.task == task}
    values = read_values(settings)
    lines = [*_comment(_BEGINNING), ""]
    for name, value in values.items():
        if (task, name) not in sections():
            lines += _setting(known[name], value)
            continue
        lines += ["", *_comment(_sentence(sections()[task, name]))]
        if value is None:
            lines += [*_comment(f"Its settings: jaxplore settings {name}."), f"{name}: null"]
            continue
        lines.append(f"{name}:")
        for last, inner in value.items():
            for line in _setting(known[f"{name}.{last}"], inner):
                lines.append(_INDENT + line if line else line)
    return "\n".join(lines) + "\n"


def _setting(row: Row, value: object) -> Iterator[str]:
    yield from _comment(f"{_sentence(row.meaning)} Accepted: {row.accepted}.")
    # Innermost lists stand in one line, and a single value without braces.
    style = None if isinstance(value, list | dict) and value else False
    dumped = yaml.safe_dump(
        {row.name.rpartition(".")[2]: value},
        sort_keys=False,
        default_flow_style=style,
        width=_WIDTH,
        allow_unicode=True,
    )
    yield from dumped.splitlines()


def _comment(text: str) -> list[str]:
    # A bound stays together with its sign: the wrapping does not break at such a space.
    lines = textwrap.wrap(
        re.sub("([<>]=?) ", "\\1\N{NO-BREAK SPACE}", text),
        _WIDTH - len(_INDENT),
        initial_indent="# ",
        subsequent_indent="# ",
        break_on_hyphens=False,
    )
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def _sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text}."
