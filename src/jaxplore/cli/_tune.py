"""`jaxplore tune`: search the settings with which a robot does best."""

import contextlib
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
import yaml
from rich.console import Console
from rich.table import Table
from rich.text import Text

from jaxplore.cli._path import is_path
from jaxplore.cli._tune_options import (
    OWN,
    budget_of,
    default_objective,
    measure_of,
    pool_of,
    scenarios_of,
)
from jaxplore.report.console import progress_bar
from jaxplore.study.tuning.clip import before_and_after
from jaxplore.study.tuning.evidence import changes, verdict
from jaxplore.study.tuning.objective import Objective, known_metrics
from jaxplore.study.tuning.results import SETTINGS, write_results, write_text
from jaxplore.study.tuning.runs import SettingsEpisodes
from jaxplore.study.tuning.search import Search
from jaxplore.study.tuning.storage import open_study
from jaxplore.study.tuning.study import BEFORE, Progress, Study
from jaxplore.study.tuning.trials import Trial
from jaxplore.study.tuning.tune import FINALISTS, further_seeds, space_of

_INTERRUPTED = 130


def run_tune(options: dict[str, Any], out: Path | None, *, animation: bool) -> None:
    """Search settings, write the study's folder and print what was won.

    Ends the process with 130 if the user stopped it.

    Raises:
        ValueError: what is asked for is not possible.
    """
    given = {name: options.pop(name) for name in OWN}
    if options.pop("overwrite"):
        raise ValueError("--overwrite is given; accepted: a new --out, or the folder as it is")
    along_path = is_path(options)
    scenarios, common = scenarios_of(options, given["also"])
    count, seconds = budget_of(given["budget"])
    for name in ("seeds", "unseen", "population"):
        if given[name] < 1:
            raise ValueError(f"--{name} is {given[name]}; accepted: a whole number >= 1")
    pool = pool_of(given)
    first = common.get("seed", 0)
    if not isinstance(first, int):
        raise ValueError(f"setting seed is {first!r}; accepted: a whole number >= 0")
    episodes = SettingsEpisodes(scenarios, is_path=along_path, batch=given["batch"], pool=pool)
    if not given["tuned"]:
        raise ValueError(
            "--tune is missing; accepted: a setting or a number of the controller, such as "
            "controller.temperature=0.01:3:log"
        )
    space = space_of(given["tuned"], episodes)
    objectives = tuple(Objective.parse(text) for text in given["objectives"])
    if not objectives:
        objectives = (Objective.parse(default_objective(episodes)),)
    for each in objectives:
        each.check(known_metrics(episodes.example.scenario.metrics_type))
    gives_up = given["gives_up"]
    if gives_up is None:
        gives_up = len(objectives) == 1 and given["optimizer"] != "cma-me"
    search = Search(
        space,
        objectives,
        tuple(range(first, first + given["seeds"])),
        given["optimizer"],
        population=given["population"],
        seed=first,
        gives_up=gives_up,
        measures=tuple(map(measure_of, given["measures"])),
    )
    name = "-".join(scenarios)
    folder = Path("runs") / f"{name}-tuned" if out is None else out
    try:
        with open_study(search, episodes, folder) as study:
            chosen = _search(study, count, seconds, folder, common, first + given["seeds"])
            if chosen is None:
                sys.exit(_INTERRUPTED)
            used = further_seeds(first + given["seeds"], given["seeds"]).stop
            unseen = range(used, used + given["unseen"])
            _finish(study, chosen, unseen, folder, name, animation=animation)
    finally:
        if pool is not None:
            pool.close()


def _search(
    study: Study,
    count: int | None,
    seconds: float | None,
    folder: Path,
    common: dict[str, Any],
    further: int,
) -> Trial | None:
    """Run the search and choose; None if the user stopped it."""
    with progress_bar("tuning", enabled=True) as advance:
        is_spent = study.run(count, seconds, _progress(advance, study, count, seconds))
    chosen: Trial | None = None
    if is_spent:
        seeds = further_seeds(further, len(study.search.seeds))
        bar = progress_bar("choosing", enabled=True)
        with bar as advance, contextlib.suppress(KeyboardInterrupt):
            chosen = study.select(
                FINALISTS,
                seeds,
                lambda done, of: advance(done / of, f"{done} of {of} episodes"),
            )
    if chosen is None:
        done = len(study.trials())
        click.echo(
            f"Interrupted: {done} candidates are kept in {folder}; the same command goes on.",
            err=True,
        )
        if any(each.state == "done" for each in study.trials()):
            _write_settings(study, study.best(), folder, common)
        return None
    _write_settings(study, chosen, folder, common)
    return chosen


def _write_settings(study: Study, chosen: Trial, folder: Path, common: dict[str, Any]) -> None:
    episodes = study.episodes
    assert isinstance(episodes, SettingsEpisodes)
    if len(episodes.scenarios) == 1:
        settings = episodes.settings(episodes.scenarios[0], chosen.candidate)
        entries = settings.model_dump(mode="json")
    else:
        entries = episodes.with_values(common, chosen.candidate)
    write_text(folder, SETTINGS, yaml.safe_dump(entries, sort_keys=False, allow_unicode=True))


def _progress(
    advance: Callable[[float, str], None], study: Study, count: int | None, seconds: float | None
) -> Callable[[Progress], None]:
    per_candidate = len(study.search.seeds) * len(study.episodes.scenarios)

    def show(now: Progress) -> None:
        exact = now.num_done + now.num_episodes / per_candidate
        spent = exact - (now.num_done - now.num_now)
        if count is None:
            assert seconds is not None
            left, share = max(seconds - now.seconds, 0.0), min(now.seconds / seconds, 1.0)
            text = f"{now.num_done} candidates"
        else:
            left = now.seconds / spent * (count - exact) if spent > 0 else float("nan")
            share, text = min(exact / count, 1.0), f"{now.num_done} of {count}"
        time_left = f", about {left:.0f} s left" if left == left else ""
        best = f", best {now.best:.5g}" if now.best < float("inf") else ""
        advance(share, text + best + time_left)

    return show


def _finish(
    study: Study, chosen: Trial, unseen: Sequence[int], folder: Path, name: str, *, animation: bool
) -> None:
    """Compare before and after, and write and print what was found."""
    with progress_bar("comparing", enabled=True) as advance:
        try:
            tried = study.try_out(
                (BEFORE, chosen.number),
                unseen,
                lambda done, of: advance(done / of, f"{done} of {of} episodes"),
            )
        except KeyboardInterrupt:
            click.echo("Interrupted: the same command goes on.", err=True)
            sys.exit(_INTERRUPTED)
    episodes = study.episodes
    assert isinstance(episodes, SettingsEpisodes)
    clip = None
    if animation:
        with progress_bar("drawing", enabled=True) as advance:
            clip = before_and_after(
                episodes,
                episodes.scenarios[0],
                (study.before, chosen.candidate),
                unseen[0],
                lambda share: advance(share, ""),
            )
    before, after = tried[BEFORE], tried[chosen.number]
    paths = write_results(
        study, chosen, before, after, folder, title=f"Tuned: {name}", animation=clip
    )
    table = Table(title=f"{folder}: means over {len(before)} episodes not tuned on")
    for heading in ("", "before", "after", "difference [95 % interval]"):
        table.add_column(Text(heading))
    for parameter, value in chosen.candidate.items():
        table.add_row(*map(Text, (parameter, _number(study.before[parameter]), _number(value), "")))
    table.add_section()
    found = changes(study.search.objectives, before, after)
    for each in found:
        interval = f"{each.difference:+.4g} [{each.low:+.4g}, {each.high:+.4g}]"
        table.add_row(*map(Text, (each.name, _number(each.before), _number(each.after), interval)))
    Console().print(table)
    click.echo(verdict(chosen.number, study.search.objectives, found))
    for path in (folder / SETTINGS, *paths):
        click.echo(str(path))


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
