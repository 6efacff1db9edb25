"""Evaluation of generations of candidates. Every finished episode is stored at once."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from jaxplore._optional import import_optional
from jaxplore.study.tuning.episodes import Episode, Episodes, Result
from jaxplore.study.tuning.objective import Numbers
from jaxplore.study.tuning.search import Search
from jaxplore.study.tuning.space import Candidate, distribution
from jaxplore.study.tuning.trials import EPISODE, VERDICT, read_episodes

type Where = tuple[str, int]
"""Scenario and seed."""
type Limits = Mapping[Where, float]
"""Time after which an episode is stopped [s]."""


class Generations:
    """Evaluation of generations, one after the other; the current values are the first candidate.

    A search can be continued after an interruption at any time: candidates are stored before they
    are evaluated, episodes when finished, and the final states of a generation before any of its
    candidates is reported to Optuna.
    """

    def __init__(self, search: Search, episodes: Episodes, study: Any, start: Candidate) -> None:
        self._search, self._episodes, self._study = search, episodes, study
        self._start = start
        self._instances = [
            (scenario, seed) for seed in search.seeds for scenario in episodes.scenarios
        ]
        self._distributions = {each.name: distribution(each) for each in search.space.parameters}

    def run(
        self,
        numbers: range,
        ask: Callable[[], list[Candidate]],
        limits: Limits,
        show: Callable[[int], None],
    ) -> None:
        """Evaluate a generation, or the rest of it.

        `ask` returns its candidates if some are not stored. `show` is called with the number of
        finished ones, after each episode and at the end. After Ctrl-C finished episodes stay
        stored.
        """
        trials = self._open_trials(numbers, ask)
        known = {each.number: read_episodes(each.user_attrs) for each in trials}
        decided = {each.number for each in trials if VERDICT in each.user_attrs}
        if len(decided) < len(trials):
            self._evaluate(trials, known, limits, lambda: show(0))
        # In the order of numbers, not of completion: the next generation depends on the order.
        for each in trials:
            self._tell(each, known[each.number])
        show(len(trials))

    def _evaluate(
        self,
        trials: Sequence[Any],
        known: dict[int, dict[Where, Any]],
        limits: Limits,
        show: Callable[[], None],
    ) -> None:
        """Run the missing episodes, and store the final state of each candidate."""
        # With early stops the episodes run rung by rung, and bad candidates are dropped in between.
        one_by_one = self._search.gives_up and len(self._search.objectives) == 1
        rungs = [[each] for each in self._instances] if one_by_one else [self._instances]
        by_number = {each.number: each for each in trials}
        verdicts = {each.number: ["done", None] for each in trials}

        def keep(episode: Episode, result: Result) -> None:
            is_cut = episode.time_limit is not None and not result.metrics.get("is_finished")
            stored = {"metrics": result.metrics, "error": result.error, "is_cut": is_cut}
            name = f"{EPISODE}{episode.scenario} {episode.seed}"
            by_number[episode.number].set_user_attr(name, stored)
            known[episode.number][episode.scenario, episode.seed] = stored
            show()

        alive = list(trials)
        for index, rung in enumerate(rungs):
            missing = [
                Episode(each.number, dict(each.params), *where, limits.get(where))
                for where in rung
                for each in alive
                if where not in known[each.number]
            ]
            if missing:
                self._episodes.run(missing, keep)
            so_far = [where for some in rungs[: index + 1] for where in some]
            is_last = index == len(rungs) - 1
            for each in tuple(alive):
                verdict = self._verdict(each, known, so_far, is_last=is_last)
                if verdict is not None:
                    verdicts[each.number] = verdict
                    alive.remove(each)
        # All states are stored before the first candidate is reported: after an interruption no
        # decision is made twice.
        for each in trials:
            each.set_user_attr(VERDICT, verdicts[each.number])

    def _verdict(
        self,
        trial: Any,
        known: Mapping[int, dict[Where, Any]],
        so_far: Sequence[Where],
        *,
        is_last: bool,
    ) -> list[str | None] | None:
        """Decide on a candidate: its final state and error, or None to continue."""
        stored = [known[trial.number][where] for where in so_far]
        for each in stored:
            if each["error"] is not None:
                return ["failed", each["error"]]
        means = [
            objective.mean([each["metrics"] for each in stored])
            for objective in self._search.objectives
        ]
        if not all(map(math.isfinite, means)):
            return ["failed", f"objective {self._search.named} is not a number"]
        if any(each["is_cut"] for each in stored):
            return ["given up", None]
        if not self._search.gives_up or len(self._search.objectives) > 1 or is_last:
            return None
        # After an interruption this rung may be reported already.
        step = len(so_far) - 1
        if step not in _read_reports(self._study, trial.number):
            trial.report(means[0] - self._reference(known, so_far), step)
        # The current settings are always evaluated completely: they are the reference.
        if trial.number != 0 and trial.should_prune():
            return ["given up", None]
        return None

    def _reference(self, known: Mapping[int, dict[Where, Any]], so_far: Sequence[Where]) -> float:
        """Compute the mean objective of the current settings over some episodes.

        Differences from it do not depend on the difficulty of the episodes.
        """
        trials = self._study.get_trials(deepcopy=False)
        # Only the first generation holds the current settings; later ones read them from the study.
        first = known.get(0) or read_episodes(trials[0].user_attrs)
        stored = [first[where]["metrics"] for where in so_far if where in first]
        # Without all of these episodes the objectives are compared as they are.
        mean = self._search.objectives[0].mean(stored) if len(stored) == len(so_far) else 0.0
        return mean if math.isfinite(mean) else 0.0

    def _tell(self, trial: Any, known: Mapping[Where, Any]) -> None:
        states = import_optional("optuna.trial", "tuning").TrialState
        state, error = trial.user_attrs[VERDICT]
        episodes = [known[each] for each in self._instances if each in known]
        stored: list[Numbers] = [each["metrics"] for each in episodes]
        if state == "failed":
            trial.set_user_attr("error", error)
            self._study.tell(trial.number, state=states.FAIL)
        elif state == "given up":
            trial.set_user_attr("value", self._search.objectives[0].mean(stored))
            self._study.tell(trial.number, state=states.PRUNED)
        else:
            values = [objective.mean(stored) for objective in self._search.objectives]
            self._study.tell(trial.number, values)

    def _open_trials(self, numbers: range, ask: Callable[[], list[Candidate]]) -> list[Any]:
        """Return the unfinished trials of a generation, and create missing ones."""
        trials = import_optional("optuna.trial", "tuning")
        there = self._study.get_trials(deepcopy=False)
        asked: list[Candidate] | None = None
        opened = []
        for number in numbers:
            state = there[number].state if number < len(there) else None
            if state is not None and state.is_finished():
                continue
            if state == trials.TrialState.RUNNING:
                trial = trials.Trial(self._study, there[number]._trial_id)
                # After an interruption some parameters may not be set yet; their values were fixed
                # by `enqueue_trial`.
                for name, each in self._distributions.items():
                    trial._suggest(name, each)
                opened.append(trial)
                continue
            if state is None:
                if asked is None:
                    # Asking replays all former generations, so it is done only for a new candidate.
                    asked = ask()
                    # The very first candidate is the current settings, the reference of all others.
                    asked[0] = self._start if numbers.start == 0 else asked[0]
                # Enqueued values are what Optuna's `ask` then returns, instead of drawing its own.
                self._study.enqueue_trial(asked[number - numbers.start])
            trial = self._study.ask(self._distributions)
            assert trial.number == number
            opened.append(trial)
        return opened


def _read_reports(study: Any, number: int) -> Mapping[int, float]:
    found: Mapping[int, float] = study.get_trials(deepcopy=False)[number].intermediate_values
    return found
