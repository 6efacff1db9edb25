"""The registry of kinds of tasks. Nothing else lists them."""

import copy
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from jaxplore._files import yaml_beside
from jaxplore._spelling import match_spelling
from jaxplore._text import printable_path, short_repr
from jaxplore.report.recording import Recording
from jaxplore.settings.readers import given_leaves, list_unread, refuse, remove, section_class
from jaxplore.settings.sections import RunSettings, find_field
from jaxplore.simulation.experiment import Experiment
from jaxplore.tasks.exploration.kind import EXPLORATION
from jaxplore.tasks.kind import Entries, Kind, OnMaps, Shown
from jaxplore.tasks.path.kind import PATH_FOLLOWING
from jaxplore.tasks.volume.kind import EXPLORATION_OF_VOLUME

KINDS: dict[str, Kind] = {
    each.name: each
    for each in (
        EXPLORATION,
        PATH_FOLLOWING,
        EXPLORATION_OF_VOLUME,
    )
}
"""Kinds of tasks by name, a row each. Entries that select none are of the first."""


def default_kind() -> Kind:
    """Return the kind of entries that select none."""
    return next(iter(KINDS.values()))


def find_kind(entries: Entries) -> Kind:
    """Return the kind of task that entries describe; see `make_settings`."""
    entries = _with_selector(entries)
    named = [kind for kind in KINDS.values() if kind.selector in entries]
    if len(named) > 1:
        given = " beside ".join(f"the {kind.selector} {entries[kind.selector]!r}" for kind in named)
        raise ValueError(f"settings have {given}; accepted: one of them")
    return named[0] if named else default_kind()


def kind_of(settings: RunSettings) -> Kind:
    """Return the kind of task of checked settings."""
    return next(kind for kind in KINDS.values() if kind.settings is type(settings))


def files_of(selector: str) -> OnMaps:
    """Return how the files of the kind that a setting selects are read, sent and compared."""
    found = next(each.on_maps for each in KINDS.values() if each.selector == selector)
    if found is None:
        known = ", ".join(each.selector for each in KINDS.values() if each.on_maps)
        raise ValueError(f"runs of {selector} are not compared on maps; accepted: {known}")
    return found


def make_settings(entries: dict[str, Any]) -> RunSettings:
    """Check entries, and return settings of the kind of task that they describe: those with a
    `path`, or with the map `path`, path following, those with a `volume` the exploration of one,
    and all others that of a plane."""
    entries = _with_selector(entries)
    settings = _check(find_kind(entries), entries)
    refuse(settings, list_unread(settings, entries))
    return settings


def _check(kind: Kind, entries: Entries) -> RunSettings:
    """Check entries against a kind of task; a setting of another kind is told with that kind."""
    for name, value in _list_unknown(kind.settings, entries):
        having = [each.name for each in KINDS.values() if find_field(each.settings, name)]
        if having:
            raise ValueError(
                f"setting {name} is {short_repr(value)}, which runs of {kind.name} do not read; "
                f"accepted: in runs of {', '.join(having)}"
            )
    return kind.make_settings(dict(entries))


def _list_unknown(
    section: type[BaseModel], entries: Entries, prefix: str = ""
) -> Iterator[tuple[str, Any]]:
    """Yield the dotted names and the values of entries that a section does not have."""
    for name, value in entries.items():
        field = section.model_fields.get(name)
        inner = None if field is None else section_class(field.annotation)
        if field is None:
            yield f"{prefix}{name}", value
        elif inner is not None and isinstance(value, Mapping):
            yield from _list_unknown(inner, value, f"{prefix}{name}.")


def keep_read[Name](runs: Mapping[Name, Entries]) -> dict[Name, dict[str, Any]]:
    """Return entries of runs that are compared, each without the settings that it does not read.

    A setting that none of the runs that have it reads raises a `ValueError`.
    """
    given = {name: _with_selector(entries) for name, entries in runs.items()}
    checked = {name: _check(find_kind(each), each) for name, each in given.items()}
    unread = {name: list_unread(each, given[name]) for name, each in checked.items()}
    read = {
        key
        for name, each in checked.items()
        for key, _ in given_leaves(type(each), given[name])
        if key not in unread[name]
    }
    for name, entries in given.items():
        nobody = {key: value for key, value in unread[name].items() if key not in read}
        refuse(checked[name], nobody)
        for key in unread[name]:
            remove(entries, key)
    return given


def without_unread(entries: Entries) -> dict[str, Any]:
    """Return entries without the settings that their run does not read."""
    kept = _with_selector(entries)
    settings = find_kind(kept).make_settings(kept)
    for name in list_unread(settings, kept):
        remove(kept, name)
    return kept


def build(settings: RunSettings) -> Experiment:
    """Build the experiment that settings describe."""
    return kind_of(settings).build(settings)


def how_shown(recording: Recording) -> Shown:
    """Return how a recording is shown: as its kind says, or by the pictures of its animation."""
    for kind in KINDS.values():
        for shown in kind.shown:
            if isinstance(recording, shown.recording):
                return shown
    return Shown(type(recording))


def places() -> dict[str, Entries]:
    """Return the names that stand for whole runs, and the entries of each."""
    return {name: entries for kind in KINDS.values() for name, entries in kind.places.items()}


def words() -> dict[str, Entries]:
    """Return the names that stand for a kind or a part of it, and their default entries.

    They are copies: the options of a command change entries where they are.
    """
    known = {name: entries for kind in KINDS.values() for name, entries in kind.words.items()}
    return copy.deepcopy(known)


def place_entries(name: str, *, is_trusted: bool = False) -> dict[str, Any]:
    """Return the entries of a run at a place, given by its name or its file.

    A file that names code must be trusted.
    """
    known = places()
    name = match_spelling(name, tuple(known))
    if name in known:
        return dict(known[name])
    file = Path(name)
    _check_file(file)
    suffix = file.suffix.lower()
    kind = next((each for each in KINDS.values() if suffix in each.suffixes), default_kind())
    return kind.read_entries(name, is_trusted=is_trusted)


def at_place(entries: Entries, name: str, *, is_trusted: bool = False) -> dict[str, Any]:
    """Return the entries of a settings file for a place that the user names; see `place_entries`.

    They override those of a scenario, but not the place. A word stands for what they name, or for
    its default.
    """
    known = words()
    if name in known:
        return {**known[name], **entries}
    named = place_entries(name, is_trusted=is_trusted)
    selector = find_kind(named).selector
    return {**named, **entries, selector: named[selector]}


def folder_name(entries: Entries) -> str:
    """Return a name for folders from the place of a run.

    A file that is just called `map` is named by its folder, as in a comparison on maps.
    """
    kind = find_kind(entries)
    place = entries.get(kind.selector)
    words = [name for name, given in kind.places.items() if given == {kind.selector: place}]
    file = Path(str(place))
    name = file.parent.name if file.stem == "map" and file.parent.name else file.stem
    # A word that is also a section, such as `fleet`, is a part of the name.
    parts = [word for word in kind.words if entries.get(word) is not None and word != kind.selector]
    return "-".join([*words[:1], *parts] if words else [name, *parts])


def _with_selector(entries: Entries) -> dict[str, Any]:
    """Replace the name of a place of another kind under `map`, such as `path` or `forest`."""
    first, name = default_kind(), entries.get(default_kind().selector)
    # Beside a `world`, `map` is a free name and selects nothing.
    if not isinstance(name, str) or entries.get("world") is not None:
        return dict(entries)
    rest = {each: value for each, value in entries.items() if each != first.selector}
    for kind in KINDS.values():
        named = {**kind.words, **kind.places}.get(name)
        if kind is not first and named is not None:
            return {**named, **rest}
    return dict(entries)


def _check_file(path: Path) -> None:
    """Raise a `ValueError` that names what there is, if a place is not a file."""
    files = ", ".join(kind.files for kind in KINDS.values() if kind.files)
    names = dict.fromkeys((*places(), *words()))
    accepted = f"{files}, or {', '.join(names)}"
    if path.is_dir():
        inside = sorted(path.glob("*.yaml"))
        example = f", such as {printable_path(inside[0])}" if inside else ""
        raise ValueError(f"{printable_path(path)} is a folder; accepted: a file{example}")
    if not path.exists():
        raise ValueError(f"{printable_path(path)} is not there; accepted: {accepted}")
    endings = [suffix for kind in KINDS.values() for suffix in kind.suffixes]
    if path.suffix and path.suffix.lower() not in endings:
        beside = yaml_beside(path)
        named = "" if beside is None else f"{printable_path(beside)}, which is beside it, or "
        raise ValueError(
            f"{printable_path(path)} is of another kind; accepted: {named}a file that ends with "
            f"{', '.join(endings)}"
        )
