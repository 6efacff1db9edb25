"""Episodes of controllers and scenarios that were built in Python."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jaxplore import _checks
from jaxplore.control.base import Controller
from jaxplore.parameters import find_parameter, get_parameters, set_parameters, split_index
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.scenario import Scenario
from jaxplore.study.experiments import SideBySide
from jaxplore.study.runner import Runner
from jaxplore.study.tuning.episodes import (
    Episode,
    Episodes,
    Result,
    make_tasks,
    report_each,
)
from jaxplore.study.tuning.objective import list_metrics
from jaxplore.study.tuning.space import Candidate, Value


class ControllerEpisodes(Episodes):
    """Episodes of one controller, whose parameters are searched by path: see `get_parameters`.

    Args:
        controller: controller with its current parameters.
        scenarios: scenarios by name.
        time_limit: limit of the simulated time [s].
        batch: number of candidates in one `jax.vmap`; for accelerators, and small problems.

    Raises:
        ValueError: no scenarios, a batch < 1.
    """

    def __init__(
        self,
        controller: Controller,
        scenarios: Mapping[str, Scenario],
        *,
        time_limit: float,
        batch: int = 1,
    ) -> None:
        if not scenarios:
            raise ValueError("scenarios is empty; accepted: at least one")
        self._controller, self._scenarios = controller, dict(scenarios)
        self._time_limit = time_limit
        self._batch = _checks.positive_int("batch", batch)
        self._together = SideBySide(batch) if batch > 1 else None

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios."""
        return tuple(self._scenarios)

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the metrics of an episode."""
        scenario = self._example.scenario
        return list_metrics(scenario.metrics_type, scenario.metric_groups)

    @property
    def default_objective(self) -> str:
        """The scenario's default objective: time to the end, and contacts."""
        return self._example.scenario.objective

    @property
    def _example(self) -> Experiment:
        return self._build(Episode(0, {}, self.scenarios[0], 0), {})

    def start(self, name: str) -> Value:
        """Return the current value of a controller parameter."""
        return leaf_value(self._controller, name)

    def elements(self, name: str) -> tuple[str, ...]:
        """Return the name, or for an array the names of its elements."""
        return leaf_elements(self._controller, name)

    def run(
        self, episodes: Sequence[Episode], on_result: Callable[[Episode, Result], None]
    ) -> None:
        """Run episodes one after the other, or in batches."""
        tasks = make_tasks(episodes, self._build, self._batch, self._together)
        Runner().run(tasks, report_each(on_result))

    def _build(self, episode: Episode, _: Mapping[str, Any]) -> Experiment:
        scenario = self._scenarios[episode.scenario]
        return Experiment(
            set_parameters(self._controller, leaf_values(self._controller, episode.candidate)),
            scenario,
            max(1, round(self._time_limit / scenario.period)),
            jax.random.key(episode.seed),
        )

    def describe(self) -> dict[str, Any]:
        """Return the names of the scenarios and the parameters of the controller."""
        return {
            "scenarios": list(self._scenarios),
            "time_limit": self._time_limit,
            "controller": {
                path: np.asarray(value).tolist()
                for path, value in get_parameters(self._controller).items()
            },
        }


def leaf_value(controller: Any, name: str) -> float:
    """Return one parameter of a controller, `path` or `path[i]`."""
    path, index = split_index(name)
    value = np.asarray(get_parameters(controller)[find_parameter(controller, path)])
    if index is None and value.size != 1:
        raise ValueError(
            f"parameter {name} has {value.size} elements; accepted: one of them, {path}[0] to "
            f"{path}[{value.size - 1}]"
        )
    if index is not None and not 0 <= index < value.size:
        raise ValueError(
            f"parameter {name} has no element {index}; accepted: 0 to {value.size - 1}"
        )
    return float(value.reshape(-1)[0 if index is None else index])


def leaf_elements(controller: Any, name: str) -> tuple[str, ...]:
    """Return a path, or for an array `path[i]` for each of its elements."""
    if "[" in name:
        return (name,)
    size = get_parameters(controller)[find_parameter(controller, name)].size
    return (name,) if size == 1 else tuple(f"{name}[{i}]" for i in range(size))


def leaf_values(controller: Any, candidate: Candidate) -> dict[str, np.ndarray]:
    """Return the arrays for `set_parameters`; elements that are not searched keep their values."""
    known = get_parameters(controller)
    arrays: dict[str, np.ndarray] = {}
    for name, value in candidate.items():
        path, index = split_index(name)
        full = find_parameter(controller, path)
        # The elements of an array are separate parameters, so they are set in one copy of it.
        array = arrays.setdefault(full, np.array(known[full]))
        if index is None:
            array[...] = value
        else:
            array.reshape(-1)[index] = value
    return arrays
