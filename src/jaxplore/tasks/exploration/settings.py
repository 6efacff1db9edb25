"""Settings of an exploration run."""

import importlib.resources
import os
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from jaxplore._spelling import match_spelling
from jaxplore.belief.perception import Perception
from jaxplore.dynamics.goal import Goal
from jaxplore.maps.files.ros import MapRules
from jaxplore.maps.generators.office import office
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.terrain import TerrainMap
from jaxplore.maps.world import is_world_file
from jaxplore.parts.registry import with_capabilities
from jaxplore.planning.presets.flight import Flight
from jaxplore.settings.architectures import ARCHITECTURES, QUADROTOR
from jaxplore.settings.code_names import WordsOrOwn
from jaxplore.settings.controllers import ControllerSettings, InformativeSettings, PortfolioSettings
from jaxplore.settings.defaults import difference_entries, setting
from jaxplore.settings.fleet import FleetSettings
from jaxplore.settings.parameter_names import under_their_settings
from jaxplore.settings.readers import Readers
from jaxplore.settings.robot import (
    CARS,
    GROUND_ROBOTS,
    CameraSettings,
    LidarSettings,
    RobotSettings,
    SensorModelSettings,
)
from jaxplore.settings.sections import (
    Body,
    Directions,
    Duration,
    Fraction,
    Length,
    Margin,
    Positive,
    Probability,
    Rate,
    Real,
    RunSettings,
    Section,
    Seed,
    Share,
    Spacing,
    Wait,
    Width,
    check_section,
)
from jaxplore.settings.sections import read_settings as read_settings
from jaxplore.simulation.exploration.scenario import ExplorationScenario

OFFICE = "office"
"""Name of the generated map."""
ZONES = "zones"
"""Name of the world with three unknown zones, for a quadrotor."""

SCENARIOS = ("warehouse", "search-rescue", "perimeter")
"""Scenarios for ground vehicles: settings with a world, in `scenarios/`."""


def _is_office(settings: Any) -> bool:
    # Beside a `world`, the map is only a name.
    return settings.world is None and settings.map == OFFICE


def _is_world(settings: Any) -> bool:
    if settings.world is not None or settings.map == ZONES:
        return True
    return settings.map != OFFICE and is_world_file(settings.map)


def _has_height_map(settings: Any) -> bool:
    return settings.terrain.height_map is not None and not _is_office(settings)


IN_OFFICE = Readers("the map office", _is_office, "map")
ON_ROS_MAPS = Readers("ROS maps", lambda s: not _is_office(s) and not _is_world(s), "map")
NOT_IN_WORLDS = Readers("the map office, ROS maps", lambda s: not _is_world(s), "map")
NOT_IN_OFFICE = Readers("ROS maps, worlds", lambda s: not _is_office(s), "map")
WITH_HEIGHTS = Readers("ROS maps with a height map", _has_height_map)
WITH_GROUND = Readers(
    "worlds, ROS maps with a height map", lambda s: _is_world(s) or _has_height_map(s)
)


class MapFileSettings(Section):
    """How the image of a ROS map is read: see `jaxplore.maps.files.ros.read_map`."""

    readers = ON_ROS_MAPS

    rules: MapRules = setting(OccupancyGrid.from_ros, "rules")
    unknown: Annotated[int, Field(ge=0, le=255)] | None = setting(OccupancyGrid.from_ros, "unknown")


class OfficeSettings(Section):
    """The generated office: see `jaxplore.office`."""

    readers = IN_OFFICE

    seed: Seed = setting(office, "seed")
    width: Width = setting(office, "width")
    height: Width = setting(office, "height")


class TerrainSettings(Section):
    """The ground: see `jaxplore.maps.Ground`.

    Args:
        height_map: grey image of the size of the ROS map's; level ground when absent.
    """

    readers = WITH_GROUND

    height_map: Annotated[str | None, NOT_IN_OFFICE] = None
    elevation_scale: Annotated[Positive, WITH_HEIGHTS] = setting(
        TerrainMap.from_images, "elevation_scale"
    )
    max_slope: Positive = setting(Ground, "max_slope")
    max_roughness: Positive | None = setting(Ground, "max_roughness")
    threshold: Fraction = setting(Ground, "threshold")


class FieldSettings(Section):
    """The information and guidance fields: see `jaxplore.Perception`."""

    num_directions: Directions = setting(Perception, "num_directions")
    node_spacing: Spacing = setting(Perception, "node_spacing")
    max_clearance: Body = setting(Perception, "max_clearance")
    margin: Margin = setting(Perception, "margin")
    decay_length: Positive = setting(Perception, "decay_length")
    min_information: Positive | None = setting(Perception, "min_information")
    occupancy_prior: Probability = setting(Perception, "occupancy_prior")
    patience: Positive = setting(Perception, "patience")
    memory: Positive = setting(Perception, "memory")


class RatesSettings(Section):
    """Rates of control, sensing and fields: see `jaxplore.ExplorationScenario`."""

    control: Rate = setting(ExplorationScenario, "control_rate")
    sensing: Rate = setting(ExplorationScenario, "sensing_rate")
    fields: Rate = setting(ExplorationScenario, "field_rate")


class Settings(RunSettings):
    """Settings of an exploration run; a setting that is not given has its default.

    A checked run has those of `ExplorationSettings`, with a section for each capability.

    Args:
        map: YAML file of a ROS map or of a world (`jaxplore.World`), `office` or `zones`; beside a
            `world`, its name.
        world: the entries of a world, instead of its file.
        architecture: architecture of the controller. For robots on the ground `explorer`,
            `portfolio`, or a rule-based explorer by the name of its rule, such as
            `nearest-frontier`. For any robot, by default a quadrotor, informative MPPI, which is
            `two-layer`, `parallel` or `sequential` (two-layer from zone to zone of a world), or a
            baseline, `random-walk` or `goal`, which drives straight to the goal. Or MODULE:NAME of
            your own, a rule (`jaxplore.planning.TargetRule`) or a function from a scenario to a
            controller.
        goal: goal position (x, y) or (x, y, z) [m]; a world may define its own.
        returns: whether the robot drives back to its start when it has nothing left to learn; the
            start is then the goal.
        time_limit: simulated time [s].
        map_file: how the image of a ROS map is read.
        office: the generated office, for the map `office`.
        robot: the robot.
        lidar: the lidar of the robot.
        camera: the camera, which becomes the primary sensor; no camera when absent.
        is_map_known: whether the robot knows the map in advance; a world has entries for what it
            knows.
        terrain: the ground.
        sensor_model: inverse sensor model, the update of a cell by a measurement.
        fields: the information and guidance fields.
        controller: MPPI of the architecture `explorer` and of the rule-based explorers.
        portfolio: settings of the architecture `portfolio`.
        informative: settings of informative MPPI and of its baselines.
        rates: rates of control, sensing and fields.
        guard: whether the robot brakes while its pose, its scan or its motion cannot be true, and
            before what its scan has met: see `jaxplore.MotionGuard`.
        fleet: several robots that share what they know; one robot when absent.
    """

    map: str
    world: dict[str, Any] | None = None
    architecture: Annotated[str, WordsOrOwn(ARCHITECTURES)] = "explorer"
    goal: tuple[Real, Real] | tuple[Real, Real, Real] | None = None
    returns: bool = False
    goal_radius: Length = setting(Goal, "radius")
    goal_heading: Real | None = setting(Goal, "heading")
    goal_tolerance: Positive = setting(Goal, "tolerance")
    goal_speed: Positive = setting(Goal, "speed")
    max_unknown: Fraction | None = setting(Goal, "max_unknown")
    hover_time: Wait = setting(ExplorationScenario, "hover_time")
    is_map_known: Annotated[bool, NOT_IN_WORLDS] = False
    altitude: Real = setting(Flight, "altitude")
    resolution: Annotated[Spacing, NOT_IN_WORLDS] = setting(office, "resolution")
    time_limit: Duration = 900.0
    target: Literal["coverage", "information", "walls", "never"] | None = setting(
        ExplorationScenario, "target"
    )
    target_coverage: Share | None = setting(ExplorationScenario, "target_coverage")
    give_up_after: Duration | None = setting(ExplorationScenario, "give_up_after")
    map_file: MapFileSettings = MapFileSettings()
    office: OfficeSettings = OfficeSettings()
    robot: RobotSettings = RobotSettings()
    lidar: LidarSettings = LidarSettings()
    camera: CameraSettings | None = None
    terrain: TerrainSettings = TerrainSettings()
    sensor_model: SensorModelSettings = SensorModelSettings()
    fields: FieldSettings = FieldSettings()
    controller: ControllerSettings = ControllerSettings()
    portfolio: PortfolioSettings = PortfolioSettings()
    informative: InformativeSettings = InformativeSettings()
    rates: RatesSettings = RatesSettings()
    guard: bool = True
    fleet: FleetSettings | None = None


ExplorationSettings = with_capabilities(Settings)
"""The settings with a section for each capability of the registry."""


def scenario_path(name: str) -> Path:
    """Return the settings file of one of the `SCENARIOS`."""
    return (
        Path(str(importlib.resources.files("jaxplore.tasks.exploration")))
        / "scenarios"
        / f"{name}.yaml"
    )


def is_scenario_file(path: str | os.PathLike[str]) -> bool:
    """Check whether a YAML file is a scenario: settings that contain a world."""
    try:
        # Nothing is made of these entries.
        entries = read_settings(path, is_trusted=True)
    except ValueError:
        return False
    return "world" in entries


def make_exploration_settings(entries: dict[str, Any]) -> Settings:
    """Check settings entries of an exploration run, and fill in defaults."""
    entries = _with_defaults(entries)
    # The other architectures have no section `controller`, or drive with it inside of another one.
    explored_by = ExplorationSettings.model_fields["architecture"].default
    if entries.get("architecture", explored_by) == explored_by:
        entries = under_their_settings(entries, ControllerSettings)
    return check_section(ExplorationSettings, entries)


def _with_defaults(entries: dict[str, Any]) -> dict[str, Any]:
    """Merge the entries over the defaults of their architecture and map."""
    entries = {**entries}
    for name, words in (("map", SCENARIOS), ("architecture", ARCHITECTURES)):
        if name in entries:
            entries[name] = match_spelling(entries[name], words)
    # Saved settings contain the world beside the name of the scenario, which is then not read.
    if entries.get("map") in SCENARIOS and entries.get("world") is None:
        entries = merge_entries(read_settings(scenario_path(entries["map"])), entries)
    if entries.get("map") == ZONES:
        entries = {"architecture": "two-layer", "time_limit": 60.0, **entries}
    robot = entries.get("robot")
    model = robot.get("model") if isinstance(robot, dict) else None
    for kind, models in (("car", CARS), ("bicycle", ("bicycle",))):
        if model in models:
            entries = merge_entries(difference_entries(kind), entries)
    # A robot on the ground has the sensors that it has in the other architectures.
    if entries.get("architecture") not in QUADROTOR or model in GROUND_ROBOTS:
        return entries
    return merge_entries(difference_entries("quadrotor"), entries)


def merge_entries(defaults: dict[str, Any], entries: dict[str, Any]) -> dict[str, Any]:
    """Merge entries over defaults, section by section."""
    merged = {**defaults, **entries}
    for name, section in defaults.items():
        given = merged[name]
        # An entry that is no section stays as it is, and the check refuses it.
        if isinstance(section, dict) and isinstance(given, dict):
            merged[name] = {**section, **given}
    return merged
