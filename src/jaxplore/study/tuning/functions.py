"""Episodes of functions: any simulator, or a loop in JAX."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxplore._types import Key
from jaxplore.parameters import nearest
from jaxplore.study.tuning.episodes import Ask, Episodes, Outcome
from jaxplore.study.tuning.objective import flat
from jaxplore.study.tuning.space import Candidate, Value


class _Named(Episodes):
    """One scenario with a name, and the values that there are."""

    def __init__(self, start: Mapping[str, Value], name: str) -> None:
        self._start, self._name = dict(start), name

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Its name."""
        return (self._name,)

    def start(self, name: str) -> Value:
        """Return what a parameter is now."""
        if name not in self._start:
            raise ValueError(
                f"parameter {name} is not known; accepted: {nearest(name, self._start)}"
            )
        return self._start[name]

    def describe(self) -> dict[str, Any]:
        """Return its name, and what there was to begin with."""
        return {"function": self._name, "start": dict(sorted(self._start.items()))}


class FunctionEpisodes(_Named):
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
        super().__init__(start, name)
        self._function = function

    def run(self, asks: Sequence[Ask], on_done: Callable[[Ask, Outcome], None]) -> None:
        """Call the function for each."""
        for ask in asks:
            try:
                outcome = Outcome(flat(self._function(dict(ask.candidate), ask.seed)))
            except Exception as error:
                outcome = Outcome({}, f"{type(error).__name__}: {error}")
            on_done(ask, outcome)


class VectorEpisodes(_Named):
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
        super().__init__(start, name)
        self._batch = batch

        @eqx.filter_jit
        def together(values: dict[str, Array], key: Key) -> dict[str, Array]:
            return jax.vmap(lambda each: dict(function(each, key)))(values)

        self._together = together

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
