"""`jaxplore tune`: calls `jaxplore.study.tuning.tune` and prints its result."""

import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxplore._exit import INTERRUPTED
from jaxplore._limits import LONGEST_TIME, MOST_AT_ONCE, MOST_CANDIDATES, MOST_SEEDS
from jaxplore.cli._entries import option_entries
from jaxplore.cli._memory import check_count, check_memory, memory_limit
from jaxplore.cli._pictures import take_pictures
from jaxplore.cli._runner import RUNNER, make_runner
from jaxplore.cli._show import show_starts
from jaxplore.cli._terminal import say
from jaxplore.cli._tune_options import OWN
from jaxplore.report.table import print_table
from jaxplore.study.tuning.search import Measure
from jaxplore.study.tuning.settings_episodes import SettingsEpisodes
from jaxplore.study.tuning.tune import build_space, tune
from jaxplore.tasks.exploration.settings import merge_entries, read_settings
from jaxplore.tasks.registry import (
    default_kind,
    find_kind,
    folder_name,
    keep_read,
    make_settings,
    place_entries,
)

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


def run_tune(options: dict[str, Any], out: Path | None) -> None:
    """Search for better settings, write the folder of the search and print the result.

    The exit code is 130 if the user stopped it.
    """
    pictures = take_pictures(options)
    limit = memory_limit(options)
    given = {name: options.pop(name) for name in (*OWN, *RUNNER)}
    if options.pop("overwrite"):
        raise ValueError("--overwrite is given; accepted: a new --out, or the folder as it is")
    asked, common = scenario_entries(options, given["also"])
    is_one_place = common is next(iter(asked.values()))
    asked = keep_read(asked)
    budget, seconds = parse_budget(given["budget"])
    for name, most in _MOST.items():
        check_count(f"--{name}", given[name], most)
    first = common.get("seed", 0)
    if not isinstance(first, int):
        raise ValueError(f"setting seed is {first!r}; accepted: a whole number >= 0")
    if not given["tuned"]:
        raise ValueError(
            "--tune is missing; accepted: a setting or a controller parameter, such as "
            "controller.temperature=0.01:3:log"
        )
    runner = make_runner(given)
    check_memory(
        map(make_settings, asked.values()),
        limit,
        num_runs=runner.num_processes,
        batch=given["batch"],
    )
    scenarios = {name: find_kind(each).with_start(each) for name, each in asked.items()}
    # With one place, the settings of the first scenario are those that the search writes.
    if is_one_place:
        common = next(iter(scenarios.values()))
    name = "-".join(scenarios)
    folder = Path("runs") / f"{name}-tuned" if out is None else out
    with runner:
        episodes = SettingsEpisodes(scenarios, batch=given["batch"], runner=runner, common=common)
        check_memory(
            episodes.largest(build_space(given["tuned"], episodes)),
            limit,
            num_runs=runner.num_processes,
            batch=given["batch"],
        )
        show_starts(asked, scenarios)
        try:
            found = tune(
                episodes,
                given["tuned"],
                given["objectives"] or None,
                budget=budget,
                seconds=seconds,
                seed=first,
                measures=tuple(map(parse_measure, given["measures"])),
                folder=folder,
                title=f"Tuned: {name}",
                animation=pictures.animation,
                film=pictures.film,
                figures=pictures.figures,
                progress=True,
                **{name: given[name] for name in _PASSED},
            )
        except KeyboardInterrupt:
            _end(folder)
    if not found.is_complete:
        _end(folder, f"{len(found.trials)} candidates are kept in {folder}; ")
    print_table(found.rows(), title=f"{folder}: means over {len(found.before)} unseen episodes")
    say(found.verdict)
    for path in found.files:
        say(str(path))


_PASSED = ("seeds", "unseen", "optimizer", "population", "gives_up")
"""Options that are parameters of `tune` with the same name."""

_MOST = {
    "seeds": MOST_SEEDS,
    "unseen": MOST_SEEDS,
    "population": MOST_AT_ONCE,
    "batch": MOST_AT_ONCE,
}
"""Options that are counts, and their greatest values."""


def _end(folder: Path, kept: str = "") -> None:
    say(f"Interrupted: {kept}the same command continues in {folder}.", err=True)
    sys.exit(INTERRUPTED)
