"""Episodes: where settings are tried out."""

import abc
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from jaxplore.study.tuning.space import Candidate, Value


class Ask(NamedTuple):
    """An episode that is to be run.

    Args:
        number: of the candidate.
        candidate: its values.
        scenario: name of the scenario.
        seed: of everything random: the same for all candidates, common random numbers.
        time_limit: simulated time after which it is hopeless [s]; the scenario's own when absent.
    """

    number: int
    candidate: Candidate
    scenario: str
    seed: int
    time_limit: float | None = None


class Outcome(NamedTuple):
    """What came of an episode.

    Args:
        metrics: numbers of its report by dotted name; None for what has no value.
        error: why it failed; None if it did not.
    """

    metrics: dict[str, float | None]
    error: str | None = None


class Episodes(abc.ABC):
    """Scenarios in which candidates are tried out.

    To tune something else than a run of jaxplore, give a function: `FunctionEpisodes`,
    `VectorEpisodes`.
    """

    @property
    @abc.abstractmethod
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios."""

    @abc.abstractmethod
    def start(self, name: str) -> Value:
        """Return what a parameter is now.

        Raises:
            ValueError: a name that is none; the nearest ones are named.
        """

    def elements(self, name: str) -> tuple[str, ...]:
        """Return the names of the single values that a name stands for: those of an array."""
        return (name,)

    @abc.abstractmethod
    def run(self, asks: Sequence[Ask], on_done: Callable[[Ask, Outcome], None]) -> None:
        """Run episodes, and tell of each as soon as it is done.

        One that fails is told with its error. What fails for a reason that is the user's to mend,
        not the candidate's, raises.

        Raises:
            KeyboardInterrupt: the user stopped it.
        """

    @abc.abstractmethod
    def describe(self) -> dict[str, Any]:
        """Return what the results depend on, in plain values that JSON can hold: a study goes on
        only where it is the same."""
