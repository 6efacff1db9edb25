"""A complete search in one call, from the parameters to the comparison on unseen seeds."""

import contextlib
import dataclasses
import math
from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path

from jaxplore.report.console import progress_bar
from jaxplore.report.drawing.figure import PNG, figure_formats
from jaxplore.report.drawing.film import FilmOptions
from jaxplore.study.seeds import check_number_of_seeds
from jaxplore.study.tuning.before_after import before_and_after
from jaxplore.study.tuning.episodes import Episodes
from jaxplore.study.tuning.objective import Objective
from jaxplore.study.tuning.report import write_results, write_settings
from jaxplore.study.tuning.result import TuningResult, Unseen
from jaxplore.study.tuning.search import POPULATION, Measure, Search
from jaxplore.study.tuning.settings_episodes import SettingsEpisodes
from jaxplore.study.tuning.significance import changes, verdict
from jaxplore.study.tuning.space import Parameter, Space, parse_parameter
from jaxplore.study.tuning.storage import open_study
from jaxplore.study.tuning.study import BEFORE, SearchProgress, Study
from jaxplore.study.tuning.trials import Trial

FINALISTS = 8
"""Greatest number of finalists, which are compared on further seeds."""
UNSEEN = 10
"""Number of unseen seeds for the comparison of the current and the chosen settings."""


def further_seeds(first: int, seeds: int) -> range:
    """Return the seeds to compare finalists on, from `first`: twice as many as in the search."""
    return range(first, first + max(2 * seeds, 6))


def tune(
    episodes: Episodes,
    parameters: Sequence[Parameter | str],
    objective: str | Sequence[str] | None = None,
    *,
    budget: int | None = None,
    seconds: float | None = None,
    seeds: int = 5,
    unseen: int = UNSEEN,
    optimizer: str = "tpe",
    population: int = POPULATION,
    seed: int = 0,
    gives_up: bool | None = None,
    measures: Sequence[Measure] = (),
    folder: str | PathLike[str] | None = None,
    title: str = "",
    animation: bool = True,
    film: FilmOptions | None = None,
    figures: str | Sequence[str] = PNG,
    progress: bool = False,
) -> TuningResult:
    """Search for the parameter values with the least objective, and compare them with the current.

    Every candidate is evaluated in the same episodes (common random numbers). The eight best and
    the current values are compared on further seeds, twice as many and at least six, and the best
    one is chosen. The chosen and the current values are then compared on `unseen` other seeds.

    Ctrl-C ends the call and keeps finished episodes; with a folder the same call continues.

    Args:
        episodes: where candidates are evaluated: `ControllerEpisodes`, `SettingsEpisodes`,
            `FunctionEpisodes`, `VectorEpisodes`.
        parameters: parameters to search: each a `Parameter`, or a text `NAME=LOW:HIGH`,
            `NAME=LOW:HIGH:log`, `NAME=A,B,C`, or `NAME` for a tenth to ten times its value.
        objective: sum of metrics to minimize, such as `time_to.90 + 100*collisions`; several
            for a Pareto front. `episodes.default_objective` when absent.
        budget: number of candidates, those of former calls in the same folder included.
        seconds: wall-clock time after which no generation starts [s]; instead of a budget, or both.
        seeds: number of seeds per candidate and scenario.
        unseen: number of seeds for the comparison of the current and the chosen values.
        optimizer: name of the optimizer: tpe, nsga-ii, qmc or random of Optuna; cma-es, sep-cma-es,
            open-es, snes, cr-fm-nes or pgpe of evosax; cma-me of pyribs.
        population: number of candidates in a generation.
        seed: seed of the search and of the first episode.
        gives_up: whether candidates that are worse than most are stopped after their first
            episodes; when absent, with one objective and an optimizer other than cma-me.
        measures: metrics over which cma-me spreads candidates.
        folder: folder for the study, tables, pictures, a page, and with `SettingsEpisodes` the
            chosen settings and an animation. Nothing is written when absent.
        title: title of the page; the names of the scenarios when absent.
        animation: whether to draw runs before and after the search.
        film: frames per second and size of the animation; the defaults when absent.
        figures: formats of the figures: png, pdf or svg, or several, "pdf,svg".
        progress: whether to show progress bars.

    Raises:
        ValueError: arguments that `Search`, `open_study` or `Study.run` rejects; unknown parameters
            and metrics.
        KeyboardInterrupt: the user stopped it before any candidate had a value.
    """
    kinds, options = figure_formats(figures), FilmOptions() if film is None else film
    if unseen < 1:
        raise ValueError(f"unseen is {unseen}; accepted: a whole number >= 1")
    objectives = _objectives(episodes, objective)
    asked = range(seed, seed + seeds)
    check_number_of_seeds("seeds", asked)
    check_number_of_seeds("unseen", range(seed, seed + unseen))
    search = Search(
        build_space(parameters, episodes),
        objectives,
        tuple(asked),
        optimizer,
        population=population,
        seed=seed,
        # cma-me wants the best candidate of every cell, and in some cells all are bad.
        gives_up=len(objectives) == 1 and optimizer != "cma-me" if gives_up is None else gives_up,
        measures=tuple(measures),
    )
    where = None if folder is None else Path(folder)
    with open_study(search, episodes, where) as study:
        found = _search(study, budget, seconds, unseen, progress=progress)
        if where is None:
            return found
        files = [write_settings(study, found.chosen, where)]
        if found.is_complete:
            clip = _animation(study, found, options, progress=progress) if animation else None
            name = title or f"Tuned: {', '.join(episodes.scenarios)}"
            files += write_results(study, found, where, title=name, animation=clip, kinds=kinds)
        return dataclasses.replace(found, files=tuple(each for each in files if each is not None))


def _objectives(episodes: Episodes, given: str | Sequence[str] | None) -> tuple[Objective, ...]:
    if given is None:
        given = episodes.default_objective
    if not given:
        raise ValueError("objective is missing; accepted: a sum of metrics, such as collisions")
    objectives = tuple(map(Objective.parse, (given,) if isinstance(given, str) else given))
    if episodes.metrics is not None:
        for each in objectives:
            each.check(episodes.metrics)
    return objectives


def _search(
    study: Study, budget: int | None, seconds: float | None, unseen: int, *, progress: bool
) -> TuningResult:
    """Search, choose and compare. After Ctrl-C the remaining steps are skipped."""
    seeds = study.search.seeds
    further = further_seeds(seeds[-1] + 1, len(seeds))
    with progress_bar("tuning", enabled=progress) as advance:
        is_spent = study.run(budget, seconds, _show_search(advance, study, budget, seconds))
    chosen: Trial | None = None
    if is_spent:
        with contextlib.suppress(KeyboardInterrupt):
            with progress_bar("choosing", enabled=progress) as advance:
                chosen = study.select(FINALISTS, further, _show_episodes(advance))
            with progress_bar("comparing", enabled=progress) as advance:
                # Neither the search nor the selection has used these seeds.
                last = range(further.stop, further.stop + unseen)
                return compare_on_unseen(study, chosen, last, _show_episodes(advance))
    if chosen is None:
        # Without a candidate that has a value there is no result, so the interruption is passed on.
        if not any(each.state == "done" for each in study.trials()):
            raise KeyboardInterrupt
        chosen = study.best()
    return _result(study, chosen, {}, {}, is_complete=False)


def compare_on_unseen(
    study: Study,
    chosen: Trial,
    seeds: Sequence[int],
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> TuningResult:
    """Compare a candidate with the current values on seeds that the search did not use.

    `on_progress` is called with the number of finished episodes, and of all. After Ctrl-C finished
    episodes stay stored.
    """
    found = study.evaluate((BEFORE, chosen.number), seeds, on_progress)
    return _result(study, chosen, found[BEFORE], found[chosen.number], is_complete=True)


def _result(
    study: Study, chosen: Trial, before: Unseen, after: Unseen, *, is_complete: bool
) -> TuningResult:
    found = tuple(changes(study.search.objectives, before, after))
    told = "The search was interrupted; the same call continues it."
    if is_complete:
        told = verdict(chosen.number, study.search.objectives, found)
    return TuningResult(
        chosen,
        study.before,
        tuple(study.trials()),
        tuple(study.front()),
        is_complete,
        before,
        after,
        found,
        told,
    )


def _animation(
    study: Study, found: TuningResult, options: FilmOptions, *, progress: bool
) -> bytes | None:
    """Draw runs before and after the search side by side; None if that is not possible."""
    episodes = study.episodes
    if not isinstance(episodes, SettingsEpisodes) or not found.before:
        return None
    scenario = episodes.scenarios[0]
    seed = next(seed for name, seed in found.before if name == scenario)
    candidates = {
        "before": found.current,
        f"after: candidate {found.chosen.number}": found.chosen.candidate,
    }
    with progress_bar("drawing", enabled=progress) as advance:
        return before_and_after(
            episodes, scenario, candidates, seed, options, lambda share: advance(share, "")
        )


def build_space(parameters: Sequence[Parameter | str], episodes: Episodes) -> Space:
    """Build the search space; an array parameter stands for all of its elements."""
    found: list[Parameter] = []
    for each in parameters:
        name = each.name if isinstance(each, Parameter) else each.partition("=")[0].strip()
        for element in episodes.elements(name):
            start = episodes.start(element)
            if isinstance(each, Parameter):
                found.append(dataclasses.replace(each, name=element))
            else:
                bounds = each.partition("=")[1:]
                found.append(parse_parameter(element + "".join(bounds), start))
    return Space(tuple(found))


def _show_search(
    advance: Callable[[float, str], None], study: Study, budget: int | None, seconds: float | None
) -> Callable[[SearchProgress], None]:
    per_candidate = len(study.search.seeds) * len(study.episodes.scenarios)

    def show(now: SearchProgress) -> None:
        exact = now.num_done + now.num_episodes / per_candidate
        # Only candidates of this call took time in it, so those of former calls do not count.
        spent = exact - (now.num_done - now.num_now)
        if budget is None:
            assert seconds is not None
            left, share = max(seconds - now.seconds, 0.0), min(now.seconds / seconds, 1.0)
            text = f"{now.num_done} candidates"
        else:
            left = now.seconds / spent * (budget - exact) if spent > 0 else math.nan
            share, text = min(exact / budget, 1.0), f"{now.num_done} of {budget}"
        time_left = "" if math.isnan(left) else f", about {left:.0f} s left"
        best = f", best {now.best:.5g}" if math.isfinite(now.best) else ""
        advance(share, text + best + time_left)

    return show


def _show_episodes(advance: Callable[[float, str], None]) -> Callable[[int, int], None]:
    return lambda done, total: advance(done / total, f"{done} of {total} episodes")
