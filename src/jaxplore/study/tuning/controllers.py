"""Episodes of controllers and scenarios that were built in Python."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from jaxplore.control.base import Controller
from jaxplore.parameters import find_parameter, get_parameters, set_parameters
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.scenario import Scenario
from jaxplore.study.tuning.built import Runner
from jaxplore.study.tuning.episodes import Ask, Episodes, Outcome
from jaxplore.study.tuning.space import Candidate, Value


class ControllerEpisodes(Episodes):
    """Episodes of one controller, whose numbers are searched by their path (`get_parameters`).

    Args:
        controller: as it is now.
        scenarios: by name.
        time_limit: simulated at most [s].
        batch: candidates side by side, by `jax.vmap`; for accelerators, and small problems.

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
        self._runner = Runner(self._build, batch)

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios."""
        return tuple(self._scenarios)

    def start(self, name: str) -> Value:
        """Return a number of the controller."""
        return leaf_value(self._controller, name)

    def elements(self, name: str) -> tuple[str, ...]:
        """Return the name, or of an array one for each of its elements."""
        return leaf_elements(self._controller, name)

    def run(self, asks: Sequence[Ask], on_done: Callable[[Ask, Outcome], None]) -> None:
        """Run episodes one after the other, or a batch at a time."""
        self._runner.run(asks, on_done)

    def _build(self, ask: Ask) -> Experiment:
        scenario = self._scenarios[ask.scenario]
        return Experiment(
            set_parameters(self._controller, leaf_values(self._controller, ask.candidate)),
            scenario,
            max(1, round(self._time_limit / float(scenario.control_period))),
            jax.random.key(ask.seed),
        )

    def describe(self) -> dict[str, Any]:
        """Return the scenarios' names and the controller's numbers."""
        return {
            "scenarios": list(self._scenarios),
            "time_limit": self._time_limit,
            "controller": {
                path: np.asarray(value).tolist()
                for path, value in get_parameters(self._controller).items()
            },
        }


def leaf_value(controller: Any, name: str) -> float:
    """Return one number of a controller, `path` or `path[i]`.

    Raises:
        ValueError: a path that is none, or an array without an index.
    """
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
    """Return a path, or of an array `path[i]` for each of its elements.

    Raises:
        ValueError: a path that is none.
    """
    if "[" in name:
        return (name,)
    size = get_parameters(controller)[find_parameter(controller, name)].size
    return (name,) if size == 1 else tuple(f"{name}[{i}]" for i in range(size))


def leaf_values(controller: Any, candidate: Candidate) -> dict[str, np.ndarray]:
    """Return the arrays that `set_parameters` takes: elements that are not searched stay."""
    known = get_parameters(controller)
    arrays: dict[str, np.ndarray] = {}
    for name, value in candidate.items():
        path, index = split_index(name)
        full = find_parameter(controller, path)
        array = arrays.setdefault(full, np.array(known[full]))
        if index is None:
            array[...] = value
        else:
            array.reshape(-1)[index] = value
    return arrays


def split_index(name: str) -> tuple[str, int | None]:
    """Return the path and the index of `path[i]`."""
    path, bracket, rest = name.partition("[")
    if not bracket:
        return name, None
    number = rest.removesuffix("]")
    if not rest.endswith("]") or not number.isdigit():
        raise ValueError(
            f"parameter is {name!r}; accepted: a path, or a path with an index, a.b[0]"
        )
    return path, int(number)
