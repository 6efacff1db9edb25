"""Definition of a search: space, objectives, seeds and optimizer."""

import dataclasses
import math
from typing import Any

from jaxplore import _checks
from jaxplore._limits import MOST_AT_ONCE, MOST_CANDIDATES
from jaxplore.study.seeds import check_number_of_seeds
from jaxplore.study.tuning.objective import Objective
from jaxplore.study.tuning.optimizers import (
    EVOSAX,
    NAMES,
    OPTUNA,
    EvosaxOptimizer,
    Optimizer,
    OptunaOptimizer,
    RibsOptimizer,
)
from jaxplore.study.tuning.space import Candidate, Space

POPULATION = 8
"""Candidates in a generation."""


@dataclasses.dataclass(frozen=True)
class Measure:
    """A metric, divided into cells, over which quality diversity spreads candidates.

    Args:
        metric: name of the metric.
        low: lower bound of the cells.
        high: upper bound.
        cells: number of cells.

    Raises:
        ValueError: bounds that are reversed, fewer than two or too many cells.
    """

    metric: str
    low: float
    high: float
    cells: int = 10

    def __post_init__(self) -> None:
        if not self.low < self.high or self.cells < 2:
            raise ValueError(
                f"measure {self.metric} has {self.cells} cells from {self.low:g} to {self.high:g}; "
                "accepted: at least two, the lower bound first"
            )
        _checks.positive_int(f"cells of {self.metric}", self.cells, at_most=MOST_CANDIDATES)


@dataclasses.dataclass(frozen=True)
class Search:
    """Definition of a search: the parameters, the objectives and the optimizer.

    Args:
        space: parameters that are varied.
        objectives: objectives to minimize; several for a Pareto front.
        seeds: seeds of the episodes in each scenario, the same for all candidates.
        optimizer: one of `jaxplore.study.tuning.optimizers.NAMES`.
        population: number of candidates in a generation. The next generation is proposed after all
            of them, so the results do not depend on the number of workers.
        seed: seed of the search.
        gives_up: whether candidates that are worse than most are stopped early.
        measures: measures of quality diversity.

    Raises:
        ValueError: an unknown optimizer, or one that does not support the objectives, measures or
            population; no seeds, or a repeated one.
    """

    space: Space
    objectives: tuple[Objective, ...]
    seeds: tuple[int, ...]
    optimizer: str = "tpe"
    population: int = POPULATION
    seed: int = 0
    gives_up: bool = True
    measures: tuple[Measure, ...] = ()

    def __post_init__(self) -> None:
        if self.optimizer not in NAMES:
            raise ValueError(f"optimizer is {self.optimizer!r}; accepted: {', '.join(NAMES)}")
        if not self.objectives:
            raise ValueError("objectives is empty; accepted: at least one")
        if len(self.objectives) > 1 and self.optimizer not in OPTUNA:
            raise ValueError(
                f"optimizer is {self.optimizer} with {len(self.objectives)} objectives; accepted "
                f"for several: {', '.join(OPTUNA)}"
            )
        if (self.optimizer == "cma-me") != bool(self.measures):
            raise ValueError(
                f"measures are {[each.metric for each in self.measures]} for {self.optimizer}; "
                "accepted: some for cma-me, none for others"
            )
        check_number_of_seeds("seeds", self.seeds)
        if not self.seeds or len(set(self.seeds)) != len(self.seeds):
            raise ValueError(
                f"seeds are {list(self.seeds)}; accepted: different ones, at least one"
            )
        if self.population < 1:
            raise ValueError(f"population is {self.population}; accepted: a whole number >= 1")
        _checks.positive_int("population", self.population, at_most=MOST_AT_ONCE)
        cells = math.prod(each.cells for each in self.measures)
        if cells > MOST_CANDIDATES:
            raise ValueError(
                f"measures have {cells} cells in all; accepted: at most {MOST_CANDIDATES}"
            )
        if self.optimizer in EVOSAX and (self.population % 2 or self.population < 4):
            raise ValueError(
                f"population is {self.population}; accepted for {self.optimizer}: an even number "
                ">= 4"
            )

    @property
    def named(self) -> str:
        """The objectives as text."""
        return " and ".join(map(str, self.objectives))

    def describe(self) -> dict[str, Any]:
        """Return the search as plain values for JSON."""
        return {
            "space": {each.name: each.as_dict() for each in self.space.parameters},
            "objectives": [str(each) for each in self.objectives],
            "seeds": list(self.seeds),
            "optimizer": self.optimizer,
            "population": self.population,
            "seed": self.seed,
            "gives_up": self.gives_up,
            "measures": [dataclasses.asdict(each) for each in self.measures],
        }


def make_optimizer(search: Search, start: Candidate) -> Optimizer:
    """Make the optimizer that proposes candidates for a search. The start is the current values."""
    if search.optimizer in OPTUNA:
        return OptunaOptimizer(
            search.optimizer, search.space, search.population, search.seed, len(search.objectives)
        )
    if search.optimizer in EVOSAX:
        return EvosaxOptimizer(
            search.optimizer, search.space, start, search.population, search.seed
        )
    return RibsOptimizer(
        search.space,
        start,
        search.population,
        search.seed,
        [(each.low, each.high) for each in search.measures],
        [each.cells for each in search.measures],
    )
