"""Settings as YAML with comments, which can be read again."""

import re
import textwrap
from collections.abc import Iterator

import yaml
from pydantic import BaseModel

from jaxplore.settings.sections import RunSettings, section_class
from jaxplore.tasks.reference import Row, rows, sections
from jaxplore.tasks.registry import kind_of

_WIDTH = 100
_INDENT = "  "
_BEGINNING = (
    "Settings for jaxplore run --settings FILE. A setting that is left out has its default. "
    "jaxplore settings NAME explains one."
)


def to_commented_yaml(settings: RunSettings) -> str:
    """Return settings as YAML, with the meaning and the accepted values above each of them.

    Args:
        settings: checked settings.
    """
    task = kind_of(settings).name
    known = {row.name: row for row in rows() if row.task == task}
    values = settings.model_dump(mode="json")
    lines = [*_comment(_BEGINNING), ""]
    for name, field in type(settings).model_fields.items():
        inner = section_class(field.annotation)
        if inner is None:
            lines += _setting(known[name], values[name], settings)
            continue
        of_section = [known[f"{name}.{each}"] for each in inner.model_fields]
        is_read = any(row.reader.reads(settings) for row in of_section)
        text = _sentence(sections()[task, name])
        lines += ["", *_comment(text if is_read else f"{text} This run does not read it.")]
        if not isinstance(getattr(settings, name), BaseModel):
            lines += [*_comment(f"Its settings: jaxplore settings {name}."), f"{name}: null"]
            continue
        lines.append(f"{name}:")
        for row in of_section:
            last = row.name.rpartition(".")[2]
            # That nothing of the section is read has been said above.
            for line in _setting(row, values[name][last], settings if is_read else None):
                lines.append(_INDENT + line if line else line)
    return "\n".join(lines) + "\n"


def _setting(row: Row, value: object, settings: RunSettings | None) -> Iterator[str]:
    """Yield the lines of a setting; it is said if the given settings do not read it."""
    text = f"{_sentence(row.meaning)} Accepted: {row.accepted}."
    if settings is not None and not row.reader.reads(settings):
        text += f" Only read by: {row.reader.text}."
    yield from _comment(text)
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
