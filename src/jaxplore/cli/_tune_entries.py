"""Conversion of the options of `jaxplore tune`."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxplore._limits import LONGEST_TIME, MOST_CANDIDATES
from jaxplore.cli._entries import option_entries
from jaxplore.study.tuning.search import Measure
from jaxplore.tasks.exploration.settings import merge_entries, read_settings
from jaxplore.tasks.registry import default_kind, find_kind, folder_name, place_entries

_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def scenario_entries(
    options: dict[str, Any], also: Sequence[str]
) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Return the settings entries of each scenario by name, and the common entries.

    `also` has further maps, paths or scenarios, or settings files with differences from the first.
    A scenario that is unknown or repeated raises a `ValueError`.
    """
    first = option_entries(options)
    trust = options.get("trust", False)
    kind = find_kind(first)
    if kind.selector not in first:
        raise ValueError("map is missing; accepted: the YAML file of a ROS map, or a name")
    common = option_entries({**options, "map_": None}) if kind is default_kind() else first
    common = {key: value for key, value in common.items() if key != kind.selector}
    scenarios = {folder_name(first): first}
    for place in also:
        label = Path(place).stem
        if label in scenarios:
            raise ValueError(f"--also is {place!r}, which is there already; accepted: another one")
        if _holds_settings(place):
            scenarios[label] = merge_entries(first, read_settings(place, is_trusted=trust))
        elif kind.suffixes:
            scenarios[label] = {**place_entries(place, is_trusted=trust), **common}
        else:
            scenarios[label] = {**kind.read_entries(place, is_trusted=trust), **common}
    where = kind.selector
    is_one_place = all(each.get(where) == first[where] for each in scenarios.values())
    return scenarios, first if is_one_place else common


def _holds_settings(file: str) -> bool:
    """Check whether a file holds settings, and not a map, a path or a world."""
    if Path(file).suffix not in (".yaml", ".yml") or not Path(file).is_file():
        return False
    # Nothing is made of these entries.
    entries = read_settings(file, is_trusted=True)
    return all(entries.get(name) is None for name in ("image", "poses", "world"))


def parse_budget(text: str) -> tuple[int | None, float | None]:
    """Parse a budget: a number of candidates, or a time [s]."""
    # Python refuses to convert thousands of digits.
    if text.isdecimal() and len(text) <= 20 and int(text) >= 1:
        if int(text) > MOST_CANDIDATES:
            raise ValueError(f"--budget is {text}; accepted: a whole number <= {MOST_CANDIDATES}")
        return int(text), None
    found = re.fullmatch(r"(\d+\.?\d*)\s*(s|min|h)", text.strip())
    if found is None or float(found[1]) <= 0.0:
        raise ValueError(
            f"--budget is {text!r}; accepted: a whole number >= 1 of candidates, or a time such as "
            "90s, 30min or 2h"
        )
    if float(found[1]) * _UNITS[found[2]] > LONGEST_TIME:
        raise ValueError(f"--budget is {text!r}; accepted: a time of at most {LONGEST_TIME:g} s")
    return None, float(found[1]) * _UNITS[found[2]]


def parse_measure(text: str) -> Measure:
    """Parse a measure, METRIC=LOW:HIGH[:CELLS]."""
    found = re.fullmatch(r"([\w.]+)=([^:]+):([^:]+)(?::(\d+))?", text)
    try:
        if found is None:
            raise ValueError
        return Measure(found[1], float(found[2]), float(found[3]), int(found[4] or 10))
    except ValueError as error:
        if str(error).startswith("measure "):
            raise
        raise ValueError(
            f"--measure is {text!r}; accepted: METRIC=LOW:HIGH or METRIC=LOW:HIGH:CELLS"
        ) from None
