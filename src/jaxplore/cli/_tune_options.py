"""Options of `jaxplore tune`."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from jaxplore.cli._completion import complete_map, complete_setting, words
from jaxplore.cli._options import folder_name, map_entries, option_entries
from jaxplore.settings.exploration import merge_entries, read_settings
from jaxplore.settings.path import PATH
from jaxplore.study.tuning.optimizers import NAMES
from jaxplore.study.tuning.search import POPULATION, Measure

OWN = (
    "tuned",
    "also",
    "budget",
    "objectives",
    "optimizer",
    "seeds",
    "unseen",
    "population",
    "gives_up",
    "measures",
    "batch",
)
"""Names of the options of a search."""

_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}


_OPTIONS = (
    click.option(
        "--batch",
        type=int,
        default=1,
        show_default=True,
        help="Number of candidates in one program (vmap), for accelerators and small problems.",
    ),
    click.option(
        "--measure",
        "measures",
        multiple=True,
        metavar="METRIC=LOW:HIGH[:CELLS]",
        help="With --optimizer cma-me: metric over which to find diverse settings.",
    ),
    click.option(
        "--give-up/--no-give-up",
        "gives_up",
        default=None,
        help="Stop candidates that are worse than most after their first episodes.  "
        "[default: on with one objective, except with cma-me]",
    ),
    click.option(
        "--population",
        type=int,
        default=POPULATION,
        show_default=True,
        help="Number of candidates in a generation.",
    ),
    click.option(
        "--unseen",
        type=int,
        default=10,
        show_default=True,
        help="Number of seeds, not used by the search, to compare current and chosen settings.",
    ),
    click.option(
        "--seeds", type=int, default=5, show_default=True, help="Number of seeds per candidate."
    ),
    click.option(
        "--optimizer",
        default="tpe",
        show_default=True,
        metavar="NAME",
        shell_complete=words(NAMES),
        help=f"One of {', '.join(NAMES)}.",
    ),
    click.option(
        "--objective",
        "objectives",
        multiple=True,
        metavar="SUM",
        help="Sum of metrics to minimize, such as 'time_to.90 + 100*collisions'; several "
        "for a Pareto front.  [default: time to the end, plus a penalty per collision]",
    ),
    click.option(
        "--budget",
        default="100",
        show_default=True,
        metavar="N | TIME",
        help="Number of candidates, or a time such as 30min.",
    ),
    click.option(
        "--also",
        multiple=True,
        metavar="FILE | NAME",
        shell_complete=complete_map,
        help="Another map, path or scenario, or a settings file with differences, such as "
        "another robot.",
    ),
    click.option(
        "--tune",
        "tuned",
        multiple=True,
        shell_complete=complete_setting,
        metavar="NAME[=LOW:HIGH[:log] | =A,B,C]",
        help="A setting, or a controller parameter by its path. Without bounds it is "
        "searched from a tenth to ten times its value.",
    ),
)


def tune_options(command: Any) -> Any:
    """Add the options of a search."""
    # Click lists options in the reverse order of their addition, so `_OPTIONS` is in reverse.
    for option in _OPTIONS:
        command = option(command)
    return command


def scenario_entries(
    options: dict[str, Any], also: Sequence[str]
) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Return the settings entries of each scenario by name, and the common entries.

    Args:
        options: options of `with_options` and `path_options`.
        also: further maps, paths or scenarios, or settings files with differences from the first.

    Raises:
        ValueError: an unknown scenario, or a repeated one.
    """
    first = option_entries(options)
    along_path = PATH in first
    if along_path:
        name, common = PATH, {key: value for key, value in first.items() if key != PATH}
    else:
        common = option_entries({**options, "map_": None})
        if "map" not in first:
            raise ValueError("map is missing; accepted: the YAML file of a ROS map, or a name")
        name = folder_name(first)
    scenarios = {name: first}
    for place in also:
        label = Path(place).stem
        if label in scenarios:
            raise ValueError(f"--also is {place!r}, which is there already; accepted: another one")
        if _holds_settings(place):
            scenarios[label] = merge_entries(first, read_settings(place))
        elif along_path:
            scenarios[label] = {**common, PATH: str(Path(place).absolute())}
        else:
            scenarios[label] = {**map_entries(place), **common}
    where = PATH if along_path else "map"
    is_one_place = all(each[where] == first[where] for each in scenarios.values())
    return scenarios, first if is_one_place else common


def _holds_settings(file: str) -> bool:
    """Check whether a file holds settings, and not a map, a path or a world."""
    if Path(file).suffix not in (".yaml", ".yml") or not Path(file).is_file():
        return False
    entries = read_settings(file)
    return all(entries.get(name) is None for name in ("image", "poses", "world"))


def parse_budget(text: str) -> tuple[int | None, float | None]:
    """Parse a budget: a number of candidates, or a time [s]."""
    if text.isdigit() and int(text) >= 1:
        return int(text), None
    found = re.fullmatch(r"(\d+\.?\d*)\s*(s|min|h)", text.strip())
    if found is None or float(found[1]) <= 0.0:
        raise ValueError(
            f"--budget is {text!r}; accepted: a whole number >= 1 of candidates, or a time such as "
            "90s, 30min or 2h"
        )
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
