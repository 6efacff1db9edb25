"""The reference of settings: a row for each, made from the settings and their owners.

`jaxplore settings`, the page of the documentation and the completions of shells are made from
these rows.
"""

import functools
from collections.abc import Iterator
from typing import Any, NamedTuple

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from jaxplore.settings.accepted_values import choices, describe_accepted
from jaxplore.settings.architectures import QUADROTOR
from jaxplore.settings.defaults import DIFFERENCES, description_in, descriptions, unit
from jaxplore.settings.node import DriveSettings
from jaxplore.settings.parameter_names import PER_METRE, controller_parameter
from jaxplore.settings.readers import EVERY, NONE, Readers, find_readers
from jaxplore.settings.sections import RunSettings, section_class
from jaxplore.tasks.registry import KINDS, make_settings, places

DRIVE = "drive"
"""Name of the settings of a drive, beside those of the kinds of tasks."""
_DEGREES = "_degrees"
"""End of the name of a setting in degrees. Owners take radians."""
_UNNAMED = ("map", "world", "volume")
"""Settings that say what a scenario is, and are no values of its own."""


def classes() -> dict[str, type[BaseModel]]:
    """Return the class of the settings of each kind of task, and of those of a drive."""
    return {**{name: kind.settings for name, kind in KINDS.items()}, DRIVE: DriveSettings}


def titles() -> dict[str, str]:
    """Return the headings of the settings of each kind of task, and of those of a drive."""
    return {**{name: kind.title for name, kind in KINDS.items()}, DRIVE: "The node"}


class Row(NamedTuple):
    """What is known of a setting.

    Args:
        task: kind of task, `exploration`, `path` or `volume`, or `drive`.
        name: dotted name.
        meaning: description, from the docstring of the owner or of the section.
        unit: unit; none without one.
        default: default; None for a setting that must be given.
        is_required: whether the setting must be given.
        accepted: accepted values in words.
        choices: accepted words; none if something else is accepted.
        reader: runs that read the setting.
        scenarios: names of places whose runs read it, with the defaults of each.
        owner: function or class that has the setting as a parameter; none for a setting without.
        notes: other defaults and their reasons, and other names; a sentence each.
    """

    task: str
    name: str
    meaning: str
    unit: str | None
    default: Any
    is_required: bool
    accepted: str
    choices: tuple[str, ...]
    reader: Readers
    scenarios: tuple[str, ...]
    owner: str | None
    notes: tuple[str, ...]

    @property
    def section(self) -> str:
        """Name of the section; empty for a setting in none."""
        return self.name.rpartition(".")[0]

    @property
    def short_meaning(self) -> str:
        """Meaning without its unit, for a table that has a column of units."""
        return self.meaning if self.unit is None else self.meaning.replace(f" [{self.unit}]", "", 1)

    @property
    def read_by(self) -> str:
        """Runs that read the setting, and the names of places that do unless all of them do."""
        if self.reader.text in (EVERY.text, NONE.text) or self.scenarios == _places(self.task):
            return self.reader.text
        return f"{self.reader.text} ({', '.join(self.scenarios) or 'not by default'})"


@functools.cache
def rows() -> tuple[Row, ...]:
    """Return the rows of all settings, those of exploration first, in the order of the settings."""
    return tuple(row for task, kind in classes().items() for row in _rows(task, kind))


@functools.cache
def sections() -> dict[tuple[str, str], str]:
    """Return the meaning of each section by the kind of task and its name."""
    return {
        (task, name): meaning
        for task, kind in classes().items()
        for name, meaning in _sections(kind)
    }


def find_rows(name: str) -> tuple[Row, ...]:
    """Return the row of a setting, or the rows of a section, of all kinds of task that have it."""
    return tuple(row for row in rows() if name in (row.name, row.section) and name)


def setting_names() -> tuple[str, ...]:
    """Return the dotted names of all settings, each once."""
    return tuple(dict.fromkeys(row.name for row in rows()))


def section_names() -> tuple[str, ...]:
    """Return the names of all sections, each once."""
    return tuple(dict.fromkeys(name for _, name in sections()))


@functools.cache
def place_settings(place: str) -> RunSettings:
    """Return the default settings of one of the `places` of the registry."""
    return make_settings(dict(places()[place]))


def own_descriptions(section: type[BaseModel]) -> dict[str, str]:
    """Return the descriptions in the docstrings of a section and its bases, by setting."""
    found: dict[str, str] = {}
    for each in reversed(section.__mro__):
        # A class without a docstring would show that of its base a second time.
        if issubclass(each, BaseModel) and each.__doc__:
            found |= descriptions(each)
    return found


def setting_meaning(section: type[BaseModel], name: str) -> str:
    """Return the description of a setting: that of its owner's parameter, or of the section."""
    own = section.model_fields[name].description
    return own or description_in(own_descriptions(section), name)


def _places(task: str) -> tuple[str, ...]:
    """Return the names of places with runs of this kind of task."""
    return tuple(KINDS[task].places) if task in KINDS else ()


def _sections(section: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the names and the meanings of the sections within one, outer ones first."""
    for name, field in section.model_fields.items():
        inner = section_class(field.annotation)
        if inner is not None:
            yield prefix + name, setting_meaning(section, name)
            yield from _sections(inner, f"{prefix}{name}.")


def _rows(task: str, section: type[BaseModel], prefix: str = "") -> Iterator[Row]:
    for name, field in section.model_fields.items():
        inner = section_class(field.annotation)
        if inner is None:
            yield _row(task, section, prefix + name, field)
        else:
            yield from _rows(task, inner, f"{prefix}{name}.")


def _row(task: str, section: type[BaseModel], name: str, field: FieldInfo) -> Row:
    last = name.rpartition(".")[2]
    source = field.json_schema_extra
    given: dict[str, Any] = source if isinstance(source, dict) else {}
    owner, meaning = given.get("owner"), setting_meaning(section, last)
    default = None if field.is_required() else field.get_default(call_default_factory=True)
    found = find_readers(classes()[task], name)
    is_in_degrees = last.endswith(_DEGREES)
    if is_in_degrees and owner is not None:
        meaning += f" In degrees; `{owner}` takes radians."
    return Row(
        task=task,
        name=name,
        meaning=meaning,
        unit="degrees" if is_in_degrees else unit(meaning),
        default=default,
        is_required=field.is_required(),
        accepted=describe_accepted(section, last),
        choices=choices(section, last),
        reader=found,
        scenarios=tuple(each for each in _places(task) if found.reads(place_settings(each))),
        owner=owner,
        notes=(
            *_other_defaults(task, name, default, given),
            *_other_names(last, given),
        ),
    )


def _other_defaults(task: str, name: str, default: Any, given: dict[str, Any]) -> Iterator[str]:
    """Yield the defaults of the owner, of quadrotors, cars and scenarios where they differ."""
    if f"{task}.{name}" in DIFFERENCES:
        reason = DIFFERENCES[f"{task}.{name}"].reason
        yield f"`{given['owner']}` has {plain(given['own'])}; here: {reason}."
    flying = DIFFERENCES.get(f"quadrotor.{name}") if task == "exploration" else None
    if flying is not None:
        yield f"Quadrotors: {plain(flying.value)}, {flying.reason}."
    for kind, words in (("car", "Cars"), ("bicycle", "A bicycle")):
        driving = DIFFERENCES.get(f"{kind}.{name}") if task == "exploration" else None
        if driving is not None:
            yield f"{words}: {plain(driving.value)}, {driving.reason}."
    own = []
    for place in () if name in _UNNAMED else _places(task):
        settings = place_settings(place)
        is_flying = getattr(settings, "architecture", None) in QUADROTOR
        expected = flying.value if flying is not None and is_flying else default
        value = _value(settings, name, expected)
        if value != expected:
            own.append(f"{place}: {plain(value)}")
    if own:
        yield "; ".join(own) + "."


def _other_names(name: str, given: dict[str, Any]) -> Iterator[str]:
    """Yield the name of the parameter of the owner and the path of the controller's parameter."""
    if given and given["parameter"] != name:
        yield f"Parameter `{given['parameter']}` of `{given['owner']}`."
    path = controller_parameter(given.get("owner"), name)
    if path is not None:
        scale = ", to its value times `dt`" if name == PER_METRE else ""
        yield f"Sets the controller parameter `{path}`{scale}."


def _value(settings: RunSettings, name: str, otherwise: Any) -> Any:
    """Return a setting by its dotted name; something else if its section is absent."""
    value: Any = settings
    for part in name.split("."):
        if value is None:
            return otherwise
        value = getattr(value, part)
    return value


def plain(value: Any) -> str:
    """Return a value as settings files have it."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(plain, value))}]"
    return str(value)
