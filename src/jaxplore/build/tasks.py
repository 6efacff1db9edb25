"""Kinds of runs: which settings belong to which, and how each is built."""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxplore.build.exploration import build_exploration, compared_architectures
from jaxplore.build.path import build_path_following
from jaxplore.settings.exploration import Settings, make_exploration_settings
from jaxplore.settings.path import PATH, TRACK, PathSettings, make_path_settings
from jaxplore.settings.sections import RunSettings
from jaxplore.simulation.experiment import Experiment


class Task(NamedTuple):
    """A kind of run.

    Args:
        place: the setting that names where it is, by which its entries are known.
        settings: class of its settings.
        check: returns settings for entries.
        build: returns the run that settings describe.
        architectures: returns the architectures to compare where nothing else is asked for; none
            where there are no architectures.
    """

    place: str
    settings: type[RunSettings]
    check: Callable[[dict[str, Any]], RunSettings]
    build: Callable[[Any], Experiment]
    architectures: Callable[[dict[str, Any]], tuple[str, ...]]


TASKS = {
    "exploration": Task(
        "map", Settings, make_exploration_settings, build_exploration, compared_architectures
    ),
    "path": Task("path", PathSettings, make_path_settings, build_path_following, lambda _: ()),
}
"""By name. The first is that of entries that name no place."""


def make_settings(entries: dict[str, Any]) -> RunSettings:
    """Return checked settings of the kind of run that entries describe.

    Entries with a `path`, or with the map `path`, are a run along a path; all others explore.

    Args:
        entries: names and values of settings, as in a settings file.

    Raises:
        ValueError: a path beside a map, an unknown name or a value that is not accepted; one line
            that names it.
    """
    entries = _with_path(entries)
    return task_of(entries).check(entries)


def task_of(entries: dict[str, Any]) -> Task:
    """Return the kind of run that entries describe; see `make_settings`.

    Raises:
        ValueError: a path beside a map.
    """
    entries = _with_path(entries)
    named = [task for task in TASKS.values() if task.place in entries]
    if len(named) > 1:
        given = " beside ".join(f"the {task.place} {entries[task.place]!r}" for task in named)
        raise ValueError(f"settings have {given}; accepted: one of them")
    return named[0] if named else TASKS["exploration"]


def _with_path(entries: dict[str, Any]) -> dict[str, Any]:
    """Return entries whose map `path` has become the path `track`."""
    # With a world of its own, `map` is a name that users choose.
    if entries.get("map") != PATH or entries.get("world") is not None:
        return entries
    rest = {name: value for name, value in entries.items() if name != "map"}
    return {PATH: TRACK, **rest}


def build(settings: RunSettings) -> Experiment:
    """Return the controller, scenario, number of steps and key that settings describe.

    Raises:
        ValueError: a file that cannot be read, a start that is not possible, a part that does not
            accept its settings.
    """
    tasks = {task.settings: task for task in TASKS.values()}
    return tasks[type(settings)].build(settings)
