"""Kinds of runs: which settings belong to which, and how each is built."""

from collections.abc import Callable
from typing import Any, NamedTuple

from jaxplore.build.exploration import build_exploration
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
    """

    place: str
    settings: type[RunSettings]
    check: Callable[[dict[str, Any]], RunSettings]
    build: Callable[[Any], Experiment]


TASKS = {
    "exploration": Task("map", Settings, make_exploration_settings, build_exploration),
    "path": Task("path", PathSettings, make_path_settings, build_path_following),
}
"""By name. The first is that of entries that name no place."""


def make_settings(entries: dict[str, Any]) -> RunSettings:
    """Return checked settings of the kind of run that entries describe.

    Entries with a `path`, or with the map `path`, are a run along a path; all others explore.

    Args:
        entries: names and values as in a settings file.

    Raises:
        ValueError: a path beside a map, an unknown name or a value that is not accepted; one line
            that names it.
    """
    map_ = entries.get("map")
    # With a world of its own, `map` is a name that users choose.
    if map_ == PATH and entries.get("world") is None:
        entries = {PATH: TRACK, **entries}
        del entries["map"]
    named = [task for task in TASKS.values() if task.place in entries]
    if len(named) > 1:
        given = " beside ".join(f"the {task.place} {entries[task.place]!r}" for task in named)
        raise ValueError(f"settings have {given}; accepted: one of them")
    task = named[0] if named else TASKS["exploration"]
    return task.check(entries)


def build(settings: RunSettings) -> Experiment:
    """Return the controller, scenario, number of steps and key that settings describe.

    Raises:
        ValueError: a file that cannot be read, a start that is not possible, a part that does not
            accept its settings.
    """
    tasks = {task.settings: task for task in TASKS.values()}
    return tasks[type(settings)].build(settings)
