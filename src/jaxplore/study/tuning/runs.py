"""Episodes of runs that are described by settings, here, in processes or on a cluster."""

import contextlib
import dataclasses
import functools
import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from jaxplore.build.tasks import build
from jaxplore.control.base import Controller
from jaxplore.maps.files.packing import PACKED, find_image, pack_map
from jaxplore.parameters import get_parameters, nearest, set_parameters
from jaxplore.settings.exploration import BASELINES, Settings, make_exploration_settings
from jaxplore.settings.path import PathSettings, make_path_settings
from jaxplore.simulation.experiment import Experiment
from jaxplore.study.tuning.built import Runner, run_alone
from jaxplore.study.tuning.controllers import leaf_elements, leaf_value, leaf_values
from jaxplore.study.tuning.episodes import Ask, Episodes, Outcome
from jaxplore.study.tuning.space import Candidate, Value
from jaxplore.study.workers.job import Files, Job, Read
from jaxplore.study.workers.pool import Pool

Entries = Mapping[str, Any]
"""Settings as in a settings file."""

PARAMETERS = "parameters"
"""The setting that holds numbers of the controller by path."""
_FIXED = ("map", "world", "seed", "start", "goal", "path", "architecture", PARAMETERS)
"""Settings that say where and what is run, not how well."""
_OF_CONTROLLERS = ("controller", "portfolio", "informative")


class Kind(NamedTuple):
    """A kind of run: across a map, or along a path."""

    is_path: bool

    def settings(self, entries: Entries) -> Settings | PathSettings:
        """Return checked settings."""
        return (
            make_path_settings(dict(entries))
            if self.is_path
            else make_exploration_settings(dict(entries))
        )

    def build(self, entries: Entries) -> Experiment:
        """Return the run that settings describe."""
        settings = self.settings(entries)
        return build(settings)


class SettingsEpisodes(Episodes):
    """Episodes of one or several scenarios that are described by settings.

    Parameters are settings, `controller.temperature`, or numbers of the controller by their path,
    `cost.information.weight`: see `jaxplore.get_parameters`.

    Args:
        scenarios: entries of the settings, by name.
        is_path: whether they are runs along a path.
        batch: candidates side by side, by `jax.vmap`.
        pool: workers to give the episodes to; they are run here when absent.

    Raises:
        ValueError: settings that are not accepted, a file that cannot be read, a batch for workers.
    """

    def __init__(
        self,
        scenarios: Mapping[str, Entries],
        *,
        is_path: bool = False,
        batch: int = 1,
        pool: Pool | None = None,
    ) -> None:
        if batch > 1 and pool is not None:
            raise ValueError(f"batch is {batch} with workers; accepted: one of them")
        if not scenarios:
            raise ValueError("scenarios is empty; accepted: at least one")
        self.kind = Kind(is_path)
        self._scenarios = {name: dict(entries) for name, entries in scenarios.items()}
        self._pool, self._runner = pool, Runner(self._build, batch)
        self._files = {name: _file_of(entries) for name, entries in self._scenarios.items()}
        first = next(iter(self._scenarios.values()))
        self._settings = self.kind.settings(first)
        self._known = _settings_of(self._settings)
        self._built: dict[tuple[str, int | None], Experiment] = {}
        for name in self._scenarios:
            # What cannot be read is told before anything is tried out.
            self._as_it_is(name, None)

    @property
    def example(self) -> Experiment:
        """The first scenario's run with the settings as they are."""
        return self._as_it_is(self.scenarios[0], None)

    @property
    def _controller(self) -> Controller:
        return self.example.controller

    def _as_it_is(self, scenario: str, seed: int | None) -> Experiment:
        """Return a scenario's run with the settings as they are, which is built once."""
        at = (scenario, seed)
        if at not in self._built:
            self._built[at] = self.kind.build(self.entries(scenario, {}, seed))
        return self._built[at]

    @property
    def scenarios(self) -> tuple[str, ...]:
        """Names of the scenarios."""
        return tuple(self._scenarios)

    def entries(self, scenario: str, candidate: Candidate, seed: int | None = None) -> Entries:
        """Return the entries of a scenario's settings with a candidate's values.

        Args:
            scenario: its name.
            candidate: the values; empty for the settings as they are.
            seed: of the run; that of the settings when absent.
        """
        inside = [name for name in candidate if name not in self._known]
        # Elements of an array that are not searched stay as they are for this one's robot.
        arrays = self._as_it_is(scenario, None).controller if inside else None
        return self._with_values(self._scenarios[scenario], candidate, seed, arrays)

    def with_values(self, entries: Entries, candidate: Candidate) -> dict[str, Any]:
        """Return what scenarios have in common with a candidate's values."""
        return self._with_values(entries, candidate, None, self._controller)

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
        """Return what a setting, or a number of the controller, is now."""
        if name in self._known:
            return self._known[name]
        with self._nearest(name):
            return leaf_value(self._controller, name)

    @contextlib.contextmanager
    def _nearest(self, name: str) -> Iterator[None]:
        """Name settings too where a name is neither a setting nor a path."""
        try:
            yield
        except ValueError as error:
            if " is not known" not in str(error):
                raise
            everything = {**self._known, **get_parameters(self._controller)}
            raise ValueError(
                f"parameter {name} is not known; accepted: such as {nearest(name, everything)}"
            ) from None

    def elements(self, name: str) -> tuple[str, ...]:
        """Return the name, or of an array of the controller one for each of its elements."""
        if name in self._known:
            return (name,)
        with self._nearest(name):
            return leaf_elements(self._controller, name)

    def run(self, asks: Sequence[Ask], on_done: Callable[[Ask, Outcome], None]) -> None:
        """Run episodes here, one after the other or a batch at a time, or give them to workers."""
        if self._pool is not None:
            jobs = [
                Episode(
                    ask,
                    self.kind,
                    self.entries(ask.scenario, ask.candidate, ask.seed),
                    self._files[ask.scenario],
                )
                for ask in asks
            ]
            self._pool.do(jobs, lambda job, outcome: on_done(job.ask, outcome))
            return
        self._runner.run(asks, on_done)

    def _build(self, ask: Ask) -> Experiment:
        if any(name in self._known for name in ask.candidate):
            return self.kind.build(self.entries(ask.scenario, ask.candidate, ask.seed))
        # Numbers of the controller only: the rest is built once.
        built = self._as_it_is(ask.scenario, ask.seed)
        values = leaf_values(built.controller, ask.candidate)
        return built._replace(controller=set_parameters(built.controller, values))

    def settings(self, scenario: str, candidate: Candidate) -> Settings | PathSettings:
        """Return a scenario's settings with a candidate's values, to be written down.

        Raises:
            ValueError: values that are not accepted.
        """
        return self.kind.settings(self.entries(scenario, candidate))

    def describe(self) -> dict[str, Any]:
        """Return all settings, and what is in the files they name."""
        return {
            "scenarios": {
                name: self.kind.settings(entries).model_dump(mode="json", exclude={"seed"})
                for name, entries in self._scenarios.items()
            },
            "files": {name: _content(file) for name, file in self._files.items() if file},
        }


@dataclasses.dataclass(frozen=True)
class Episode(Job):
    """An episode as workers are given it.

    Args:
        ask: which.
        how: the kind of run.
        entries: of its settings, with the candidate's values.
        file: its map or path; None if it has none.
    """

    ask: Ask
    how: Kind
    entries: Entries
    file: str | None

    @property
    def id(self) -> str:
        """Candidate, scenario and seed."""
        return f"{self.ask.number} {self.ask.scenario} {self.ask.seed}"

    @property
    def group(self) -> str:
        """The scenario."""
        return self.ask.scenario

    def files(self) -> Mapping[str, Read]:
        """Return what reads the map or the path."""
        if self.file is None:
            return {}
        return {_content(self.file): functools.partial(_packed, self.file, self.how.is_path)}

    def located(self, folders: Mapping[str, Path]) -> "Episode":
        """Return the same episode with a copy of its file."""
        if self.file is None:
            return self
        folder = folders[_content(self.file)]
        name = Path(self.file).name if self.how.is_path else PACKED
        where = "path" if self.how.is_path else "map"
        return dataclasses.replace(self, entries={**self.entries, where: str(folder / name)})

    def run(self) -> Outcome:
        """Run it."""
        try:
            return run_alone(self.how.build(self.entries), self.ask.seed, self.ask.time_limit)
        except Exception as error:
            kind = "" if isinstance(error, ValueError) else f"{type(error).__name__}: "
            return Outcome({}, kind + str(error))

    def failed(self, reason: str) -> Outcome:
        """Return that it failed."""
        return Outcome({}, reason)


def _file_of(entries: Entries) -> str | None:
    """Return the file that settings name as their map or path."""
    name = entries.get("path", entries.get("map"))
    if not isinstance(name, str) or entries.get("world") is not None or not Path(name).is_file():
        return None
    return str(Path(name).absolute())


def _packed(path: str, is_path: bool) -> Files:
    return {Path(path).name: Path(path).read_bytes()} if is_path else pack_map(path)


@functools.cache
def _content(path: str) -> str:
    parts = [Path(path).read_bytes()]
    if path.endswith((".yaml", ".yml")):
        image = find_image(path)
        parts += [] if image is None else [image.read_bytes()]
    return hashlib.sha256(b"".join(parts)).hexdigest()[:16]


def _settings_of(settings: Settings | PathSettings) -> dict[str, Value]:
    """Return the settings that may be searched, by dotted name: those that this run reads."""
    entries = settings.model_dump(mode="python", exclude=set(_FIXED))
    if isinstance(settings, Settings):
        read = _SECTION.get(settings.architecture, "informative")
        for section in _OF_CONTROLLERS:
            if section != read:
                del entries[section]
    return _scalars(entries)


_SECTION = {"explorer": "controller", "portfolio": "portfolio"} | dict.fromkeys(
    BASELINES, "controller"
)
"""Of each architecture, the section with the numbers of its controller."""


def _scalars(entries: Mapping[str, Any], prefix: str = "") -> dict[str, Value]:
    found: dict[str, Value] = {}
    for name, value in entries.items():
        if isinstance(value, Mapping):
            found |= _scalars(value, f"{prefix}{name}.")
        elif isinstance(value, bool | int | float | str):
            found[f"{prefix}{name}"] = value
    return found
