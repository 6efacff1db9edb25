"""Episodes of controllers and scenarios that were built in Python."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxplore._types import Key
from jaxplore.control.base import Controller
from jaxplore.control.leaves import find_leaf, leaves, with_leaves
from jaxplore.report.metrics import compute_metrics
from jaxplore.report.path_metrics import compute_path_metrics
from jaxplore.simulation.batch import Member, Places, record_members
from jaxplore.simulation.follow import PathRecording, record_path_run
from jaxplore.simulation.path_scenario import PathScenario
from jaxplore.simulation.recording import Recording
from jaxplore.simulation.scenario import Scenario
from jaxplore.simulation.simulate import record_run
from jaxplore.tuning.episodes import Ask, Episodes, Outcome
from jaxplore.tuning.objective import flat, with_late_times
from jaxplore.tuning.space import Candidate, Value


class Built(NamedTuple):
    """A run that is ready to start: what `simulate` or `follow_path` take."""

    controller: Controller
    scenario: Scenario | PathScenario
    num_steps: int
    key: Key


def run_alone(built: Built, seed: int, time_limit: float | None) -> Outcome:
    """Run an episode and return its report.

    Raises:
        KeyboardInterrupt: the user stopped it.
    """
    steps = _steps(built, time_limit)
    recording: Recording | PathRecording
    if isinstance(built.scenario, PathScenario):
        recording = record_path_run(
            built.controller, built.scenario, steps, key=built.key, num_trajectories=0
        )
    else:
        recording = record_run(
            built.controller, built.scenario, steps, key=built.key, num_trajectories=0
        )
    return _outcome(recording, seed, built)


def run_together(
    runs: Sequence[Built], seeds: Sequence[int], time_limit: float | None, differs: Places | None
) -> tuple[list[Outcome], Places]:
    """Run episodes side by side and return their reports; see `record_members`.

    Raises:
        ValueError: controllers that differ in more than numbers.
        KeyboardInterrupt: the user stopped them.
    """
    members = [Member(one.controller, one.scenario, one.key) for one in runs]
    steps = max(_steps(one, time_limit) for one in runs)
    recordings, found = record_members(members, steps, with_frames=False, differs=differs)
    reports = zip(recordings, seeds, runs, strict=True)
    return [_outcome(recording, seed, one) for recording, seed, one in reports], found


def _steps(built: Built, time_limit: float | None) -> int:
    if time_limit is None:
        return built.num_steps
    period = float(built.scenario.control_period)
    return max(1, min(built.num_steps, round(time_limit / period)))


def _outcome(recording: Recording | PathRecording, seed: int, built: Built) -> Outcome:
    if recording.is_interrupted:
        raise KeyboardInterrupt
    report = (
        compute_path_metrics(recording, seed=seed)
        if isinstance(recording, PathRecording)
        else compute_metrics(recording, seed=seed)
    )
    # As late as if it had gone on to the scenario's own limit: cut short or not is no difference.
    limit = built.num_steps * recording.control_period
    return Outcome(with_late_times(flat(report.as_dict()), limit))


class ControllerEpisodes(Episodes):
    """Episodes of one controller, of which numbers are searched by their path: see `leaves`.

    Args:
        controller: as it is now.
        scenarios: by name, `Scenario` or `PathScenario`.
        time_limit: simulated at most [s].
        batch: candidates side by side, by `jax.vmap`; for accelerators, and small problems.

    Raises:
        ValueError: no scenarios, a batch < 1.
    """

    def __init__(
        self,
        controller: Controller,
        scenarios: Mapping[str, Scenario | PathScenario],
        *,
        time_limit: float,
        batch: int = 1,
    ) -> None:
        if not scenarios:
            raise ValueError("scenarios is empty; accepted: at least one")
        if batch < 1:
            raise ValueError(f"batch is {batch}; accepted: a whole number >= 1")
        self._controller, self._scenarios = controller, dict(scenarios)
        self._time_limit, self._batch = time_limit, batch
        self._differs: dict[str, Places] = {}

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
        run_asks(asks, self._build, on_done, batch=self._batch, differs=self._differs)

    def _build(self, ask: Ask) -> Built:
        scenario = self._scenarios[ask.scenario]
        return Built(
            with_leaves(self._controller, leaf_values(self._controller, ask.candidate)),
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
                path: np.asarray(value).tolist() for path, value in leaves(self._controller).items()
            },
        }


def run_asks(
    asks: Sequence[Ask],
    build: Callable[[Ask], Built],
    on_done: Callable[[Ask, Outcome], None],
    *,
    batch: int,
    differs: dict[str, Places],
) -> None:
    """Build and run episodes here, one after the other or a batch at a time.

    Args:
        asks: the episodes.
        build: makes what is run.
        on_done: told of each.
        batch: episodes side by side at most; those of one scenario, seed and limit, whose
            candidates have the same sizes and choices.
        differs: which arrays of a scenario's runs have differed so far; added to.
    """
    groups: dict[tuple[Any, ...], list[Ask]] = {}
    for ask in asks:
        sizes = tuple(
            (name, value) for name, value in ask.candidate.items() if not isinstance(value, float)
        )
        key = (ask.scenario, ask.seed, ask.time_limit, sizes)
        groups.setdefault(key, []).append(ask)
    for group in groups.values():
        for first in range(0, len(group), batch):
            _run_group(group[first : first + batch], build, on_done, batch, differs)


def _run_group(
    asks: Sequence[Ask],
    build: Callable[[Ask], Built],
    on_done: Callable[[Ask, Outcome], None],
    batch: int,
    differs: dict[str, Places],
) -> None:
    ready: list[tuple[Ask, Built]] = []
    for ask in asks:
        try:
            ready.append((ask, build(ask)))
        except ValueError as error:
            on_done(ask, Outcome({}, str(error)))
    if batch > 1 and ready:
        # Always as many: another number would be another program.
        padded = ready + [ready[-1]] * (batch - len(ready))
        first = ready[0][0]
        seeds = [ask.seed for ask, _ in padded]
        try:
            outcomes, differs[first.scenario] = run_together(
                [built for _, built in padded], seeds, first.time_limit, differs.get(first.scenario)
            )
        except ValueError:
            pass  # They differ in more than numbers: one after the other then.
        else:
            for (ask, _), outcome in zip(ready, outcomes, strict=False):
                on_done(ask, outcome)
            return
    for ask, built in ready:
        try:
            outcome = run_alone(built, ask.seed, ask.time_limit)
        except Exception as error:
            outcome = Outcome({}, f"{type(error).__name__}: {error}")
        on_done(ask, outcome)


def leaf_value(controller: Any, name: str) -> float:
    """Return one number of a controller, `path` or `path[i]`.

    Raises:
        ValueError: a path that is none, or an array without an index.
    """
    path, index = split_index(name)
    value = np.asarray(leaves(controller)[find_leaf(controller, path)])
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
    size = leaves(controller)[find_leaf(controller, name)].size
    return (name,) if size == 1 else tuple(f"{name}[{i}]" for i in range(size))


def leaf_values(controller: Any, candidate: Candidate) -> dict[str, np.ndarray]:
    """Return the arrays that `with_leaves` takes: elements that are not searched stay."""
    known = leaves(controller)
    arrays: dict[str, np.ndarray] = {}
    for name, value in candidate.items():
        path, index = split_index(name)
        full = find_leaf(controller, path)
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
