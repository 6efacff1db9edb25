"""Optimisers of other libraries: where to look next."""

import abc
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxplore.study.tuning.space import Candidate, Space, distribution
from jaxplore.study.workers.packages import package

STEP = 0.2
"""First standard deviation of evolution strategies, in sides of the cube."""

EVOSAX = {
    "cma-es": "CMA_ES",
    "sep-cma-es": "Sep_CMA_ES",
    "open-es": "Open_ES",
    "snes": "SNES",
    "cr-fm-nes": "CR_FM_NES",
    "pgpe": "PGPE",
}
"""Evolution strategies of evosax, by the names that they have here."""
OPTUNA = ("tpe", "random", "nsga-ii", "qmc")
"""Samplers of Optuna."""
PYRIBS = ("cma-me",)
"""Quality diversity of pyribs."""
NAMES = (*OPTUNA, *EVOSAX, *PYRIBS)


class Scored(NamedTuple):
    """A candidate that has been tried out.

    Args:
        candidate: its values.
        rank: 0 of the best of its generation; those given up early and those that failed are last.
        state: "done", "given up" or "failed".
        values: of the objectives; none of one that failed.
        num_episodes: that it was tried out in.
        measures: what quality diversity spreads over.
    """

    candidate: Candidate
    rank: float
    state: str
    values: tuple[float, ...]
    num_episodes: int
    measures: tuple[float, ...] = ()


class Strategy(abc.ABC):
    """Proposes generations of candidates.

    It draws everything random from its seed and the number of the generation. So a study that is
    taken up again tells it the former generations and goes on as if nothing had happened.
    """

    @abc.abstractmethod
    def ask(self) -> list[Candidate]:
        """Return the candidates of the next generation."""

    @abc.abstractmethod
    def tell(self, generation: Sequence[Scored]) -> None:
        """Learn what came of the candidates; the first of all was replaced by the start."""


class Sampling(Strategy):
    """A sampler of Optuna, for spaces with choices and for several objectives.

    Source: Akiba, Sano, Yanase, Ohta, Koyama, "Optuna: a next-generation hyperparameter
    optimization framework", KDD 2019.

    Args:
        name: see `OPTUNA`.
        space: what is searched.
        population: candidates in a generation.
        seed: the same gives the same candidates.
        num_objectives: how many there are.

    Raises:
        ValueError: Optuna is not installed.
    """

    def __init__(
        self, name: str, space: Space, population: int, seed: int, num_objectives: int
    ) -> None:
        optuna = package("optuna", "tuning")
        self._name, self._space, self._population, self._seed = name, space, population, seed
        self._distributions = {each.name: distribution(each) for each in space.parameters}
        # Of its own, in memory: it draws faster there, and what is kept need not know of it.
        self._study = optuna.create_study(directions=["minimize"] * num_objectives)
        self._states = optuna.trial.TrialState
        self._asked: list[Any] = []
        self._told = 0

    def ask(self) -> list[Candidate]:
        """Return the candidates of the next generation."""
        while len(self._asked) < self._population:
            self._study.sampler = self._sampler(self._told + len(self._asked))
            self._asked.append(self._study.ask(self._distributions))
        return [dict(each.params) for each in self._asked]

    def tell(self, generation: Sequence[Scored]) -> None:
        """Tell values, also of candidates that were given up."""
        self.ask()
        for trial, each in zip(self._asked, generation, strict=True):
            if trial.params != each.candidate:
                # The start, in place of what was asked for.
                self._study.tell(trial, state=self._states.FAIL)
                if each.state == "done":
                    self._study.add_trial(self._done(each))
            elif each.state == "done":
                self._study.tell(trial, list(each.values))
            elif each.state == "given up":
                trial.report(each.values[0], each.num_episodes)
                self._study.tell(trial, state=self._states.PRUNED)
            else:
                self._study.tell(trial, state=self._states.FAIL)
        self._told += len(generation)
        self._asked = []

    def _done(self, each: Scored) -> Any:
        return package("optuna.trial", "tuning").create_trial(
            params=each.candidate, distributions=self._distributions, values=list(each.values)
        )

    def _sampler(self, number: int) -> Any:
        samplers = package("optuna.samplers", "tuning")
        # Fresh from the seed and the number: a study that is taken up again draws the same.
        seed = int(np.random.SeedSequence([self._seed, number]).generate_state(1)[0])
        if self._name == "tpe":
            return samplers.TPESampler(seed=seed, n_startup_trials=max(10, self._population))
        if self._name == "nsga-ii":
            return samplers.NSGAIISampler(seed=seed, population_size=self._population)
        if self._name == "qmc":
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # that it is experimental
                return samplers.QMCSampler(seed=self._seed, scramble=True)
        return samplers.RandomSampler(seed=seed)


class Evolution(Strategy):
    """An evolution strategy of evosax on the cube.

    What is asked for outside of the cube is reflected at its sides. Ranks are told, not values: the
    scale of an objective does not matter, and what failed is just worse than all others.

    Source: Lange, "evosax: JAX-based evolution strategies", GECCO 2023.

    Args:
        name: see `EVOSAX`.
        space: what is searched.
        start: where to begin.
        population: candidates in a generation, an even number >= 4.
        seed: the same gives the same candidates.

    Raises:
        ValueError: evosax is not installed.
    """

    def __init__(
        self, name: str, space: Space, start: Candidate, population: int, seed: int
    ) -> None:
        import jax

        self._jax, self._space, self._generation = jax, space, 0
        algorithms = package("evosax.algorithms", "tuning")
        kind = getattr(algorithms, EVOSAX[name])
        # It mixes types as JAX does by default, which may be forbidden here.
        with jax.numpy_dtype_promotion("standard"):
            options = _evosax_options(name)
            self._strategy = kind(
                population_size=population,
                solution=np.zeros(len(space.names), np.float32),
                **options,
            )
            self._numbers = self._strategy.default_params
            if hasattr(self._numbers, "std_init"):
                first = np.full_like(np.asarray(self._numbers.std_init), STEP)
                self._numbers = self._numbers.replace(std_init=jax.numpy.asarray(first))
            self._key = jax.random.key(seed)
            places = np.asarray(space.places(start), np.float32)
            self._state = self._strategy.init(self._next_key(0), places, self._numbers)
        self._asked: Any = None

    def _next_key(self, use: int) -> Any:
        fold = self._jax.random.fold_in
        return fold(fold(self._key, self._generation), use)

    def ask(self) -> list[Candidate]:
        """Return the candidates of the next generation."""
        with self._jax.numpy_dtype_promotion("standard"):
            asked, self._state = self._strategy.ask(self._next_key(1), self._state, self._numbers)
        self._asked = np.asarray(asked)
        return [self._space.candidate(reflected(row)) for row in self._asked]

    def tell(self, generation: Sequence[Scored]) -> None:
        """Tell the ranks."""
        if self._asked is None:
            self.ask()
        ranks = np.asarray([each.rank for each in generation], np.float32)
        with self._jax.numpy_dtype_promotion("standard"):
            population = self._jax.numpy.asarray(self._told(generation))
            self._state, _ = self._strategy.tell(
                self._next_key(2),
                population,
                self._jax.numpy.asarray(ranks),
                self._state,
                self._numbers,
            )
        self._generation += 1
        self._asked = None

    def _told(self, generation: Sequence[Scored]) -> np.ndarray:
        told = np.array(self._asked)
        if self._generation == 0:
            told[0] = self._space.places(generation[0].candidate)
        return told


def _evosax_options(name: str) -> dict[str, Any]:
    """Return the pace of strategies that follow a gradient: evosax's own is for thousands of
    weights and generations."""
    if name not in ("open-es", "pgpe"):
        return {}
    optax = package("optax", "tuning")
    options = {"optimizer": optax.adam(learning_rate=0.5 * STEP)}
    if name == "open-es":
        options["std_schedule"] = optax.constant_schedule(STEP)
    return options


def reflected(places: np.ndarray) -> np.ndarray:
    """Return points of the line as points of [0, 1], reflected at both ends as often as needed."""
    folded = np.mod(places, 2.0)
    return np.asarray(np.where(folded > 1.0, 2.0 - folded, folded))


class Diversity(Strategy):
    """Quality diversity by CMA-ME of pyribs: the best settings for each cell of some measures.

    Source: Fontaine, Togelius, Nikolaidis, Hoover, "Covariance matrix adaptation for the rapid
    illumination of behavior space", GECCO 2020.

    Args:
        space: what is searched.
        start: where to begin.
        population: candidates in a generation.
        seed: the same gives the same candidates.
        ranges: least and greatest value of each measure that has a cell.
        cells: number of cells along each measure.

    Raises:
        ValueError: pyribs is not installed.
    """

    def __init__(
        self,
        space: Space,
        start: Candidate,
        population: int,
        seed: int,
        ranges: Sequence[tuple[float, float]],
        cells: Sequence[int],
    ) -> None:
        archives = package("ribs.archives", "tuning")
        emitters = package("ribs.emitters", "tuning")
        self._space, self._generation = space, 0
        size = len(space.names)
        self.archive = archives.GridArchive(
            solution_dim=size, dims=list(cells), ranges=list(ranges)
        )
        self._emitter = emitters.EvolutionStrategyEmitter(
            self.archive,
            x0=space.places(start),
            sigma0=STEP,
            batch_size=population,
            bounds=[(0.0, 1.0)] * size,
            seed=seed,
        )
        self._asked: Any = None

    def ask(self) -> list[Candidate]:
        """Return the candidates of the next generation."""
        self._asked = np.array(self._emitter.ask())
        return [self._space.candidate(row) for row in self._asked]

    def tell(self, generation: Sequence[Scored]) -> None:
        """Put what did not fail into the archive, and tell how much better it has become."""
        if self._asked is None:
            self.ask()
        told = np.array(self._asked)
        if self._generation == 0:
            told[0] = self._space.places(generation[0].candidate)
        self._generation += 1
        self._asked = None
        fine = np.array([each.state == "done" for each in generation])
        # What failed has a place among the solutions, the last, and none in the archive.
        worst = max((each.values[0] for each in generation if each.state == "done"), default=0.0)
        low = tuple(self.archive.lower_bounds)
        values = np.array(
            [-each.values[0] if ok else -worst for each, ok in zip(generation, fine, strict=True)]
        )
        measures = np.array(
            [each.measures if ok else low for each, ok in zip(generation, fine, strict=True)]
        )
        info = {"status": np.zeros(len(told), np.int32), "value": values - np.ptp(values) - 1.0}
        if fine.any():
            added = self.archive.add(told[fine], values[fine], measures[fine])
            for name, column in added.items():
                info.setdefault(name, np.zeros(len(told), np.asarray(column).dtype))
                info[name][fine] = column
        self._emitter.tell(told, values, measures, info)
