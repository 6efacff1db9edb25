"""Tries out a generation of candidates, and keeps every episode as soon as it is done."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from jaxplore.study.tuning.episodes import Ask, Episodes, Outcome
from jaxplore.study.tuning.objective import Numbers
from jaxplore.study.tuning.search import Search
from jaxplore.study.tuning.space import Candidate, distribution
from jaxplore.study.tuning.trials import EPISODE, VERDICT, episodes_of
from jaxplore.study.workers.packages import package

type Where = tuple[str, int]
"""Scenario and seed."""
type Limits = Mapping[Where, float]
"""After what time an episode is hopeless [s]."""


class Generations:
    """Tries out generations, one after the other.

    What is kept is enough to go on from any moment: candidates are kept before they are tried out,
    episodes when they are done, and what follows from the episodes of a generation before any of
    its candidates counts as done.

    Args:
        search: what is searched for.
        episodes: where candidates are tried out.
        study: of Optuna, which keeps them.
        start: the values that there were before, the first candidate.
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
        """Try out a generation, or what is left of it.

        Args:
            numbers: of its candidates.
            ask: returns them, the first of a whole generation first; called if some are missing.
            limits: after what time an episode is hopeless.
            show: told the number of candidates that are done, after each episode and at the end.

        Raises:
            KeyboardInterrupt: the user stopped it; what was done is kept.
        """
        trials = self._opened(numbers, ask)
        known = {each.number: episodes_of(each.user_attrs) for each in trials}
        decided = {each.number for each in trials if VERDICT in each.user_attrs}
        if len(decided) < len(trials):
            self._try_out(trials, known, limits, lambda: show(0))
        # In their order, whoever was first: the next generation sees them in this one.
        for each in trials:
            self._tell(each, known[each.number])
        show(len(trials))

    def _try_out(
        self,
        trials: Sequence[Any],
        known: dict[int, dict[Where, Any]],
        limits: Limits,
        show: Callable[[], None],
    ) -> None:
        """Run the episodes that are missing, and keep what became of each candidate."""
        one_by_one = self._search.gives_up and len(self._search.objectives) == 1
        rungs = [[each] for each in self._instances] if one_by_one else [self._instances]
        by_number = {each.number: each for each in trials}
        verdicts = {each.number: ["done", None] for each in trials}

        def keep(ask: Ask, outcome: Outcome) -> None:
            is_cut = ask.time_limit is not None and not outcome.metrics.get("is_finished")
            told = {"metrics": outcome.metrics, "error": outcome.error, "is_cut": is_cut}
            by_number[ask.number].set_user_attr(f"{EPISODE}{ask.scenario} {ask.seed}", told)
            known[ask.number][ask.scenario, ask.seed] = told
            show()

        alive = list(trials)
        for index, rung in enumerate(rungs):
            asks = [
                Ask(each.number, dict(each.params), *where, limits.get(where))
                for where in rung
                for each in alive
                if where not in known[each.number]
            ]
            if asks:
                self._episodes.run(asks, keep)
            so_far = [where for some in rungs[: index + 1] for where in some]
            is_last = index == len(rungs) - 1
            for each in tuple(alive):
                verdict = self._verdict(each, known, so_far, is_last=is_last)
                if verdict is not None:
                    verdicts[each.number] = verdict
                    alive.remove(each)
        # All before the first of them counts: whoever goes on from here decides nothing anew.
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
        """Return why a candidate is not tried out any further: its state, and an error."""
        told = [known[trial.number][where] for where in so_far]
        for each in told:
            if each["error"] is not None:
                return ["failed", each["error"]]
        means = [
            objective.mean([each["metrics"] for each in told])
            for objective in self._search.objectives
        ]
        if not all(map(math.isfinite, means)):
            return ["failed", f"objective {self._search.named} is not a number"]
        if any(each["is_cut"] for each in told):
            return ["given up", None]
        if not self._search.gives_up or len(self._search.objectives) > 1 or is_last:
            return None
        step = len(so_far) - 1
        if step not in _reported(self._study, trial.number):
            trial.report(means[0] - self._reference(known, so_far), step)
        # What there was before is seen to the end, to be compared with.
        if trial.number != 0 and trial.should_prune():
            return ["given up", None]
        return None

    def _reference(self, known: Mapping[int, dict[Where, Any]], so_far: Sequence[Where]) -> float:
        """Return the mean of what there was before: easy and hard episodes count alike then."""
        trials = self._study.get_trials(deepcopy=False)
        first = known.get(0) or episodes_of(trials[0].user_attrs)
        told = [first[where]["metrics"] for where in so_far if where in first]
        mean = self._search.objectives[0].mean(told) if len(told) == len(so_far) else 0.0
        return mean if math.isfinite(mean) else 0.0

    def _tell(self, trial: Any, known: Mapping[Where, Any]) -> None:
        states = package("optuna.trial", "tuning").TrialState
        state, error = trial.user_attrs[VERDICT]
        told: list[Numbers] = [known[each]["metrics"] for each in self._instances if each in known]
        if state == "failed":
            trial.set_user_attr("error", error)
            self._study.tell(trial.number, state=states.FAIL)
        elif state == "given up":
            trial.set_user_attr("value", self._search.objectives[0].mean(told))
            self._study.tell(trial.number, state=states.PRUNED)
        else:
            values = [objective.mean(told) for objective in self._search.objectives]
            self._study.tell(trial.number, values)

    def _opened(self, numbers: range, ask: Callable[[], list[Candidate]]) -> list[Any]:
        """Return the trials of a generation that are not finished, made if they are not there."""
        trials = package("optuna.trial", "tuning")
        there = self._study.get_trials(deepcopy=False)
        asked: list[Candidate] | None = None
        opened = []
        for number in numbers:
            state = there[number].state if number < len(there) else None
            if state is not None and state.is_finished():
                continue
            if state == trials.TrialState.RUNNING:
                trial = trials.Trial(self._study, there[number]._trial_id)
                # It may have been cut off between two of them; they were fixed beforehand.
                for name, each in self._distributions.items():
                    trial._suggest(name, each)
                opened.append(trial)
                continue
            if state is None:
                if asked is None:
                    asked = ask()
                    asked[0] = self._start if numbers.start == 0 else asked[0]
                self._study.enqueue_trial(asked[number - numbers.start])
            trial = self._study.ask(self._distributions)
            assert trial.number == number
            opened.append(trial)
        return opened


def _reported(study: Any, number: int) -> Mapping[int, float]:
    found: Mapping[int, float] = study.get_trials(deepcopy=False)[number].intermediate_values
    return found
