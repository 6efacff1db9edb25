"""Optimizers of Optuna, evosax and pyribs, which propose generations of candidates."""

import abc
import warnings
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxplore._optional import import_optional
from jaxplore.study.tuning.space import Candidate, Space, distribution

STEP = 0.2
"""Initial standard deviation of evolution strategies, as a share of the side of the unit cube."""

EVOSAX = {
    "cma-es": "CMA_ES",
    "sep-cma-es": "Sep_CMA_ES",
    "open-es": "Open_ES",
    "snes": "SNES",
    "cr-fm-nes": "CR_FM_NES",
    "pgpe": "PGPE",
}
"""Evolution strategies of evosax by jaxplore's names."""
OPTUNA = ("tpe", "random", "nsga-ii", "qmc")
"""Samplers of Optuna."""
PYRIBS = ("cma-me",)
"""Quality-diversity algorithm of pyribs."""
NAMES = (*OPTUNA, *EVOSAX, *PYRIBS)


class Evaluated(NamedTuple):
    """An evaluated candidate: "done", "given up" or "failed", with its rank in its generation, 0
    for the best and last for one that was stopped or failed; the values of the objectives, none if
    it failed, and of the measures of quality diversity."""

    candidate: Candidate
    rank: float
    state: str
    values: tuple[float, ...]
    num_episodes: int
    measures: tuple[float, ...] = ()


class Optimizer(abc.ABC):
    """An optimizer with the ask-and-tell interface, which proposes generations of candidates.

    Random numbers depend on its seed and the number of the generation only, so a study that
    continues replays the former generations and gets the proposals of one without an interruption.
    """

    @abc.abstractmethod
    def ask(self) -> list[Candidate]:
        """Return the candidates of the next generation."""

    @abc.abstractmethod
    def tell(self, generation: Sequence[Evaluated]) -> None:
        """Report the results of a generation. The very first candidate was replaced by the
        start."""


class OptunaOptimizer(Optimizer):
    """A sampler of Optuna, see `OPTUNA`, which supports choices and several objectives.

    Source: Akiba, Sano, Yanase, Ohta, Koyama, "Optuna: a next-generation hyperparameter
    optimization framework", KDD 2019.
    """

    def __init__(
        self, name: str, space: Space, population: int, seed: int, num_objectives: int
    ) -> None:
        optuna = import_optional("optuna", "tuning")
        self._name, self._space, self._population, self._seed = name, space, population, seed
        self._distributions = {each.name: distribution(each) for each in space.parameters}
        # A separate study in memory: sampling from the storage on disk would be slower.
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

    def tell(self, generation: Sequence[Evaluated]) -> None:
        """Report the values of all candidates, those that were stopped early included."""
        # A study that continues has not asked for this generation yet.
        self.ask()
        for trial, each in zip(self._asked, generation, strict=True):
            if trial.params != each.candidate:
                # The current settings replaced this proposal.
                self._study.tell(trial, state=self._states.FAIL)
                if each.state == "done":
                    self._study.add_trial(self._make_trial(each))
            elif each.state == "done":
                self._study.tell(trial, list(each.values))
            elif each.state == "given up":
                # Optuna's TPE ranks such candidates by their episodes first, then by the value.
                trial.report(each.values[0], each.num_episodes)
                self._study.tell(trial, state=self._states.PRUNED)
            else:
                self._study.tell(trial, state=self._states.FAIL)
        self._told += len(generation)
        self._asked = []

    def _make_trial(self, each: Evaluated) -> Any:
        return import_optional("optuna.trial", "tuning").create_trial(
            params=each.candidate, distributions=self._distributions, values=list(each.values)
        )

    def _sampler(self, number: int) -> Any:
        samplers = import_optional("optuna.samplers", "tuning")
        # A new sampler for each candidate, so that a continued study draws the same numbers.
        seed = int(np.random.SeedSequence([self._seed, number]).generate_state(1)[0])
        if self._name == "tpe":
            # The first generation is random, because the model has no results to learn from.
            return samplers.TPESampler(seed=seed, n_startup_trials=max(10, self._population))
        if self._name == "nsga-ii":
            return samplers.NSGAIISampler(seed=seed, population_size=self._population)
        if self._name == "qmc":
            # All points belong to one sequence, so they share its seed; Optuna counts the points.
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # QMCSampler is experimental
                return samplers.QMCSampler(seed=self._seed, scramble=True)
        return samplers.RandomSampler(seed=seed)


class EvosaxOptimizer(Optimizer):
    """An evolution strategy of evosax, see `EVOSAX`, on the unit cube.

    Proposals outside the cube are reflected at its sides. The strategy receives ranks instead of
    values: the scale of the objective does not matter, and a failed candidate is simply the last.
    The start is the initial mean, and the population an even number >= 4.

    Source: Lange, "evosax: JAX-based evolution strategies", GECCO 2023.
    """

    def __init__(
        self, name: str, space: Space, start: Candidate, population: int, seed: int
    ) -> None:
        import jax

        self._jax, self._space, self._generation = jax, space, 0
        algorithms = import_optional("evosax.algorithms", "tuning")
        kind = getattr(algorithms, EVOSAX[name])
        # evosax relies on JAX's default type promotion, but the process may have set a strict one.
        with jax.numpy_dtype_promotion("standard"):
            options = _evosax_options(name)
            self._algorithm = kind(
                population_size=population,
                # Only the shape of the solution counts here.
                solution=np.zeros(len(space.names), np.float32),
                **options,
            )
            self._numbers = self._algorithm.default_params
            # Not all strategies have an initial standard deviation.
            if hasattr(self._numbers, "std_init"):
                first = np.full_like(np.asarray(self._numbers.std_init), STEP)
                self._numbers = self._numbers.replace(std_init=jax.numpy.asarray(first))
            self._key = jax.random.key(seed)
            places = np.asarray(space.places(start), np.float32)
            self._state = self._algorithm.init(self._next_key(0), places, self._numbers)
        self._asked: Any = None

    def _next_key(self, use: int) -> Any:
        fold = self._jax.random.fold_in
        return fold(fold(self._key, self._generation), use)

    def ask(self) -> list[Candidate]:
        """Return the candidates of the next generation."""
        with self._jax.numpy_dtype_promotion("standard"):
            asked, self._state = self._algorithm.ask(self._next_key(1), self._state, self._numbers)
        self._asked = np.asarray(asked)
        return [self._space.candidate(reflect(row)) for row in self._asked]

    def tell(self, generation: Sequence[Evaluated]) -> None:
        """Report the ranks."""
        # A study that continues has not asked for this generation yet.
        if self._asked is None:
            self.ask()
        ranks = np.asarray([each.rank for each in generation], np.float32)
        with self._jax.numpy_dtype_promotion("standard"):
            population = self._jax.numpy.asarray(self._points_to_tell(generation))
            self._state, _ = self._algorithm.tell(
                self._next_key(2),
                population,
                self._jax.numpy.asarray(ranks),
                self._state,
                self._numbers,
            )
        self._generation += 1
        self._asked = None

    def _points_to_tell(self, generation: Sequence[Evaluated]) -> np.ndarray:
        told = np.array(self._asked)
        # The very first candidate was replaced by the start, so its point is that of the start.
        if self._generation == 0:
            told[0] = self._space.places(generation[0].candidate)
        return told


def _evosax_options(name: str) -> dict[str, Any]:
    """Return step sizes for strategies that estimate a gradient.

    The defaults of evosax suit thousands of weights and generations.
    """
    if name not in ("open-es", "pgpe"):
        return {}
    optax = import_optional("optax", "tuning")
    options = {"optimizer": optax.adam(learning_rate=0.5 * STEP)}
    if name == "open-es":
        options["std_schedule"] = optax.constant_schedule(STEP)
    return options


def reflect(places: np.ndarray) -> np.ndarray:
    """Map numbers to [0, 1] by repeated reflection at both ends."""
    folded = np.mod(places, 2.0)
    return np.asarray(np.where(folded > 1.0, 2.0 - folded, folded))


class RibsOptimizer(Optimizer):
    """Quality diversity by CMA-ME of pyribs: the best candidate of each cell of the measures.

    The start is the initial mean. Each measure has a lower and an upper bound in `ranges`, and a
    number of cells.

    Source: Fontaine, Togelius, Nikolaidis, Hoover, "Covariance matrix adaptation for the rapid
    illumination of behavior space", GECCO 2020.
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
        archives = import_optional("ribs.archives", "tuning")
        emitters = import_optional("ribs.emitters", "tuning")
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

    def tell(self, generation: Sequence[Evaluated]) -> None:
        """Add the successful candidates to the archive, and report the improvements."""
        # A study that continues has not asked for this generation yet.
        if self._asked is None:
            self.ask()
        told = np.array(self._asked)
        if self._generation == 0:
            told[0] = self._space.places(generation[0].candidate)
        self._generation += 1
        self._asked = None
        fine = np.array([each.state == "done" for each in generation])
        # CMA-ES needs a rank for each solution: failed candidates are last and stay out of the
        # archive.
        worst = max((each.values[0] for each in generation if each.state == "done"), default=0.0)
        low = tuple(self.archive.lower_bounds)
        values = np.array(
            [-each.values[0] if ok else -worst for each, ok in zip(generation, fine, strict=True)]
        )
        measures = np.array(
            [each.measures if ok else low for each, ok in zip(generation, fine, strict=True)]
        )
        # A failed candidate is not counted as added and has the least value, so that it ranks last.
        info: dict[str, np.ndarray] = {
            "status": np.zeros(len(told), np.int32),
            "value": np.zeros(len(told)),
        }
        if fine.any():
            added = self.archive.add(told[fine], values[fine], measures[fine])
            for name, column in added.items():
                info.setdefault(name, np.zeros(len(told), np.asarray(column).dtype))
                info[name][fine] = column
            info["value"][~fine] = info["value"][fine].min() - 1.0
        self._emitter.tell(told, values, measures, info)
