"""Conversion of options to settings entries."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxplore._files import parse_yaml
from jaxplore._text import short_repr
from jaxplore.settings.node import part_node
from jaxplore.settings.readers import find_readers
from jaxplore.settings.sections import find_field, read_settings
from jaxplore.tasks.exploration.settings import merge_entries
from jaxplore.tasks.path.settings import PATH
from jaxplore.tasks.registry import KINDS, at_place, find_kind, words

SAMPLES = "controller__num_samples"
"""Option of the number of rollouts, of every architecture."""
_SAMPLES = "num_samples"


def option_entries(
    options: Mapping[str, Any], place: Mapping[str, Any] | None = None, word: str | None = None
) -> dict[str, Any]:
    """Convert values of the options of `with_options` and `path_options` to settings entries.

    `place` are the entries of one of several maps, where the options name none, and `word` the word
    that was given beside them.
    """
    given = dict(options)
    settings_file, assignments = given.pop("settings_file"), given.pop("assignments")
    trust = given.pop("trust", False)
    # The section of the node, in a file that a drive reads too, is checked and not read.
    file = {} if settings_file is None else read_settings(settings_file, is_trusted=trust)
    entries, _ = part_node(file)
    entries = _with_place(entries, given.pop("map_"), given.pop("path_file", None), trust)
    if place is not None:
        named = {} if word is None else words()[word]
        selectors = {kind.selector for kind in KINDS.values()}
        entries = {**named, **entries}
        entries = {name: value for name, value in entries.items() if name not in selectors}
        entries |= place
    kind = find_kind(entries)
    samples = given.pop(SAMPLES, None)
    for option, value in given.items():
        if value is None:
            continue
        name = option.replace("__", ".")
        if find_field(kind.settings, name) is None:
            known = [each.place for each in KINDS.values() if find_field(each.settings, name)]
            raise ValueError(f"{name} is {value} {kind.place}; accepted: {' or '.join(known)}")
        assign(entries, name, value)
    assign_all(entries, assignments)
    return with_samples(entries, samples, assignments)


def with_samples(
    entries: dict[str, Any],
    samples: int | None,
    assignments: Sequence[str],
    variants: Iterable[Mapping[str, Any]] = ({},),
) -> dict[str, Any]:
    """Return entries with a number of rollouts, for the controllers of all variants.

    The option stands for the setting of whichever section a variant reads, unless the assignments
    of `--set` give it.
    """
    if samples is None:
        return entries
    sections = set[str]()
    for own in variants:
        run = merge_entries(entries, dict(own))
        kind = find_kind(run)
        if kind.selector not in run:
            # What several maps have in common names none: where it drives does not matter here.
            run = {**next(iter(kind.places.values())), **run}
        settings = kind.make_settings(run)
        sections |= {
            section
            for section in kind.settings.model_fields
            if find_field(kind.settings, f"{section}.{_SAMPLES}") is not None
            and find_readers(kind.settings, f"{section}.{_SAMPLES}").reads(settings)
        }
    for section in sorted(sections):
        assign(entries, f"{section}.{_SAMPLES}", samples)
    # `--set` comes last, so that it overrides all other options.
    assign_all(entries, assignments)
    return entries


def _with_place(
    entries: dict[str, Any], name: str | None, path: str | None, trust: bool
) -> dict[str, Any]:
    if path is not None and name not in (None, PATH):
        raise ValueError(f"--path is {path!r} beside the map {name!r}; accepted: one of them")
    if path is not None:
        return {**entries, PATH: str(Path(path).absolute())}
    return entries if name is None else at_place(entries, name, is_trusted=trust)


def assign(entries: dict[str, Any], name: str, value: Any) -> None:
    """Set one setting by its dotted name; sections that are missing are made."""
    *sections, last = name.split(".")
    for section in sections:
        inner = entries.setdefault(section, {})
        if not isinstance(inner, dict):
            raise ValueError(f"setting {section} is {short_repr(inner)}; accepted: a mapping")
        entries = inner
    entries[last] = value


def assign_all(entries: dict[str, Any], assignments: Sequence[str]) -> None:
    """Set the settings of the `--set` options, NAME=VALUE each, with values in YAML."""
    for assignment in assignments:
        name, separator, text = assignment.partition("=")
        if not separator:
            raise ValueError(f"--set is {short_repr(assignment)}; accepted: NAME=VALUE")
        try:
            value = parse_yaml(text)
        except ValueError as error:
            raise ValueError(
                f"--set is {short_repr(assignment)} ({error}); accepted: a value in YAML"
            ) from None
        assign(entries, name.strip(), value)
