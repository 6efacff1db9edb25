"""Episodes that call a function: any simulator, or a loop in JAX."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxplore import _checks
from jaxplore._types import Key
from jaxplore.parameters import nearest
from jaxplore.study.experiments import in_batches
from jaxplore.study.tuning.episodes import Episode, Episodes, Result
from jaxplore.study.tuning.objective import flat
from jaxplore.study.tuning.space import Candidate, Value


class _Named(Episodes):
    """Base of episodes with one named scenario and the current values of the parameters."""

    def __init__(self, start: Mapping[str, Value], name: str) -> None:
        self._start, self._name = dict(start), name

    @property
    def scenarios(self) -> tuple[str, ...]:
        return (self._name,)

    def start(self, name: str) -> Value:
        if name not in self._start:
            raise ValueError(
                f"parameter {name} is not known; accepted: {nearest(name, self._start)}"
            )
        return self._start[name]

    def describe(self) -> dict[str, Any]:
        return {"function": self._name, "start": dict(sorted(self._start.items()))}


class FunctionEpisodes(_Named):
    """Episodes that call a function one after the other; it may use any simulator.

    Args:
        function: function from a candidate and a seed to metrics by name.
        start: current values by parameter.
        name: name of the scenario.
    """

    def __init__(
        self,
        function: Callable[[Candidate, int], Mapping[str, Any]],
        start: Mapping[str, Value],
        name: str = "function",
    ) -> None:
        super().__init__(start, name)
        self._function = function

    def run(
        self, episodes: Sequence[Episode], on_result: Callable[[Episode, Result], None]
    ) -> None:
        """Call the function for each episode."""
        for episode in episodes:
            try:
                result = Result(flat(self._function(dict(episode.candidate), episode.seed)))
            except Exception as error:
                result = Result({}, f"{type(error).__name__}: {error}")
            on_result(episode, result)


class VectorEpisodes(_Named):
    """Episodes that call a JAX function, with a batch of candidates in one `jax.vmap`.

    Args:
        function: function from scalar arrays by parameter name, and a key, to metrics: scalar
            arrays by name. It is traced once.
        start: current numbers by parameter.
        name: name of the scenario.
        batch: number of candidates in a batch. Smaller batches are filled up, so that nothing is
            compiled again and rounding does not depend on the number of candidates left.

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
        super().__init__(start, name)
        self._batch = _checks.positive_int("batch", batch)

        # The function is wrapped once: a new wrapper for every call would compile again.
        @eqx.filter_jit
        def together(values: dict[str, Array], key: Key) -> dict[str, Array]:
            return jax.vmap(lambda each: dict(function(each, key)))(values)

        self._together = together

    def run(
        self, episodes: Sequence[Episode], on_result: Callable[[Episode, Result], None]
    ) -> None:
        """Run episodes with the same seed as batches."""
        for some in in_batches(episodes, lambda episode: episode.seed, self._batch):
            self._run(some, some[0].seed, on_result)

    def _run(
        self, episodes: list[Episode], seed: int, on_result: Callable[[Episode, Result], None]
    ) -> None:
        padded = episodes + [episodes[-1]] * (self._batch - len(episodes))
        values = {
            name: jnp.asarray([float(episode.candidate[name]) for episode in padded], jnp.float32)
            for name in episodes[0].candidate
        }
        found = jax.device_get(self._together(values, jax.random.key(seed)))
        for i, episode in enumerate(episodes):
            on_result(
                episode, Result(flat({name: float(column[i]) for name, column in found.items()}))
            )
