"""A study: a search with its results in Optuna's storage."""

import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxplore import _checks
from jaxplore._limits import MOST_CANDIDATES
from jaxplore.study.tuning.episodes import Episode, Episodes, Result
from jaxplore.study.tuning.generation import Generations
from jaxplore.study.tuning.objective import Numbers, Objective
from jaxplore.study.tuning.optimizers import Evaluated, Optimizer
from jaxplore.study.tuning.search import Search, make_optimizer
from jaxplore.study.tuning.space import Candidate
from jaxplore.study.tuning.trials import UNSEEN, Trial, make_trial

BEFORE = -1
"""Number that stands for the current values, which may lie outside the bounds."""
HOPELESS = 2.0
"""An episode is stopped after this multiple of the best candidate's duration."""
SEARCHED_PER_FINALIST = 8
"""Least number of evaluated candidates per finalist."""
_UNPROMISING = 10
"""Number of candidates without a value after which the search ends with an error."""


class SearchProgress(NamedTuple):
    """Progress of a search.

    Args:
        num_done: number of evaluated candidates.
        best: least value of the first objective so far; infinite without any value.
        seconds: wall-clock time of this call [s].
        num_now: number of candidates that this call has evaluated.
        num_episodes: number of finished episodes of the current generation.
    """

    num_done: int
    best: float
    seconds: float
    num_now: int
    num_episodes: int


class Study:
    """A search and its results so far; `open_study` makes it."""

    def __init__(self, search: Search, episodes: Episodes, study: Any) -> None:
        self.search, self.episodes, self.optuna = search, episodes, study
        self._start = {
            each.name: each.clip(episodes.start(each.name)) for each in search.space.parameters
        }
        self._generations = Generations(search, episodes, study, self._start)
        self._optimizer: Optimizer | None = None
        self._told = 0

    @property
    def start(self) -> Candidate:
        """First candidate: the current values, clipped to the bounds."""
        return dict(self._start)

    @property
    def before(self) -> Candidate:
        """Current values."""
        return {name: self.episodes.start(name) for name in self._start}

    @property
    def optimizer(self) -> Optimizer:
        """Optimizer with the results of all complete generations."""
        if self._optimizer is None:
            self._optimizer = make_optimizer(self.search, self._start)
        # A study that continues reports its former generations first, and gets the same state.
        while self._is_done(self._told, self.search.population):
            self._optimizer.tell(self._rank_generation(self._told))
            self._told += 1
        return self._optimizer

    def trials(self) -> list[Trial]:
        """Return all candidates so far, by number."""
        return [make_trial(each) for each in self.optuna.get_trials(deepcopy=False)]

    def best(self) -> Trial:
        """Return the best candidate.

        With several objectives it is the candidate of the Pareto front nearest to the least values
        of all objectives.

        Raises:
            ValueError: no candidate has a value.
        """
        trials = self.trials()
        done = [each for each in trials if each.state == "done"]
        if not done:
            raise ValueError(
                f"objective {self.search.named} has no value yet{_last_error(trials)}; accepted: "
                "a larger budget"
            )
        if len(self.search.objectives) == 1:
            return min(done, key=lambda each: (each.values[0], each.number))
        front = self.front()
        values = np.array([each.values for each in front])
        # Objectives have different units, so each is divided by its range, which may be 0.
        span = np.maximum(values.max(axis=0) - values.min(axis=0), 1e-12)
        distance = np.linalg.norm((values - values.min(axis=0)) / span, axis=1)
        return front[int(distance.argmin())]

    def front(self) -> list[Trial]:
        """Return the Pareto front: the candidates that no other candidate dominates."""
        done = [each for each in self.trials() if each.state == "done"]

        def is_beaten(one: Trial) -> bool:
            return any(
                all(a <= b for a, b in zip(other.values, one.values, strict=True))
                and other.values != one.values
                for other in done
            )

        return [each for each in done if not is_beaten(each)]

    def run(
        self,
        budget: int | None = None,
        seconds: float | None = None,
        on_progress: Callable[[SearchProgress], None] = lambda _: None,
    ) -> bool:
        """Evaluate candidates until the budget is spent; return whether it was spent.

        Every finished episode is stored at once. Ctrl-C ends the call; the same call continues,
        with the same results as without an interruption.

        Args:
            budget: number of candidates, those of former calls included.
            seconds: wall-clock time of this call after which no generation starts [s].
            on_progress: called after each episode.

        Raises:
            ValueError: no budget; an unknown metric; an objective without a value for any
                candidate.
        """
        if (budget is None and seconds is None) or (budget is not None and budget < 1):
            raise ValueError(f"budget is {budget}; accepted: a whole number >= 1, or a time")
        if budget is not None:
            _checks.positive_int("budget", budget, at_most=MOST_CANDIDATES)
        began, before = time.perf_counter(), self._num_done()
        now = SearchProgress(before, self._least(), 0.0, 0, 0)
        on_progress(now)

        def show(trials: int) -> None:
            nonlocal now
            done, best = now.num_done + trials, now.best
            if trials:
                best = self._least()
            spent = time.perf_counter() - began
            now = SearchProgress(
                done, best, spent, done - before, 0 if trials else now.num_episodes + 1
            )
            on_progress(now)

        generation, size = 0, self.search.population
        try:
            while budget is None or generation * size < budget:
                last = size if budget is None else min(size, budget - generation * size)
                if not self._is_done(generation, last):
                    # The optimizer needs complete generations, so none is cut by the time.
                    if seconds is not None and time.perf_counter() - began > seconds:
                        return True
                    numbers = self._numbers(generation, last)
                    self._generations.run(numbers, self._ask, self._limits(generation), show)
                    self._check_values()
                generation += 1
        except KeyboardInterrupt:
            return False
        return True

    def evaluate(
        self,
        numbers: Sequence[int],
        seeds: Sequence[int],
        on_progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> dict[int, dict[tuple[str, int], Numbers]]:
        """Evaluate candidates on other seeds; return their metrics by scenario and seed.

        Episodes are stored like those of the search. A failed one has no metrics.

        Args:
            numbers: numbers of the candidates, or `BEFORE`.
            seeds: seeds of the episodes in each scenario.
            on_progress: called with the number of finished episodes, and of all.

        Raises:
            KeyboardInterrupt: the user stopped it; finished episodes are stored.
        """
        trials = self.optuna.get_trials(deepcopy=False)
        instances = [(scenario, seed) for seed in seeds for scenario in self.episodes.scenarios]
        kept = self.optuna.user_attrs
        found: dict[int, dict[tuple[str, int], Numbers]] = {number: {} for number in numbers}
        missing = []
        for where in instances:
            for number in dict.fromkeys(numbers):
                stored = kept.get(_unseen(number, *where))
                if stored is None:
                    values = self.before if number == BEFORE else dict(trials[number].params)
                    missing.append(Episode(number, values, *where))
                else:
                    found[number][where] = stored["metrics"]
        total = len(instances) * len(found)

        def keep(episode: Episode, result: Result) -> None:
            where = episode.scenario, episode.seed
            stored = {"metrics": result.metrics, "error": result.error}
            self.optuna.set_user_attr(_unseen(episode.number, *where), stored)
            found[episode.number][where] = result.metrics
            on_progress(sum(map(len, found.values())), total)

        if missing:
            self.episodes.run(missing, keep)
        return {
            number: {where: some[where] for where in instances} for number, some in found.items()
        }

    def select(
        self,
        finalists: int,
        seeds: Sequence[int],
        on_progress: Callable[[int, int], None] = lambda done, total: None,
    ) -> Trial:
        """Select the best finalist on further seeds.

        The best of many candidates on few seeds is partly the luckiest. So the finalists and the
        first candidate are compared on new seeds alone. With several objectives the result is
        `best`, without further runs.

        Args:
            finalists: greatest number of finalists; never more than an eighth of the candidates.
            seeds: seeds that the search has not used.
            on_progress: called with the number of finished episodes, and of all.

        Raises:
            ValueError: no candidate has a value.
            KeyboardInterrupt: the user stopped it.
        """
        best = self.best()
        if len(self.search.objectives) > 1 or finalists <= 1 or not seeds:
            return best
        done = [each for each in self.trials() if each.state == "done"]
        distinct: dict[str, Trial] = {}
        for each in sorted(done, key=lambda each: (each.values[0], each.number)):
            # Repeated proposals would take the places of other finalists.
            distinct.setdefault(repr(each.candidate), each)
        # Few finalists after a short search: the selection must not cost more than the search.
        most = min(finalists, max(2, len(done) // SEARCHED_PER_FINALIST))
        ranked = list(distinct.values())[:most]
        # The current settings always take part, so that nothing worse than them is chosen.
        if done[0].number == 0 and done[0].candidate not in [each.candidate for each in ranked]:
            ranked.append(done[0])
        further = self.evaluate([each.number for each in ranked], seeds, on_progress)
        objective = self.search.objectives[0]

        def mean(each: Trial) -> tuple[float, int]:
            episodes = further[each.number].values()
            # A failed episode rules a candidate out.
            values = [objective.value(one) if one else math.inf for one in episodes]
            return objective.mean_of(values), each.number

        return min(ranked, key=mean)

    def _least(self) -> float:
        trials = self.optuna.get_trials(deepcopy=False)
        done = [each.values[0] for each in trials if each.state.name == "COMPLETE"]
        return min(done, default=math.inf)

    def _num_done(self) -> int:
        return sum(each.state.is_finished() for each in self.optuna.get_trials(deepcopy=False))

    def _numbers(self, generation: int, count: int | None = None) -> range:
        first = generation * self.search.population
        return range(first, first + (self.search.population if count is None else count))

    def _is_done(self, generation: int, count: int) -> bool:
        trials = self.optuna.get_trials(deepcopy=False)
        numbers = self._numbers(generation, count)
        return numbers.stop <= len(trials) and all(trials[n].state.is_finished() for n in numbers)

    def _some(self, numbers: range) -> list[Trial]:
        kept = self.optuna.get_trials(deepcopy=False)
        return [make_trial(kept[number]) for number in numbers]

    def _ask(self) -> list[Candidate]:
        return self.optimizer.ask()

    def _limits(self, generation: int) -> dict[tuple[str, int], float]:
        """Compute the times after which episodes are stopped [s], from former generations.

        Empty unless the objective contains a time.
        """
        objective, *others = self.search.objectives
        if others or not self.search.gives_up or not objective.is_about_time:
            return {}
        former = self._some(range(generation * self.search.population))
        done = [each for each in former if each.state == "done"]
        if not done:
            return {}
        best = min(done, key=lambda each: (each.values[0], each.number))
        return {
            where: HOPELESS * (metrics.get("duration") or 0.0)
            for where, metrics in best.episodes.items()
            if metrics.get("is_finished") and metrics.get("duration")
        }

    def _rank_generation(self, generation: int) -> list[Evaluated]:
        """Return a complete generation with the ranks of its candidates."""
        trials = self._some(self._numbers(generation))

        def order(each: Trial) -> tuple[float, ...]:
            if each.state == "done":
                return (0.0, 0.0, each.values[0])
            if each.state == "given up":
                # Of candidates that were given up, those that lasted for more episodes come first.
                return (1.0, -len(each.episodes), *each.values)
            return (2.0, 0.0, 0.0)

        ranked = sorted({order(each) for each in trials})
        return [
            Evaluated(
                each.candidate,
                float(ranked.index(order(each))),
                each.state,
                each.values,
                len(each.episodes),
                self._measures(each) if each.state == "done" else (),
            )
            for each in trials
        ]

    def _measures(self, trial: Trial) -> tuple[float, ...]:
        return tuple(
            Objective(((1.0, each.metric),)).mean(list(trial.episodes.values()))
            for each in self.search.measures
        )

    def _check_values(self) -> None:
        trials = [each for each in self.trials() if each.state != "running"]
        if any(each.state == "done" for each in trials):
            return
        if len(trials) >= _UNPROMISING or self._is_done(0, self.search.population):
            raise ValueError(
                f"objective {self.search.named} is not a number for any of {len(trials)} candidates"
                f"{_last_error(trials)}; accepted: metrics that the runs have"
            )


def _last_error(trials: Sequence[Trial]) -> str:
    reasons = [each.error for each in trials if each.error is not None]
    return f", the last one: {reasons[-1]}" if reasons else ""


def _unseen(number: int, scenario: str, seed: int) -> str:
    return f"{UNSEEN}{number} {scenario} {seed}"
