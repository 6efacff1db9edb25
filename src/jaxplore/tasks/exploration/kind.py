"""The kind of task in which a robot explores a plane, or a fleet of several robots."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jaxplore._files import YAML_SUFFIXES
from jaxplore.report.exploration.data import ExplorationData
from jaxplore.settings.fleet import FLEET
from jaxplore.settings.sections import read_settings
from jaxplore.tasks.exploration.build import build_exploration, choose_architectures, with_start
from jaxplore.tasks.exploration.memory import estimate_exploration
from jaxplore.tasks.exploration.on_maps import ON_ROS_MAPS
from jaxplore.tasks.exploration.scene import ExplorationScene
from jaxplore.tasks.exploration.settings import (
    OFFICE,
    SCENARIOS,
    ZONES,
    ExplorationSettings,
    is_scenario_file,
    make_exploration_settings,
)
from jaxplore.tasks.exploration.topics import ExplorationContent
from jaxplore.tasks.kind import Kind, Shown


def read_map_entries(file: str, is_trusted: bool) -> Mapping[str, Any]:
    """Return the entries of a run on a map, or in the world of a scenario.

    A scenario that names code must be trusted.
    """
    named = {"map": str(Path(file).absolute())}
    if is_scenario_file(file):
        return {**named, **read_settings(file, is_trusted=is_trusted)}
    return named


EXPLORATION = Kind(
    name="exploration",
    title="Exploration",
    place="on a map",
    selector="map",
    settings=ExplorationSettings,
    check=make_exploration_settings,
    build=build_exploration,
    needs=estimate_exploration,
    places={name: {"map": name} for name in (OFFICE, ZONES, *SCENARIOS)},
    words={FLEET: {"map": OFFICE, FLEET: {}}},
    suffixes=YAML_SUFFIXES,
    files="the YAML file of a ROS map, of a world or of a scenario",
    read=read_map_entries,
    architectures=choose_architectures,
    with_start=with_start,
    on_maps=ON_ROS_MAPS,
    shown=(Shown(ExplorationData, ExplorationScene, ExplorationContent, is_relative=True),),
)
