"""Runs that are ready to start, and how they are run here."""

from collections.abc import Callable, Sequence
from typing import Any

from jaxplore.report.recording import Recording
from jaxplore.simulation.batch import record_experiments
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.run import record_run
from jaxplore.simulation.stacking import Places
from jaxplore.study.tuning.episodes import Ask, Outcome
from jaxplore.study.tuning.objective import flat, with_late_times


def run_alone(built: Experiment, seed: int, time_limit: float | None) -> Outcome:
    """Run an episode and return its report.

    Raises:
        KeyboardInterrupt: the user stopped it.
    """
    steps = _steps(built, time_limit)
    recording = record_run(
        built.controller, built.scenario, steps, key=built.key, num_trajectories=0
    )
    return _outcome(recording, seed, built)


def run_together(
    runs: Sequence[Experiment],
    seeds: Sequence[int],
    time_limit: float | None,
    differs: Places | None,
) -> tuple[list[Outcome], Places]:
    """Run episodes side by side and return their reports; see `record_experiments`.

    Raises:
        ValueError: controllers that differ in more than numbers.
        KeyboardInterrupt: the user stopped them.
    """
    steps = max(_steps(one, time_limit) for one in runs)
    recordings, found = record_experiments(runs, steps, with_frames=False, differs=differs)
    reports = zip(recordings, seeds, runs, strict=True)
    return [_outcome(recording, seed, one) for recording, seed, one in reports], found


def _steps(built: Experiment, time_limit: float | None) -> int:
    if time_limit is None:
        return built.num_steps
    period = float(built.scenario.control_period)
    return max(1, min(built.num_steps, round(time_limit / period)))


def _outcome(recording: Recording, seed: int, built: Experiment) -> Outcome:
    if recording.is_interrupted:
        raise KeyboardInterrupt
    report = recording.metrics(seed=seed)
    # As late as if it had gone on to the scenario's own limit: cut short or not is no difference.
    limit = built.num_steps * recording.control_period
    return Outcome(with_late_times(flat(report.as_dict()), limit))


class Runner:
    """Builds and runs episodes here, one after the other or a batch at a time.

    Args:
        build: makes what is run; a ValueError is the candidate's failure.
        batch: episodes side by side at most; those of one scenario, seed and limit, whose
            candidates have the same sizes and choices.

    Raises:
        ValueError: a batch < 1.
    """

    def __init__(self, build: Callable[[Ask], Experiment], batch: int) -> None:
        if batch < 1:
            raise ValueError(f"batch is {batch}; accepted: a whole number >= 1")
        self._build, self._batch = build, batch
        self._differs: dict[str, Places] = {}
        """Which arrays of a scenario's runs have differed so far."""

    def run(self, asks: Sequence[Ask], on_done: Callable[[Ask, Outcome], None]) -> None:
        """Run episodes, and tell of each as soon as it is done."""
        for some in _alike(asks):
            for first in range(0, len(some), self._batch):
                self._run_group(some[first : first + self._batch], on_done)

    def _run_group(self, asks: Sequence[Ask], on_done: Callable[[Ask, Outcome], None]) -> None:
        ready: list[tuple[Ask, Experiment]] = []
        for ask in asks:
            try:
                ready.append((ask, self._build(ask)))
            except ValueError as error:
                on_done(ask, Outcome({}, str(error)))
        if self._batch > 1 and ready:
            try:
                outcomes = self._run_together(ready)
            except ValueError:
                pass  # They differ in more than numbers: one after the other then.
            else:
                for (ask, _), outcome in zip(ready, outcomes, strict=False):
                    on_done(ask, outcome)
                return
        for ask, built in ready:
            try:
                outcome = run_alone(built, ask.seed, ask.time_limit)
            except Exception as error:
                outcome = Outcome({}, f"{type(error).__name__}: {error}")
            on_done(ask, outcome)

    def _run_together(self, ready: Sequence[tuple[Ask, Experiment]]) -> list[Outcome]:
        # Always as many: another number would be another program.
        padded = [*ready, *[ready[-1]] * (self._batch - len(ready))]
        first = ready[0][0]
        outcomes, self._differs[first.scenario] = run_together(
            [built for _, built in padded],
            [ask.seed for ask, _ in padded],
            first.time_limit,
            self._differs.get(first.scenario),
        )
        return outcomes


def _alike(asks: Sequence[Ask]) -> list[list[Ask]]:
    """Return the episodes that could run side by side, together."""
    groups: dict[tuple[Any, ...], list[Ask]] = {}
    for ask in asks:
        sizes = tuple(
            (name, value) for name, value in ask.candidate.items() if not isinstance(value, float)
        )
        groups.setdefault((ask.scenario, ask.seed, ask.time_limit, sizes), []).append(ask)
    return list(groups.values())
