"""Episodes, in which candidates are evaluated."""

import abc
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from jaxplore.report.recording import Recording
from jaxplore.simulation.experiment import Experiment
from jaxplore.study.episode import EpisodeTask, one_line
from jaxplore.study.experiments import SideBySide, in_batches, record_alone
from jaxplore.study.tuning.objective import flat, with_late_times
from jaxplore.study.tuning.space import Candidate, Value


class Episode(NamedTuple):
    """One run of a candidate in a scenario with a seed.

    Args:
        number: number of the candidate.
        candidate: value of each parameter.
        scenario: name of the scenario.
        seed: seed of all random numbers, the same for all candidates (common random numbers).
        time_limit: simulated time after which the run is stopped [s]; the scenario's own when
            absent.
    """

    number: int
    candidate: Candidate
    scenario: str
    seed: int
    time_limit: float | None = None


class Result(NamedTuple):
    """Result of an episode.

    Args:
        metrics: metrics of the run by dotted name; None for a metric without a value.
        error: reason of a failure; None if it did not fail.
    """

    metrics: dict[str, float | None]
    error: str | None = None


class Episodes(abc.ABC):
    """The protocol of the scenarios in which candidates are evaluated.

    To tune something other than a jaxplore run, pass a function to `FunctionEpisodes` or
    `VectorEpisodes`.
    """

    @property
    @abc.abstractmethod
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios."""

    @abc.abstractmethod
    def start(self, name: str) -> Value:
        """Return the current value of a parameter.

        Raises:
            ValueError: an unknown name; the message names similar ones.
        """

    @property
    def metrics(self) -> tuple[str, ...] | None:
        """Names of the metrics of an episode, if they are known in advance.

        A name that ends with a dot stands for all metrics that begin with it.
        """
        return None

    @property
    def default_objective(self) -> str | None:
        """Objective to minimize by default; None if one must be given."""
        return None

    def elements(self, name: str) -> tuple[str, ...]:
        """Return the names of a parameter's scalar values: one for each element of an array."""
        return (name,)

    @abc.abstractmethod
    def run(
        self, episodes: Sequence[Episode], on_result: Callable[[Episode, Result], None]
    ) -> None:
        """Run episodes, and report each one as soon as it is finished.

        A failed episode is reported with its error. An error that the user must fix is raised.

        Raises:
            KeyboardInterrupt: the user stopped it.
        """

    @abc.abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return everything that the results depend on, as plain values for JSON.

        A study can be continued only if it is unchanged.
        """


@dataclasses.dataclass(frozen=True, kw_only=True)
class MetricsTask(EpisodeTask):
    """A task that runs episodes of several candidates with the same scenario, seed and sizes, by
    `together`, or one after the other. `build`, which other processes import by name, makes the
    experiment of an episode from it and from the setting that locates the map or path."""

    episodes: tuple[Episode, ...]
    build: Callable[[Episode, Mapping[str, Any]], Experiment]
    together: SideBySide | None = None

    def measure(self) -> tuple[Result, ...]:
        """Run the episodes and return their metrics. A failure affects one episode only."""
        results: dict[int, Result] = {}
        ready: dict[int, Experiment] = {}
        for index, episode in enumerate(self.episodes):
            try:
                ready[index] = self.build(episode, self.location)
            except Exception as error:
                results[index] = Result({}, self._with_user_path(one_line(error)))
        results |= self._side_by_side(ready) or self._one_by_one(ready)
        return tuple(results[index] for index in range(len(self.episodes)))

    def make_failure(self, reason: str) -> tuple[Result, ...]:
        """Return a failed result for each episode."""
        return (Result({}, reason),) * len(self.episodes)

    def _side_by_side(self, ready: Mapping[int, Experiment]) -> dict[int, Result]:
        """Run experiments as a batch; return no results if that is not possible."""
        if self.together is None or not ready:
            return {}
        # All episodes of a task have the same time limit, see `make_tasks`.
        limit = self.episodes[0].time_limit
        try:
            recordings = self.together.record(self.scenario, list(ready.values()), limit)
        except ValueError:
            return {}  # They differ in more than numbers.
        pairs = zip(ready.items(), recordings, strict=True)
        return {
            index: _result(recording, self.episodes[index].seed, experiment)
            for (index, experiment), recording in pairs
        }

    def _one_by_one(self, ready: Mapping[int, Experiment]) -> dict[int, Result]:
        results = {}
        for index, experiment in ready.items():
            episode = self.episodes[index]
            try:
                recording = record_alone(experiment, episode.time_limit)
                results[index] = _result(recording, episode.seed, experiment)
            except Exception as error:
                results[index] = Result({}, one_line(error))
        return results


def make_tasks(
    episodes: Sequence[Episode],
    build: Callable[[Episode, Mapping[str, Any]], Experiment],
    batch: int,
    together: SideBySide | None,
) -> list[MetricsTask]:
    """Group episodes into tasks; a task has up to `batch` of them if they can run as a batch."""

    def group_key(episode: Episode) -> tuple[Any, ...]:
        return episode.scenario, episode.seed, episode.time_limit, _sizes(episode.candidate)

    return [
        MetricsTask(
            name=f"{some[0].number} {some[0].scenario} {some[0].seed}",
            variant=_sizes(some[0].candidate),
            scenario=some[0].scenario,
            episodes=tuple(some),
            build=build,
            together=together,
        )
        for some in in_batches(episodes, group_key, batch)
    ]


def report_each(
    on_result: Callable[[Episode, Result], None],
) -> Callable[[MetricsTask, Sequence[Result]], None]:
    """Return a callback that reports the episodes of a task one by one."""

    def report(task: MetricsTask, results: Sequence[Result]) -> None:
        for episode, result in zip(task.episodes, results, strict=True):
            on_result(episode, result)

    return report


def _sizes(candidate: Candidate) -> str:
    """Return the values that may change the compiled program: all except real numbers."""
    return repr([(name, each) for name, each in candidate.items() if not isinstance(each, float)])


def _result(recording: Recording, seed: int, experiment: Experiment) -> Result:
    # Missing times are computed for the scenario's own limit, so that a run that was stopped
    # early and one that was not are comparable.
    limit = experiment.num_steps * recording.control_period
    return Result(with_late_times(flat(recording.metrics(seed=seed).as_dict()), limit))
