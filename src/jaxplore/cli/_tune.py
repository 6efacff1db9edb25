"""`jaxplore tune`: search the settings with which a robot does best."""

import contextlib
import re
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click
import yaml
from rich.console import Console
from rich.table import Table
from rich.text import Text

from jaxplore.cli._options import entries_of, place_entries
from jaxplore.cli._path import is_path, path_entries
from jaxplore.path_settings import PATH
from jaxplore.runs import PathRun, Run, follow_path, progress_bar, simulate
from jaxplore.simulation.path_scenario import PathScenario
from jaxplore.tuning.evidence import changes
from jaxplore.tuning.objective import Objective, known_metrics
from jaxplore.tuning.pictures import side_by_side
from jaxplore.tuning.results import SETTINGS, write_results, write_text
from jaxplore.tuning.runs import SettingsEpisodes
from jaxplore.tuning.search import POPULATION, Measure, Search
from jaxplore.tuning.storage import open_study
from jaxplore.tuning.strategies import NAMES
from jaxplore.tuning.study import BEFORE, Progress, Study
from jaxplore.tuning.trials import Trial
from jaxplore.tuning.tune import FINALISTS, further_seeds, space_of
from jaxplore.workers.pool import Pool

_INTERRUPTED = 130
_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}


def tune_options(command: Any) -> Any:
    """Add the options that only a search takes."""
    for option in (
        click.option("--address", metavar="HOST:PORT", help="A Ray cluster to join."),
        click.option("--ray", is_flag=True, help="Run episodes on a local Ray cluster."),
        click.option(
            "--workers", type=int, help="Processes, or workers of Ray.  [default: 1; all of Ray]"
        ),
        click.option(
            "--batch",
            type=int,
            default=1,
            show_default=True,
            help="Candidates side by side in one program (vmap), for accelerators and small "
            "problems.",
        ),
        click.option(
            "--measure",
            "measures",
            multiple=True,
            metavar="METRIC=LOW:HIGH[:CELLS]",
            help="For --optimizer cma-me: spread settings over this metric.",
        ),
        click.option(
            "--give-up/--no-give-up",
            "gives_up",
            default=None,
            help="Leave candidates that look worse than most after their first episodes.  "
            "[default: where there is one objective, and no cma-me]",
        ),
        click.option(
            "--population",
            type=int,
            default=POPULATION,
            show_default=True,
            help="Candidates in a generation.",
        ),
        click.option(
            "--unseen",
            type=int,
            default=10,
            show_default=True,
            help="Seeds to compare settings before and after with, that were not tuned on.",
        ),
        click.option(
            "--seeds", type=int, default=5, show_default=True, help="Episodes of each candidate."
        ),
        click.option(
            "--optimizer",
            default="tpe",
            show_default=True,
            metavar="NAME",
            help=f"Any of {', '.join(NAMES)}.",
        ),
        click.option(
            "--objective",
            "objectives",
            multiple=True,
            metavar="SUM",
            help="What is to be small, such as 'time_to.90 + 100*collisions'; several for a front "
            "of compromises.  [default: the time to the end, and collisions]",
        ),
        click.option(
            "--budget",
            default="100",
            show_default=True,
            metavar="N | TIME",
            help="Candidates to try out, or a time such as 30min.",
        ),
        click.option(
            "--also",
            multiple=True,
            metavar="MAP.yaml | NAME",
            help="Another map or scenario to be good in.",
        ),
        click.option(
            "--tune",
            "tuned",
            multiple=True,
            metavar="NAME[=LOW:HIGH[:log] | =A,B,C]",
            help="A setting, or a number of the controller by its path; without bounds from a "
            "tenth to ten times what it is.",
        ),
    ):
        command = option(command)
    return command


def run_tune(options: dict[str, Any], out: Path | None, *, animation: bool) -> None:
    """Search settings, write the study's folder and print what was won.

    Ends the process with 130 if the user stopped it.

    Raises:
        ValueError: what is asked for is not possible.
    """
    given = {name: options.pop(name) for name in _OWN}
    if options.pop("overwrite"):
        raise ValueError("--overwrite is given; accepted: a new --out, or the folder as it is")
    along_path = is_path(options)
    scenarios, common = _scenarios(options, given["also"], along_path)
    count, seconds = _budget(given["budget"])
    for name in ("seeds", "unseen", "population"):
        if given[name] < 1:
            raise ValueError(f"--{name} is {given[name]}; accepted: a whole number >= 1")
    pool = _pool(given)
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
        objectives = (Objective.parse(_default_objective(episodes)),)
    for each in objectives:
        each.check(known_metrics(is_path=along_path))
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
        measures=tuple(map(_measure, given["measures"])),
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


_OWN = (
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
    "workers",
    "ray",
    "address",
)


def _scenarios(
    options: dict[str, Any], also: Sequence[str], along_path: bool
) -> tuple[dict[str, dict[str, Any]], dict[str, Any]]:
    """Return the settings of each scenario by its name, and what they have in common."""
    if along_path:
        if also:
            raise ValueError(f"--also is {also[0]!r} beside a path; accepted: with a map")
        entries = path_entries(options)
        return {PATH: entries}, entries
    for name in ("laps", "obstacles", "path_file"):
        options.pop(name)
    map_ = options["map_"]
    if also and map_ is None:
        raise ValueError(f"--also is {also[0]!r} without a map; accepted: beside one")
    given = {**options}
    common = entries_of({**given, "map_": None})
    entries = entries_of(given)
    if "map" not in entries:
        raise ValueError("map is missing; accepted: the YAML file of a ROS map, or a name")
    scenarios = {Path(str(entries["map"])).stem: entries}
    for place in also:
        label = Path(place).stem
        if label in scenarios:
            raise ValueError(f"--also is {place!r}, which is there already; accepted: another one")
        scenarios[label] = {**place_entries(place), **common}
    return scenarios, entries if len(scenarios) == 1 else common


def _budget(text: str) -> tuple[int | None, float | None]:
    """Return a number of candidates, or a time [s]."""
    if text.isdigit() and int(text) >= 1:
        return int(text), None
    found = re.fullmatch(r"(\d+\.?\d*)\s*(s|min|h)", text.strip())
    if found is None or float(found[1]) <= 0.0:
        raise ValueError(
            f"--budget is {text!r}; accepted: a whole number >= 1 of candidates, or a time such as "
            "90s, 30min or 2h"
        )
    return None, float(found[1]) * _UNITS[found[2]]


def _pool(given: dict[str, Any]) -> Pool | None:
    workers, on_ray, address = given["workers"], given["ray"], given["address"]
    if not on_ray and address is None and workers in (None, 1):
        return None
    return Pool(workers, address, on_ray=on_ray)


def _default_objective(episodes: SettingsEpisodes) -> str:
    scenario = episodes.example.scenario
    if isinstance(scenario, PathScenario):
        return "finished_at + 10*corridor_violations + 10*collisions"
    if scenario.num_targets:
        return "last_target_at + 100*collisions"
    if scenario.goal is None and float(scenario.target_coverage) > 1.0:
        return "mean_idleness + 100*collisions"
    return "finished_at + 100*collisions"


def _measure(text: str) -> Measure:
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
            found = study.try_out(
                (BEFORE, chosen.number),
                unseen,
                lambda done, of: advance(done / of, f"{done} of {of} episodes"),
            )
        except KeyboardInterrupt:
            click.echo("Interrupted: the same command goes on.", err=True)
            sys.exit(_INTERRUPTED)
    clip = _clip(study, chosen, unseen[0], folder) if animation else None
    before, after = found[BEFORE], found[chosen.number]
    paths = write_results(
        study, chosen, before, after, folder, title=f"Tuned: {name}", animation=clip
    )
    table = Table(title=f"{folder}: means over {len(before)} episodes not tuned on")
    for heading in ("", "before", "after", "difference [95 % interval]"):
        table.add_column(Text(heading))
    for parameter, value in chosen.candidate.items():
        table.add_row(*map(Text, (parameter, _number(study.before[parameter]), _number(value), "")))
    table.add_section()
    for each in changes(study.search.objectives, before, after):
        interval = f"{each.difference:+.4g} [{each.low:+.4g}, {each.high:+.4g}]"
        table.add_row(*map(Text, (each.name, _number(each.before), _number(each.after), interval)))
    Console().print(table)
    if chosen.number == 0:
        click.echo("The settings that there were are the best that were found.")
    for path in (folder / SETTINGS, *paths):
        click.echo(str(path))


def _clip(study: Study, chosen: Trial, seed: int, folder: Path) -> bytes | None:
    """Run the first scenario before and after with one seed, and return both beside each other."""
    episodes = study.episodes
    assert isinstance(episodes, SettingsEpisodes)
    scenario = episodes.scenarios[0]
    clips: list[Path] = []
    durations: list[float] = []
    pictures: list[bytes] = []
    with tempfile.TemporaryDirectory(prefix="jaxplore-") as temporary:
        for label, candidate in (("before", study.before), ("after", chosen.candidate)):
            built = episodes.kind.build(episodes.entries(scenario, candidate, seed))
            run: Run | PathRun
            if isinstance(built.scenario, PathScenario):
                run = follow_path(built.controller, built.scenario, built.num_steps, key=built.key)
            else:
                run = simulate(built.controller, built.scenario, built.num_steps, key=built.key)
            if run.metrics.is_interrupted:
                return None
            run.save(Path(temporary) / label, progress=True)
            clips += sorted((Path(temporary) / label).glob("*.gif"))
            durations.append(run.metrics.duration)
        if len(clips) != 2:
            return None
        side_by_side(clips[0], clips[1], (durations[0], durations[1]), pictures.append)
    return pictures[0] if pictures else None


def _number(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
