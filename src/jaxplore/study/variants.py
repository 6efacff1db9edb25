"""Variants: settings that differ, by name. What is compared."""

import contextlib
import itertools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from jaxplore.settings.exploration import Settings, merged, read_settings
from jaxplore.settings.path import PathSettings

Entries = Mapping[str, Any]
"""Settings as in a settings file."""


def make_variants(
    architectures: Sequence[str] = (), files: Sequence[str] = (), varied: Sequence[str] = ()
) -> dict[str, dict[str, Any]]:
    """Return the entries of the settings that differ, by variant.

    Every architecture is combined with every file and with every value of each varied setting.

    Args:
        architectures: values of the setting `architecture`.
        files: YAML files of settings. A variant is named by its file without the ending.
        varied: texts `NAME=A,B,C`: a setting, or a number of the controller by its path, with its
            values. A variant is named by the last part of the name and the value.

    Returns:
        Entries by name; empty if nothing varies.

    Raises:
        ValueError: a file that cannot be read, a text that is not accepted, a name twice.
    """
    dimensions = [
        [(name, {"architecture": name}) for name in architectures],
        [(Path(file).stem, read_settings(file)) for file in files],
        *map(_values, varied),
    ]
    used = [each for each in dimensions if each]
    variants: dict[str, dict[str, Any]] = {}
    for parts in itertools.product(*used) if used else ():
        name = " ".join(part for part, _ in parts)
        entries: dict[str, Any] = {}
        for _, own in parts:
            entries = merged(entries, own)
        if name in variants:
            raise ValueError(f"variant {name} is there twice; accepted: different ones")
        variants[name] = entries
    return variants


def _values(text: str) -> list[tuple[str, dict[str, Any]]]:
    """Return the name and the entries of each value of a text `NAME=A,B,C`."""
    found = re.fullmatch(r"\s*([\w.-]+)\s*=(.+)", text)
    try:
        values = [] if found is None else [_value(part) for part in found[2].split(",")]
    except yaml.YAMLError:
        values = []
    are_plain = all(isinstance(each, bool | int | float | str) for each in values)
    if found is None or not values or not are_plain:
        raise ValueError(
            f"--vary is {text!r}; accepted: NAME=A,B,C with numbers or words, such as "
            "controller.temperature=10,30"
        )
    return [(f"{found[1].rpartition('.')[2]} {each}", _entry(found[1], each)) for each in values]


def _value(text: str) -> Any:
    """Read a value. YAML takes 1e2 for a word, which is a number here."""
    value = yaml.safe_load(text)
    with contextlib.suppress(TypeError, ValueError):
        return float(value) if isinstance(value, str) else value
    return value


def _entry(name: str, value: Any) -> dict[str, Any]:
    """Return the entries that set a setting, or a number of the controller by its path."""
    section, _, rest = name.partition(".")
    if section not in {*Settings.model_fields, *PathSettings.model_fields}:
        return {"parameters": {name: value}}
    return {section: {rest: value} if rest else value}
