"""A search in one call."""

import dataclasses
from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path

from jaxplore.study.tuning.episodes import Episodes
from jaxplore.study.tuning.objective import Objective
from jaxplore.study.tuning.search import POPULATION, Measure, Search
from jaxplore.study.tuning.space import Candidate, Parameter, Space, parse_parameter
from jaxplore.study.tuning.storage import open_study
from jaxplore.study.tuning.study import Progress
from jaxplore.study.tuning.trials import Trial

FINALISTS = 8
"""Candidates at most that are compared by new seeds before one is chosen."""


def further_seeds(first: int, seeds: int) -> range:
    """Return the seeds by which finalists are compared: twice as many as a search has.

    Args:
        first: the first one that the search did not use.
        seeds: of the search.
    """
    return range(first, first + max(2 * seeds, 6))


@dataclasses.dataclass(frozen=True)
class Tuned:
    """What a search found.

    Args:
        chosen: the best candidate by seeds that the search did not use.
        before: the values that there were.
        trials: all candidates, by number.
        front: those that no other one is better than in every objective.
        is_complete: whether the budget was spent; if not, Ctrl-C ended it.
    """

    chosen: Trial
    before: Candidate
    trials: tuple[Trial, ...]
    front: tuple[Trial, ...]
    is_complete: bool


def tune(
    episodes: Episodes,
    parameters: Sequence[Parameter | str],
    objective: str | Sequence[str],
    *,
    budget: int,
    seeds: int = 5,
    optimizer: str = "tpe",
    population: int = POPULATION,
    seed: int = 0,
    gives_up: bool | None = None,
    measures: Sequence[Measure] = (),
    folder: str | PathLike[str] | None = None,
    on_progress: Callable[[Progress], None] = lambda _: None,
) -> Tuned:
    """Search the values with which an objective is least.

    Every candidate is tried out in the same episodes (common random numbers). The eight best, and
    the values that there were, are then compared by other seeds, twice as many and at least six.

    Args:
        episodes: where candidates are tried out: `ControllerEpisodes`, `SettingsEpisodes`,
            `FunctionEpisodes`, `VectorEpisodes`.
        parameters: what is searched: each a `Parameter`, or a text `NAME=LOW:HIGH`,
            `NAME=LOW:HIGH:log`, `NAME=A,B,C`, or `NAME` for a tenth to ten times what it is.
        objective: a sum of metrics, less is better: `time_to.90 + 100*collisions`; several for a
            front of compromises.
        budget: candidates to try out, those of former calls in the same folder included.
        seeds: episodes of each candidate in each scenario.
        optimizer: of Optuna tpe, nsga-ii, qmc or random; of evosax cma-es, sep-cma-es, open-es,
            snes, cr-fm-nes or pgpe; of pyribs cma-me.
        population: candidates in a generation.
        seed: of the search and of the first episode.
        gives_up: whether candidates that look worse than most are given up after their first
            episodes; where there is one objective and no cma-me, when absent.
        measures: of cma-me, what it spreads over.
        folder: keeps the study; the same call goes on from there. Nowhere when absent.
        on_progress: told after each episode.

    Raises:
        ValueError: what `Search`, `open_study` and `Study.run` refuse; parameters and metrics that
            there are not.
    """
    texts = (objective,) if isinstance(objective, str) else tuple(objective)
    search = Search(
        space_of(parameters, episodes),
        tuple(map(Objective.parse, texts)),
        tuple(range(seed, seed + seeds)),
        optimizer,
        population=population,
        seed=seed,
        gives_up=(len(texts) == 1 and optimizer != "cma-me") if gives_up is None else gives_up,
        measures=tuple(measures),
    )
    where = None if folder is None else Path(folder)
    with open_study(search, episodes, where) as study:
        is_complete = study.run(budget, on_progress=on_progress)
        chosen = study.best()
        if is_complete:
            chosen = study.select(FINALISTS, further_seeds(seed + seeds, seeds))
        front = tuple(study.front())
        return Tuned(chosen, study.before, tuple(study.trials()), front, is_complete)


def space_of(parameters: Sequence[Parameter | str], episodes: Episodes) -> Space:
    """Return what is searched; an array stands for all of its elements.

    Args:
        parameters: see `tune`.
        episodes: where candidates are tried out.

    Raises:
        ValueError: a name that there is not, bounds that are not accepted.
    """
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
