"""Kinds of tasks: the settings of each, and the function that builds it."""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxplore.settings.sections import RunSettings
from jaxplore.simulation.experiment import Experiment
from jaxplore.tasks.exploration.build import build_exploration, choose_architectures, with_start
from jaxplore.tasks.exploration.settings import Settings, make_exploration_settings
from jaxplore.tasks.path.build import build_path_following
from jaxplore.tasks.path.settings import PATH, TRACK, PathSettings, make_path_settings
from jaxplore.tasks.volume.build import build_volume
from jaxplore.tasks.volume.build import with_start as with_start_in_volume
from jaxplore.tasks.volume.settings import GENERATED, VOLUME, VolumeSettings, make_volume_settings


class Task(NamedTuple):
    """A kind of task: the class of its settings, and functions of entries and settings.

    Entries that have the setting `selector`, which names the map or path, are of this kind.
    `architectures` returns those to compare by default; none for a task without architectures.
    `with_start` adds a start to entries where a map has none.
    """

    selector: str
    settings: type[RunSettings]
    check: Callable[[dict[str, Any]], RunSettings]
    build: Callable[[Any], Experiment]
    architectures: Callable[[dict[str, Any]], tuple[str, ...]]
    with_start: Callable[[dict[str, Any]], dict[str, Any]]


COMPARED = ("explorer", "nearest-cluster", "next-best-view", "gain-per-cost")
"""Architectures that are compared in a volume by default."""
TASKS = {
    "exploration": Task(
        "map",
        Settings,
        make_exploration_settings,
        build_exploration,
        choose_architectures,
        with_start,
    ),
    # A path begins where it begins.
    "path": Task(
        "path",
        PathSettings,
        make_path_settings,
        build_path_following,
        lambda _: (),
        lambda entries: entries,
    ),
    "volume": Task(
        VOLUME,
        VolumeSettings,
        make_volume_settings,
        build_volume,
        lambda _: COMPARED,
        with_start_in_volume,
    ),
}
"""Kinds of tasks by name. The first is the default."""


def make_settings(entries: dict[str, Any]) -> RunSettings:
    """Check entries, and return settings of the kind of task that they describe.

    Entries with a `path`, or with the map `path`, describe path following, those with a `volume`
    the exploration of a volume, and all others that of a plane.

    Raises:
        ValueError: a path or a volume beside a map, an unknown name or a value that is not
            accepted; one line that names it.
    """
    entries = _with_selector(entries)
    return find_task(entries).check(entries)


def find_task(entries: dict[str, Any]) -> Task:
    """Return the kind of task that entries describe; see `make_settings`."""
    entries = _with_selector(entries)
    named = [task for task in TASKS.values() if task.selector in entries]
    if len(named) > 1:
        given = " beside ".join(f"the {task.selector} {entries[task.selector]!r}" for task in named)
        raise ValueError(f"settings have {given}; accepted: one of them")
    return named[0] if named else TASKS["exploration"]


def _with_selector(entries: dict[str, Any]) -> dict[str, Any]:
    """Replace the map `path` by the path `track`, and a map named like a volume by that volume."""
    name = entries.get("map")
    # Beside a `world`, `map` is a free name and selects nothing.
    if not isinstance(name, str) or entries.get("world") is not None:
        return entries
    rest = {each: value for each, value in entries.items() if each != "map"}
    if name == PATH:
        return {PATH: TRACK, **rest}
    return {VOLUME: name, **rest} if name in (VOLUME, *GENERATED) else entries


def build(settings: RunSettings) -> Experiment:
    """Build the experiment that settings describe.

    Raises:
        ValueError: a file that cannot be read, a start that is not possible, or settings that a
            part rejects.
    """
    tasks = {task.settings: task for task in TASKS.values()}
    return tasks[type(settings)].build(settings)
