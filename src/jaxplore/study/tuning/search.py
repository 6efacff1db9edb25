"""What is searched for, and how."""

import dataclasses
from typing import Any

from jaxplore.study.tuning.objective import Objective
from jaxplore.study.tuning.space import Candidate, Space
from jaxplore.study.tuning.strategies import (
    EVOSAX,
    NAMES,
    OPTUNA,
    Diversity,
    Evolution,
    Sampling,
    Strategy,
)

POPULATION = 8
"""Candidates in a generation."""


@dataclasses.dataclass(frozen=True)
class Measure:
    """A metric over which quality diversity spreads candidates.

    Args:
        metric: its name.
        low: least value that has a cell.
        high: greatest.
        cells: number of them.

    Raises:
        ValueError: bounds that are reversed, fewer than two cells.
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


@dataclasses.dataclass(frozen=True)
class Search:
    """What is searched for, and how.

    Args:
        space: what is searched.
        objectives: to be made small; several for a front of compromises.
        seeds: of the episodes in each scenario, the same for all candidates.
        optimizer: see `jaxplore.study.tuning.strategies.NAMES`.
        population: candidates in a generation. The next one knows of all of them, so results do not
            depend on how many are tried out at the same time.
        seed: of the search.
        gives_up: whether candidates that look worse than most are given up early.
        measures: of quality diversity.

    Raises:
        ValueError: an optimizer that there is not, or that does not take the objectives, measures
            or population; no seeds, or one twice.
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
        if not self.seeds or len(set(self.seeds)) != len(self.seeds):
            raise ValueError(
                f"seeds are {list(self.seeds)}; accepted: different ones, at least one"
            )
        if self.population < 1:
            raise ValueError(f"population is {self.population}; accepted: a whole number >= 1")
        if self.optimizer in EVOSAX and (self.population % 2 or self.population < 4):
            raise ValueError(
                f"population is {self.population}; accepted for {self.optimizer}: an even number "
                ">= 4"
            )

    @property
    def named(self) -> str:
        """The objectives in words."""
        return " and ".join(map(str, self.objectives))

    def describe(self) -> dict[str, Any]:
        """Return it as plain values that JSON can hold."""
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


def strategy_of(search: Search, start: Candidate) -> Strategy:
    """Return the optimiser of a search.

    Args:
        search: what is searched for.
        start: the values that there are.

    Raises:
        ValueError: its library is not installed.
    """
    if search.optimizer in OPTUNA:
        return Sampling(
            search.optimizer, search.space, search.population, search.seed, len(search.objectives)
        )
    if search.optimizer in EVOSAX:
        return Evolution(search.optimizer, search.space, start, search.population, search.seed)
    return Diversity(
        search.space,
        start,
        search.population,
        search.seed,
        [(each.low, each.high) for each in search.measures],
        [each.cells for each in search.measures],
    )
