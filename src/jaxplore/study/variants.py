"""Variants of a comparison: settings that differ, by name."""

import contextlib
import itertools
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxplore._files import parse_yaml
from jaxplore._text import short_repr
from jaxplore.tasks.exploration.settings import merge_entries, read_settings
from jaxplore.tasks.registry import KINDS

Entries = Mapping[str, Any]
"""Settings as in a settings file."""


def make_variants(
    architectures: Sequence[str] = (),
    files: Sequence[str] = (),
    varied: Sequence[str] = (),
    *,
    is_trusted: bool = False,
) -> dict[str, dict[str, Any]]:
    """Make the settings entries of variants from command-line options; none if nothing varies.

    Every architecture is combined with every file and with every value of each varied setting. A
    variant is named by its parts: its architecture, its file without the ending, and the last part
    of each varied name with the value. `varied` are texts `NAME=A,B,C`: a setting, or a controller
    parameter by its path, with its values. `is_trusted` says whether the files may name code,
    MODULE:NAME.

    Raises:
        ValueError: a file that cannot be read, a text that is not accepted, a repeated name.
    """
    dimensions = [
        # Of MODULE:NAME the name: files are named by variants.
        [(name.rpartition(":")[2], {"architecture": name}) for name in architectures],
        [(Path(file).stem, read_settings(file, is_trusted=is_trusted)) for file in files],
        *map(_values, varied),
    ]
    used = [each for each in dimensions if each]
    variants: dict[str, dict[str, Any]] = {}
    for parts in itertools.product(*used) if used else ():
        name = " ".join(part for part, _ in parts)
        entries: dict[str, Any] = {}
        for _, own in parts:
            entries = merge_entries(entries, own)
        if name in variants:
            raise ValueError(f"variant {name} is there twice; accepted: different ones")
        variants[name] = entries
    return variants


def _values(text: str) -> list[tuple[str, dict[str, Any]]]:
    """Parse `NAME=A,B,C` into the variant's name and entries for each value."""
    found = re.fullmatch(r"\s*([\w.-]+)\s*=(.+)", text)
    try:
        values = [] if found is None else [_value(part) for part in found[2].split(",")]
    except ValueError:
        values = []
    are_plain = all(isinstance(each, bool | int | float | str) for each in values)
    if found is None or not values or not are_plain:
        raise ValueError(
            f"--vary is {short_repr(text)}; accepted: NAME=A,B,C with numbers or words, such as "
            "controller.temperature=10,30"
        )
    return [(f"{found[1].rpartition('.')[2]} {each}", _entry(found[1], each)) for each in values]


def _value(text: str) -> Any:
    """Parse a value. YAML reads 1e2 as text; here it is a number."""
    value = parse_yaml(text)
    with contextlib.suppress(TypeError, ValueError):
        return float(value) if isinstance(value, str) else value
    return value


def _entry(name: str, value: Any) -> dict[str, Any]:
    """Return the settings entries that assign a setting or a controller parameter."""
    section, _, rest = name.partition(".")
    # A name that is no section of the settings is the path of a controller parameter.
    if not any(section in kind.settings.model_fields for kind in KINDS.values()):
        return {"parameters": {name: value}}
    return {section: {rest: value} if rest else value}
