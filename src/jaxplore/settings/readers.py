"""Which runs read a setting, as its declaration says.

A section class whose settings are for some runs only says so by its `readers`, and a setting for
fewer of them in its annotation:

    class PortfolioSettings(Section):
        readers = architectures("portfolio")
        decomposition: Literal["roles", "temporal"] = setting(ground_portfolio, "decomposition")
        roles: Annotated[Roles | None, FUSED_BY_CONTEXT] = setting(Contextual, "roles")

The settings of an optional section are read where the section is present. A run reads a setting if
all sections around it and the setting itself say so. `tests/tasks/test_reference.py` builds runs,
and compares what was read with what the declarations say.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from jaxplore._text import short_repr
from jaxplore.settings.accepted_values import choices


@dataclasses.dataclass(frozen=True)
class Readers:
    """Runs that read a setting: in words, by a function of their settings, by the one setting that
    tells them apart, and by the models of robots, if it is these that do."""

    text: str
    reads: Callable[[Any], bool]
    by: str | None = None
    models: tuple[str, ...] = ()

    def narrow(self, text: str, reads: Callable[[Any], bool]) -> "Readers":
        """Return those of these runs that fulfil a further condition."""
        return Readers(f"{self.text} with {text}", lambda given: self.reads(given) and reads(given))


EVERY = Readers("every run", lambda _: True)
NONE = Readers("no run", lambda _: False)


def architectures(*names: str, text: str | None = None) -> Readers:
    """Return the runs with one of these architectures."""
    return Readers(
        text or ", ".join(names), lambda settings: settings.architecture in names, "architecture"
    )


def models(*names: str) -> Readers:
    """Return the runs of a robot of one of these models."""
    word = "model" if len(names) == 1 else "models"
    text = f"{word} {', '.join(names)}"
    return Readers(text, lambda settings: settings.robot.model in names, "robot.model", names)


def find_readers(root: type[BaseModel], name: str) -> Readers:
    """Return the runs that read a setting, by its dotted name, among those of a kind."""
    said = [each for each in _declared(root, name, "") if each is not EVERY]
    if not said:
        return EVERY
    # The innermost one is the narrowest.
    return Readers(
        said[-1].text, lambda settings: all(e.reads(settings) for e in said), said[-1].by
    )


def _declared(section: type[BaseModel], name: str, prefix: str) -> Iterator[Readers]:
    first, _, rest = name.partition(".")
    field = section.model_fields[first]
    yield _own(section, field)
    if rest:
        path = prefix + first
        if type(None) in get_args(field.annotation):
            yield Readers(f"runs with {path}", lambda settings: _at(settings, path) is not None)
        inner = section_class(field.annotation)
        assert inner is not None
        yield from _declared(inner, rest, f"{path}.")


def _own(section: type[BaseModel], field: FieldInfo) -> Readers:
    said = [each for each in field.metadata if isinstance(each, Readers)]
    found: Readers = said[0] if said else getattr(section, "readers", EVERY)
    if not found.models:
        return found
    # A kind of task may accept some of the models only.
    known = [name for name in found.models if name in choices(section, "model")]
    return models(*known) if known else NONE


def section_class(annotation: Any) -> type[BaseModel] | None:
    """Return the section class of a field, optional ones included; None for other fields."""
    for each in (annotation, *get_args(annotation)):
        if isinstance(each, type) and issubclass(each, BaseModel):
            return each
    return None


def _at(settings: Any, name: str) -> Any:
    """Return a setting by its dotted name; None within a section that is absent."""
    for part in name.split("."):
        settings = getattr(settings, part, None)
    return settings


def leaves(section: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Yield the dotted names of all settings of a section and of the sections within."""
    for name, field in section.model_fields.items():
        inner = section_class(field.annotation)
        if inner is None:
            yield prefix + name
        else:
            yield from leaves(inner, f"{prefix}{name}.")


def given_leaves(
    section: type[BaseModel], entries: Mapping[str, Any], prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    """Yield the dotted names and the values of the settings that checked entries give."""
    for name, value in entries.items():
        inner = section_class(section.model_fields[name].annotation)
        if inner is None:
            yield prefix + name, value
        elif isinstance(value, Mapping):
            yield from given_leaves(inner, value, f"{prefix}{name}.")


def list_unread(settings: BaseModel, entries: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that entries give and their run does not read, by dotted name.

    None, which stands for none, is no value.
    """
    return {
        name: value
        for name, value in given_leaves(type(settings), entries)
        if value is not None and not find_readers(type(settings), name).reads(settings)
    }


def read_values(settings: BaseModel, mode: str = "json") -> dict[str, Any]:
    """Return the settings that a run reads as entries of a settings file."""
    entries = settings.model_dump(mode=mode)
    for name in leaves(type(settings)):
        if not find_readers(type(settings), name).reads(settings):
            remove(entries, name)
    return entries


def remove(entries: dict[str, Any], name: str) -> None:
    """Remove a setting by its dotted name, and a section of which nothing is left."""
    first, _, rest = name.partition(".")
    inner = entries.get(first)
    if rest and isinstance(inner, Mapping):
        kept = dict(inner)
        remove(kept, rest)
        entries[first] = kept
        if not kept:
            del entries[first]
    elif not rest:
        entries.pop(first, None)


def refuse(settings: BaseModel, unread: Mapping[str, Any]) -> None:
    """Raise a `ValueError` that names the first setting that no run reads, and who does."""
    if not unread:
        return
    name, value = next(iter(unread.items()))
    readers = find_readers(type(settings), name)
    run = "this run" if readers.by is None else f"{readers.by} {_at(settings, readers.by)}"
    # A file of a former version has all settings: how many are too many tells that it is one.
    others = f", like {len(unread) - 1} others" if len(unread) > 1 else ""
    accepted = "without it" if readers.text == NONE.text else f"for {readers.text}"
    raise ValueError(
        f"setting {name} is {short_repr(value)}, which {run} does not read{others}; accepted: "
        f"{accepted}"
    )
