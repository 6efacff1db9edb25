"""`jaxplore tune`: calls `jaxplore.study.tuning.tune` and prints its result."""

import sys
from pathlib import Path
from typing import Any

from jaxplore._exit import INTERRUPTED
from jaxplore._limits import MOST_AT_ONCE, MOST_SEEDS
from jaxplore.cli._memory import check_count, check_memory, memory_limit
from jaxplore.cli._pictures import take_pictures
from jaxplore.cli._runner import RUNNER, make_runner
from jaxplore.cli._show import show_starts
from jaxplore.cli._terminal import say
from jaxplore.cli._tune_entries import parse_budget, parse_measure, scenario_entries
from jaxplore.cli._tune_options import OWN
from jaxplore.report.table import print_table
from jaxplore.study.tuning.settings_episodes import SettingsEpisodes
from jaxplore.study.tuning.tune import build_space, tune
from jaxplore.tasks.registry import find_kind, keep_read, make_settings


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
