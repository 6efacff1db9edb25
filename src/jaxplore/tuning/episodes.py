"""Episodes: where settings are tried out."""

import abc
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxplore._types import Key
from jaxplore.control.leaves import nearest
from jaxplore.tuning.objective import flat
from jaxplore.tuning.space import Candidate, Value


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


class FunctionEpisodes(Episodes):
    """Episodes that a function runs, one after the other: any simulator, any language.

    Args:
        function: from a candidate and a seed to metrics, by name.
        start: the values that there are now, by the names of the parameters.
        name: of the scenario.
    """

    def __init__(
        self,
        function: Callable[[Candidate, int], Mapping[str, Any]],
        start: Mapping[str, Value],
        name: str = "function",
    ) -> None:
        self._function, self._start, self._name = function, dict(start), name

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Its name."""
        return (self._name,)

    def start(self, name: str) -> Value:
        """Return what a parameter is now."""
        return _known(name, self._start)

    def run(self, asks: Sequence[Ask], on_done: Callable[[Ask, Outcome], None]) -> None:
        """Call the function for each."""
        for ask in asks:
            try:
                outcome = Outcome(flat(self._function(dict(ask.candidate), ask.seed)))
            except Exception as error:
                outcome = Outcome({}, f"{type(error).__name__}: {error}")
            on_done(ask, outcome)

    def describe(self) -> dict[str, Any]:
        """Return its name, and what there was to begin with."""
        return {"function": self._name, "start": dict(sorted(self._start.items()))}


class VectorEpisodes(Episodes):
    """Episodes that a JAX function runs, a batch of candidates in one `jax.vmap`.

    Args:
        function: from numbers by name, each a scalar array, and a key to metrics, scalar arrays by
            name. It is traced once.
        start: the numbers that there are now, by the names of the parameters.
        name: of the scenario.
        batch: candidates side by side; always as many, fewer are filled up, so that nothing
            compiles anew and rounding does not depend on how many are left to do.

    Raises:
        ValueError: a batch < 1.
    """

    def __init__(
        self,
        function: Callable[[dict[str, Array], Key], Mapping[str, Array]],
        start: Mapping[str, float],
        name: str = "function",
        batch: int = 8,
    ) -> None:
        if batch < 1:
            raise ValueError(f"batch is {batch}; accepted: a whole number >= 1")
        self._start, self._name, self._batch = dict(start), name, batch

        @eqx.filter_jit
        def together(values: dict[str, Array], key: Key) -> dict[str, Array]:
            return jax.vmap(lambda each: dict(function(each, key)))(values)

        self._together = together

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Its name."""
        return (self._name,)

    def start(self, name: str) -> Value:
        """Return what a parameter is now."""
        return _known(name, self._start)

    def run(self, asks: Sequence[Ask], on_done: Callable[[Ask, Outcome], None]) -> None:
        """Run those that have the same seed side by side."""
        seeds: dict[int, list[Ask]] = {}
        for ask in asks:
            seeds.setdefault(ask.seed, []).append(ask)
        for seed, alike in seeds.items():
            for first in range(0, len(alike), self._batch):
                self._run(alike[first : first + self._batch], seed, on_done)

    def _run(self, asks: list[Ask], seed: int, on_done: Callable[[Ask, Outcome], None]) -> None:
        padded = asks + [asks[-1]] * (self._batch - len(asks))
        values = {
            name: jnp.asarray([float(ask.candidate[name]) for ask in padded], jnp.float32)
            for name in asks[0].candidate
        }
        found = jax.device_get(self._together(values, jax.random.key(seed)))
        for i, ask in enumerate(asks):
            on_done(ask, Outcome(flat({name: float(column[i]) for name, column in found.items()})))

    def describe(self) -> dict[str, Any]:
        """Return its name, and what there was to begin with."""
        return {"function": self._name, "start": dict(sorted(self._start.items()))}


def _known(name: str, start: Mapping[str, Value]) -> Value:
    if name not in start:
        raise ValueError(f"parameter {name} is not known; accepted: {nearest(name, start)}")
    return start[name]
