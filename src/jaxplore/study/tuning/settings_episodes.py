"""Episodes that are described by settings."""

import contextlib
import dataclasses
import functools
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from jaxplore import _checks
from jaxplore.control.base import Controller
from jaxplore.parameters import get_parameters, nearest, set_parameters
from jaxplore.settings.code_names import is_own
from jaxplore.settings.readers import read_values
from jaxplore.settings.sections import RunSettings
from jaxplore.simulation.experiment import Experiment
from jaxplore.study.episode import InputFile
from jaxplore.study.experiments import SideBySide
from jaxplore.study.runner import Runner
from jaxplore.study.tuning.controller_episodes import leaf_elements, leaf_value, leaf_values
from jaxplore.study.tuning.episodes import (
    Episode,
    Episodes,
    MetricsTask,
    Result,
    make_tasks,
    report_each,
)
from jaxplore.study.tuning.objective import list_metrics
from jaxplore.study.tuning.space import Candidate, Space, Value
from jaxplore.tasks.registry import (
    build,
    files_of,
    find_kind,
    kind_of,
    make_settings,
    without_unread,
)
from jaxplore.tasks.user_code import hash_user_code, import_rule

Entries = Mapping[str, Any]
"""Settings as in a settings file."""

PARAMETERS = "parameters"
"""Setting that holds controller parameters by path."""
_FIXED = ("world", "seed", "start", "goal", "architecture", PARAMETERS)
"""Settings that define the scenario and the task, and are not searched."""


class SettingsEpisodes(Episodes):
    """Episodes of one or several scenarios that are described by settings.

    Parameters are settings, such as `controller.temperature`, or controller parameters by path,
    such as `cost.information.weight`: see `jaxplore.get_parameters`.

    Args:
        scenarios: settings entries of each scenario, by name.
        batch: number of candidates in one `jax.vmap`.
        runner: runner of the episodes; this process when absent.
        common: entries of the settings file that a search over several scenarios writes; the
            entries that all scenarios share when absent.

    Raises:
        ValueError: settings that are not accepted, a file that cannot be read, a batch with
            workers.
    """

    def __init__(
        self,
        scenarios: Mapping[str, Entries],
        *,
        batch: int = 1,
        runner: Runner | None = None,
        common: Entries | None = None,
    ) -> None:
        runner = Runner() if runner is None else runner
        if batch > 1 and not runner.is_local:
            raise ValueError(f"batch is {batch} with workers; accepted: one of them")
        if not scenarios:
            raise ValueError("scenarios is empty; accepted: at least one")
        self._scenarios = {name: dict(entries) for name, entries in scenarios.items()}
        self._runner, self._batch = runner, _checks.positive_int("batch", batch)
        self._together = SideBySide(batch) if batch > 1 else None
        self._common = find_shared_entries(self._scenarios) if common is None else dict(common)
        first = next(iter(self._scenarios.values()))
        self._settings = make_settings(first)
        self._known = _searchable_settings(self._settings)
        self._built: dict[tuple[str, int | None], Experiment] = {}
        for name in self._scenarios:
            # Built at once, so that an unreadable file is reported before any episode runs.
            self._current(name, None)
        self._files = {name: _find_file(entries) for name, entries in self._scenarios.items()}

    @property
    def example(self) -> Experiment:
        """Experiment of the first scenario with the current settings."""
        return self._current(self.scenarios[0], None)

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the metrics of an episode."""
        scenario = self.example.scenario
        return list_metrics(scenario.metrics_type, scenario.metric_groups)

    @property
    def default_objective(self) -> str:
        """The scenario's default objective: time to the end, and contacts."""
        return self.example.scenario.objective

    @property
    def _controller(self) -> Controller:
        return self.example.controller

    def _current(self, scenario: str, seed: int | None) -> Experiment:
        """Return the experiment of a scenario with the current settings, built once."""
        at = (scenario, seed)
        if at not in self._built:
            self._built[at] = self.experiment(scenario, {}, seed)
        return self._built[at]

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios."""
        return tuple(self._scenarios)

    def entries(
        self, scenario: str, candidate: Candidate, seed: int | None = None
    ) -> dict[str, Any]:
        """Return the settings entries of a scenario with a candidate's values.

        Args:
            scenario: name of the scenario.
            candidate: the values; empty for the current settings.
            seed: seed of the run; that of the settings when absent.
        """
        inside = [name for name in candidate if name not in self._known]
        # Array elements that are not searched keep the values of this scenario's controller.
        arrays = self._current(scenario, None).controller if inside else None
        chosen = self._with_values(self._scenarios[scenario], candidate, seed, arrays)
        # What a candidate chooses may leave other settings unread.
        return without_unread(chosen) if candidate else chosen

    def largest(self, space: Space) -> Iterator[RunSettings]:
        """Yield the settings of each scenario with the greatest values of a space.

        Raises:
            ValueError: a greatest value that a setting does not accept.
        """
        greatest: dict[str, Value] = {}
        for each in space.parameters:
            numbers = [one for one in each.choices or () if type(one) in (int, float)]
            if each.name in self._known and (each.choices is None or numbers):
                greatest[each.name] = each.value(1.0) if each.choices is None else max(numbers)
        for name in self._scenarios:
            yield make_settings(self.entries(name, greatest))

    def make_entries(self, candidate: Candidate) -> dict[str, Any]:
        """Return the entries of a settings file with a candidate's values.

        For one scenario these are all settings; for several, the common ones.

        Raises:
            ValueError: values that are not accepted.
        """
        if len(self._scenarios) == 1:
            settings = self.settings(self.scenarios[0], candidate)
            return read_values(settings)
        return self._with_values(self._common, candidate, None, self._controller)

    def _with_values(
        self, entries: Entries, candidate: Candidate, seed: int | None, controller: Any
    ) -> dict[str, Any]:
        chosen = {**entries} if seed is None else {**entries, "seed": seed}
        inside = {}
        for name, value in candidate.items():
            if name not in self._known:
                inside[name] = value
                continue
            *sections, last = name.split(".")
            place = chosen
            for section in sections:
                # Sections are copied, because all candidates share the entries of a scenario.
                place[section] = dict(place.get(section) or {})
                place = place[section]
            place[last] = value
        if inside:
            arrays = leaf_values(controller, inside)
            before = chosen.get(PARAMETERS) or {}
            plain = {path: array.tolist() for path, array in arrays.items()}
            chosen[PARAMETERS] = {**before, **plain}
        return chosen

    def start(self, name: str) -> Value:
        """Return the current value of a setting or of a controller parameter."""
        if name in self._known:
            return self._known[name]
        with self._nearest(name):
            return leaf_value(self._controller, name)

    @contextlib.contextmanager
    def _nearest(self, name: str) -> Iterator[None]:
        """Extend the error for an unknown name by similar settings."""
        try:
            yield
        except ValueError as error:
            # Other errors, such as a missing index, already say what is accepted.
            if " is not known" not in str(error):
                raise
            everything = {**self._known, **get_parameters(self._controller)}
            raise ValueError(
                f"parameter {name} is not known; accepted: such as {nearest(name, everything)}"
            ) from None

    def elements(self, name: str) -> tuple[str, ...]:
        """Return the name, or for an array of the controller the names of its elements."""
        if name in self._known:
            return (name,)
        with self._nearest(name):
            return leaf_elements(self._controller, name)

    def run(
        self, episodes: Sequence[Episode], on_result: Callable[[Episode, Result], None]
    ) -> None:
        """Run episodes in this process, one after the other or in batches, or by workers."""
        tasks = make_tasks(episodes, self._build, self._batch, self._together)
        if not self._runner.is_local:
            # Workers receive settings and the file that they name, instead of arrays.
            tasks = [
                dataclasses.replace(
                    task,
                    build=functools.partial(build_entries, self._task_entries(task)),
                    file=self._files[task.scenario],
                )
                for task in tasks
            ]
        self._runner.run(tasks, report_each(on_result))

    def _task_entries(self, task: MetricsTask) -> Entries:
        (episode,) = task.episodes
        return self.entries(episode.scenario, episode.candidate, episode.seed)

    def _build(self, episode: Episode, _: Entries) -> Experiment:
        if any(name in self._known for name in episode.candidate):
            return self.experiment(episode.scenario, episode.candidate, episode.seed)
        # If only controller parameters change, the experiment is built once and they are replaced.
        built = self._current(episode.scenario, episode.seed)
        values = leaf_values(built.controller, episode.candidate)
        return built._replace(controller=set_parameters(built.controller, values))

    def experiment(
        self, scenario: str, candidate: Candidate, seed: int | None = None
    ) -> Experiment:
        """Build the experiment of a scenario with a candidate's values.

        Args:
            scenario: name of the scenario.
            candidate: the values; empty for the current settings.
            seed: seed of the run; that of the settings when absent.

        Raises:
            ValueError: values that are not accepted.
        """
        return build(make_settings(self.entries(scenario, candidate, seed)))

    def settings(self, scenario: str, candidate: Candidate) -> RunSettings:
        """Return the settings of a scenario with a candidate's values.

        Raises:
            ValueError: values that are not accepted.
        """
        return make_settings(self.entries(scenario, candidate))

    def describe(self) -> dict[str, Any]:
        """Return all settings, and hashes of the files and modules that they name."""
        settings = {name: make_settings(entries) for name, entries in self._scenarios.items()}
        codes = {name: hash_user_code(each) for name, each in settings.items()}
        return {
            "scenarios": {
                name: each.model_dump(mode="json", exclude={"seed"})
                for name, each in settings.items()
            },
            "files": {name: file.content for name, file in self._files.items() if file},
            # Left out without any, so that former searches continue.
            **({"codes": codes} if any(codes.values()) else {}),
        }


def build_entries(entries: Entries, _: Episode, location: Entries) -> Experiment:
    """Build the experiment of an episode in a worker.

    `location` is the setting that locates the map or path on this machine.
    """
    return build(make_settings({**entries, **location}))


def find_shared_entries(scenarios: Mapping[str, Entries]) -> dict[str, Any]:
    """Return the entries that are the same in all scenarios."""
    first, *others = scenarios.values()
    return {
        name: value
        for name, value in first.items()
        if all(name in other and other[name] == value for other in others)
    }


def _find_file(entries: Entries) -> InputFile | None:
    """Return the file of the map, path or volume that settings name; None without one."""
    setting = find_kind(entries).selector
    name = entries.get(setting)
    if not isinstance(name, str) or entries.get("world") is not None or not Path(name).is_file():
        return None
    path = str(Path(name).absolute())
    # The image belongs to the map: another image is another content.
    content = b"".join(part or b"" for part in files_of(setting).read(path))
    return InputFile(setting, path, hashlib.sha256(content).hexdigest()[:16])


def _searchable_settings(settings: RunSettings) -> dict[str, Value]:
    """Return the settings that may be searched, by dotted name: those that affect the run."""
    entries = read_values(settings, "python")
    fixed = {*_FIXED, find_kind({}).selector, kind_of(settings).selector}
    architecture: Any = getattr(settings, "architecture", None)
    if is_own(architecture) and import_rule(architecture) is None:
        # A function makes its controller without them.
        fixed.add("controller")
    return _scalars({name: value for name, value in entries.items() if name not in fixed})


def _scalars(entries: Mapping[str, Any], prefix: str = "") -> dict[str, Value]:
    found: dict[str, Value] = {}
    for name, value in entries.items():
        if isinstance(value, Mapping):
            found |= _scalars(value, f"{prefix}{name}.")
        elif isinstance(value, bool | int | float | str):
            found[f"{prefix}{name}"] = value
    return found
