"""The runs of a benchmark: what each is made from, and what tells it from the others."""

import dataclasses
import functools
import hashlib
import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, get_args

from jaxplore.settings.exploration import OFFICE, Architecture, Settings, make_exploration_settings
from jaxplore.study.comparison.maps import MapFile

FORMAT = 3
"""Version of what a benchmark writes: raised when former results would mean something else, also
because a default or an explorer is another one."""


@dataclasses.dataclass(frozen=True)
class Task:
    """One run of one explorer on one map.

    Args:
        map: name of the map.
        path: of its YAML file.
        content: hash of the map.
        explorer: the setting `architecture`.
        seed: the setting `seed`.
        settings: the entries of all other settings, plain values that JSON can hold. Without a
            `start` the robot begins at the most open spot, heading along x.
        batch: runs of consecutive seeds that are computed side by side, by `jax.vmap`: those whose
            `seed // batch` is the same. Rounding depends on it.
        copy: where the YAML file is on this machine; at `path` when absent.
    """

    map: str
    path: str
    content: str
    explorer: str
    seed: int
    settings: Mapping[str, Any]
    batch: int = 1
    copy: str | None = None

    @functools.cached_property
    def id(self) -> str:
        """What this run is known by: 20 hexadecimal digits.

        A hash of all but where the map is, so that results outlast a folder that moves. That a run
        is computed alone need not be said.
        """
        told = {"format": FORMAT, **dataclasses.asdict(self)}
        del told["path"], told["copy"]
        if self.batch == 1:
            del told["batch"]
        return hashlib.sha256(canonical(told).encode()).hexdigest()[:20]

    @property
    def entries(self) -> dict[str, Any]:
        """The entries of all settings."""
        own = {"map": self.copy or self.path, "architecture": self.explorer, "seed": self.seed}
        return {**self.settings, **own}

    @property
    def group(self) -> tuple[str, str]:
        """Map and explorer: tasks of one group run the same compiled loop."""
        return self.map, self.explorer

    @property
    def seeds(self) -> range:
        """The seeds of its batch. All of them are run, whichever are asked for: what a run comes to
        must not depend on which others are still to be done."""
        first = self.seed - self.seed % self.batch
        return range(first, first + self.batch)


Batch = tuple[Task, ...]
"""Tasks that are done together: of the same map and explorer, and with the same `seeds`."""


def batches_of(tasks: Iterable[Task]) -> tuple[Batch, ...]:
    """Return tasks by what is done together, sorted by map, explorer and seed."""

    def together(task: Task) -> tuple[str, str, int]:
        return (*task.group, task.seeds.start)

    in_order = sorted(tasks, key=lambda task: (*task.group, task.seed))
    return tuple(tuple(each) for _, each in itertools.groupby(in_order, together))


def make_tasks(
    maps: Sequence[MapFile],
    explorers: Sequence[str],
    seeds: Sequence[int],
    settings: Mapping[str, Any],
    batch: int = 1,
) -> tuple[Task, ...]:
    """Return a task for each map, explorer and seed, in this order.

    Args:
        maps: at least one.
        explorers: settings `architecture`, at least one.
        seeds: whole numbers >= 0, at least one.
        settings: entries that all of them share; see `common_settings`.
        batch: runs computed side by side.

    Raises:
        ValueError: a batch < 1; nothing of a kind, or something twice; an explorer that there is
            not; settings that are not accepted; explorers that do not drive the same robot.
    """
    if batch < 1:
        raise ValueError(f"batch is {batch}; accepted: a whole number >= 1")
    kinds: dict[str, list[Any]] = {
        "maps": [each.name for each in maps],
        "explorers": list(explorers),
        "seeds": list(seeds),
    }
    for kind, values in kinds.items():
        if not values or len(set(values)) != len(values):
            raise ValueError(f"{kind} is {values}; accepted: different ones, at least one")
    known = get_args(Architecture)
    for explorer in explorers:
        if explorer not in known:
            raise ValueError(f"explorer is {explorer!r}; accepted: {', '.join(known)}")
    common = common_settings(settings)
    for seed in (min(seeds), max(seeds)):
        make_exploration_settings({"map": OFFICE, "seed": seed})
    _check_alike(
        {
            each: make_exploration_settings({**common, "map": OFFICE, "architecture": each})
            for each in explorers
        }
    )
    return tuple(
        Task(
            each.name,
            each.path,
            each.content,
            explorer,
            seed,
            {**common, **({} if each.start is None else {"start": list(each.start)})},
            batch,
        )
        for each in maps
        for explorer in explorers
        for seed in seeds
    )


def common_settings(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries that all runs share as they are written: 900 and 900.0 are one time limit.

    Args:
        settings: entries; map, architecture and seed are each run's own and are left out.

    Raises:
        ValueError: an entry that is not accepted.
    """
    shared = {name: value for name, value in settings.items() if name not in _OWN}
    given = make_exploration_settings({**shared, "map": OFFICE})
    return given.model_dump(mode="json", exclude_unset=True, exclude=set(_OWN))


_OWN = ("map", "architecture", "seed")
_ALIKE = ("robot", "lidar", "camera", "sensor_model", "rates")


def _check_alike(settings: Mapping[str, Settings]) -> None:
    """Refuse explorers of which one has another robot or sees more than the others."""
    first, *others = settings
    for other in others:
        for section in _ALIKE:
            if getattr(settings[first], section) != getattr(settings[other], section):
                raise ValueError(
                    f"explorers {first} and {other} differ in the settings {section}; accepted: "
                    "explorers that drive the same robot with the same sensor"
                )


def canonical(value: Any) -> str:
    """Return plain values as JSON, the same text for the same values.

    Raises:
        ValueError: what JSON cannot hold.
    """
    try:
        return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise ValueError(f"settings are no JSON: {error}; accepted: plain values") from None
