"""Every setting of a run, from a YAML file or the command line."""

import importlib.resources
import os
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from jaxplore.settings.sections import (
    Count,
    Negative,
    NonNegative,
    Parameters,
    Positive,
    Section,
    Share,
    validated,
)
from jaxplore.settings.sections import read_settings as read_settings

Architecture = Literal[
    "explorer",
    "portfolio",
    "wander",
    "random-frontier",
    "nearest-frontier",
    "gain-per-cost",
    "next-best-view",
    "discounted-information",
    "distance-advantage",
    "two-layer",
    "parallel",
    "sequential",
    "random-walk",
    "goal",
]
BASELINES = (
    "wander",
    "random-frontier",
    "nearest-frontier",
    "gain-per-cost",
    "next-best-view",
    "discounted-information",
    "distance-advantage",
)
"""Explorers that go from target to target by a rule: see `jaxplore.TargetRule`."""
GROUND = ("explorer", "portfolio", *BASELINES)
"""Architectures of ground vehicles; the others are a quadrotor's unless another robot is named."""

OFFICE = "office"
"""The map that is generated instead of read."""
ZONES = "zones"
"""The world with three unknown zones of the quadrotor design notes."""

SCENARIOS = ("warehouse", "search-rescue", "perimeter")
"""Scenarios of the ground vehicles' design notes: settings with a world, in `scenarios/`."""

FLIGHT: dict[str, Any] = {
    "robot": {"model": "quadrotor", "radius": 0.3, "max_speed": 2.0},
    "lidar": {
        "num_beams": 24,
        "max_range": 4.0,
        "field_of_view_degrees": 90.0,
        "range_noise": 0.0,
    },
    "sensor_model": {"kind": "line_of_sight"},
    "fields": {"min_information": 3.0, "occupancy_prior": 0.5},
    "rates": {"sensing": 50.0},
}
"""What differs by default for architectures that are not in `GROUND`: a quadrotor with a camera."""


class OfficeSettings(Section):
    """The generated office: seed of its plan, size and cells [m]."""

    seed: Annotated[int, Field(ge=0)] = 0
    width: Positive = 20.0
    height: Positive = 14.0


class RobotSettings(Section):
    """The robot: model, bounds [m/s, rad/s, m/s^2, rad/s^2], drag [1/s] and radius [m].

    A car (`ackermann`) has a wheelbase, a length and a width [m] instead of a radius, and steering
    [rad, rad/s]. A quadrotor has a radius, a speed limit that is a cost, and a mass [kg].
    """

    model: Literal["differential_drive", "unicycle", "ackermann", "quadrotor"] = (
        "differential_drive"
    )
    max_speed: Positive = 1.0
    max_turn_rate: Positive = 2.0
    max_acceleration: Positive = 1.0
    max_angular_acceleration: Positive = 2.0
    drag: NonNegative = 0.1
    radius: Positive = 0.2
    mass: Positive = 1.0
    wheelbase: Positive = 0.5
    length: Positive = 0.75
    width: Positive = 0.4
    max_steering: Annotated[float, Field(gt=0, lt=1.57)] = 0.6
    max_steering_rate: Positive = 1.0
    min_speed: float = 0.0


class LidarSettings(Section):
    """The lidar: beams, reach [m], field of view [degrees], noise and height above ground [m]."""

    num_beams: Count = 360
    max_range: Positive = 5.0
    field_of_view_degrees: Annotated[float, Field(gt=0, le=360)] = 360.0
    range_noise: NonNegative = 0.02
    height: NonNegative = 0.5


class CameraSettings(Section):
    """A forward depth camera: columns, reach [m], views [degrees], noise and height [m], tilt
    [rad], down is negative."""

    num_beams: Count = 61
    max_range: Positive = 20.0
    field_of_view_degrees: Annotated[float, Field(gt=0, lt=180)] = 60.0
    vertical_view_degrees: Annotated[float, Field(gt=0, lt=180)] = 45.0
    range_noise: NonNegative = 0.0
    height: Positive = 1.0
    tilt: float = -0.1


class WatchSettings(Section):
    """What is looked for beside the map: see `jaxplore.IdlenessMap`. Without a memory nothing
    that was seen is worth a second look [s]."""

    memory: Positive | None = None
    weight: NonNegative = 1.0


class TerrainSettings(Section):
    """The ground: see `jaxplore.Ground`. A height map is a grey image of the size of the ROS map's,
    black 0 and white `elevation_scale` [m]."""

    height_map: str | None = None
    elevation_scale: Positive = 5.0
    max_slope: Positive = 0.5
    max_roughness: Positive | None = None
    threshold: Annotated[float, Field(ge=0, le=1)] = 0.3


class SensorModelSettings(Section):
    """The inverse sensor model: log-odds added by a hit and a pass, and the clamp; or
    `line_of_sight`, for which one look settles a cell."""

    kind: Literal["log_odds", "line_of_sight"] = "log_odds"
    occupied: Positive = 2.0
    free: Negative = -2.0
    minimum: Negative = -7.0
    maximum: Positive = 5.0


class FieldSettings(Section):
    """The information and guidance fields: see `jaxplore.Perception`."""

    num_directions: Annotated[int, Field(ge=4)] = 32
    node_spacing: Positive = 0.2
    max_clearance: Positive = 1.0
    margin: NonNegative = 0.05
    decay_length: Positive = 8.0
    min_information: Positive = 10.0
    occupancy_prior: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.1
    patience: Positive = 3.0
    memory: Positive = 60.0


class ControllerSettings(Section):
    """MPPI and its costs: see `jaxplore.explorer`."""

    horizon: Count = 40
    num_samples: Count = 1000
    temperature: Positive = 0.3
    noise_std: tuple[Positive, Positive] | None = None
    dt: Positive = 0.05
    clearance: Positive = 0.4
    obstacle_weight: NonNegative = 1.0
    information_weight: NonNegative = 2.0
    guidance_weight: NonNegative = 1.0
    control_weight: NonNegative = 0.01


class PortfolioSettings(Section):
    """A portfolio for a ground vehicle and its fusion: see `jaxplore.ground_portfolio` and
    `jaxplore.Contextual`. `weights` of one's own, by member and objective, take the place of
    `members`. `is_safe` puts the fusion into a `SafeFusion` with that `regret`."""

    decomposition: Literal["roles", "temporal", "regional"] = "roles"
    members: tuple[str, ...] | None = None
    weights: dict[str, dict[str, NonNegative]] | None = None
    common: dict[str, NonNegative] | None = None
    fusion: Literal[
        "weighted-vote", "best-only", "average", "median", "trust-weighted", "contextual"
    ] = "weighted-vote"
    is_safe: bool = True
    regret: NonNegative | None = None
    vote_temperature: Positive = 0.1
    near_goal: Positive = 2.0
    near_obstacle: Positive = 0.3
    rich_information: Positive = 0.2
    hysteresis: NonNegative = 0.2
    parameterisation: Literal["direct", "smooth", "knots"] = "knots"
    effort: NonNegative = 0.02
    horizon: Count = 30
    num_samples: Count = 1000
    temperature: Positive = 0.05
    noise_share: Positive = 0.5
    dt: Positive = 0.05
    clearance: Positive = 0.4
    margin: NonNegative = 0.02


class InformativeSettings(Section):
    """Informative MPPI: see `jaxplore.informative_mppi`, `jaxplore.Flight` and
    `jaxplore.FieldNumbers`. The defaults are the quadrotor design notes' where they have one.

    `target_choice` is how `sequential` picks a zone: by what remains of it, or by what the scans on
    the way there tell, by one of the methods of `jaxplore.TrajectoryInformation`.
    `distance_weight` is the rule's own where none is given.
    """

    parameterisation: Literal["direct", "smooth", "knots"] = "direct"
    horizon: Count = 40
    num_samples: Count = 1000
    temperature: Positive = 0.1
    noise_std: tuple[Positive, ...] | None = None
    dt: Positive = 0.05
    clearance: Positive = 0.6
    bias_fraction: Annotated[float, Field(ge=0, le=1)] = 0.5
    likelihood_ratio: bool = False
    field_beams: Count = 12
    field_range: Positive = 10.0
    field_noise: NonNegative = 0.1
    field_spacing: Positive = 0.5
    field_extent: Positive = 5.0
    field_headings: Count = 8
    local_beams: Count = 6
    local_range: Positive = 2.5
    local_extent: Positive = 4.0
    by_heading: bool = False
    reference_speed: Positive = 2.0
    reference_steps: Count = 40
    target_choice: Literal[
        "remaining", "direct", "discount", "filtered", "temporal", "occlusion"
    ] = "remaining"
    distance_weight: NonNegative | None = None
    depleted: Share = 0.35
    goal_when_explored: bool = True
    reference_weight: NonNegative = 1.0
    local_weight: NonNegative = 10.0
    field_weight: NonNegative = 20.0
    guidance_weight: NonNegative = 10.0
    goal_weight: NonNegative = 0.2
    obstacle_weight: NonNegative = 20.0
    height_weight: NonNegative = 10.0
    speed_weight: NonNegative = 10.0
    control_weight: NonNegative = 0.01


class RatesSettings(Section):
    """How often things happen [Hz]."""

    control: Positive = 50.0
    sensing: Positive = 10.0
    fields: Positive = 5.0


class Settings(Section):
    """A whole run; what is not given has the default shown.

    Args:
        map: YAML file of a ROS map or of a world (`jaxplore.World`), `office` or `zones`; with a
            `world`, a name for it.
        world: the entries of a world, instead of its file.
        architecture: what decides: the ground robots' `explorer` or `portfolio`, or an explorer to
            compare with, by its rule for the next target, such as `nearest-frontier` or `wander`;
            informative MPPI,
            `two-layer`, `parallel`, or `sequential`, which is two-layer from zone to zone of a
            world; or a baseline: a random walk, MPPI that only goes to the goal.
        start: pose (x, y, yaw) [m, m, rad]; office and worlds have one of their own.
        goal: (x, y) or (x, y, z) to be at in the end [m]; worlds may have one of their own.
        goal_radius: distance at which it is reached [m]; 1.5 when absent, a portfolio's 0.25.
        max_unknown: share of unknown cells below which a map with a goal counts as explored; 0.05
            when absent, a portfolio's 1: it is done when it is there.
        hover_time: simulated after the end [s].
        altitude: z to fly at [m]; down is positive.
        resolution: side of a map cell [m]; a finer map is resampled, a coarser one is kept.
        seed: of everything random in the run.
        time_limit: simulated time [s].
        target_coverage: share of the reachable free cells at which exploration is finished; null
            for never, as on a patrol.
        camera: leads if there is one; none when absent.
        watch: what is looked for beside the map; nothing when absent.
        parameters: numbers of the controller by path, in place of what the settings come to: see
            `jaxplore.get_parameters`. A list has a number for each element.
    """

    map: str
    world: dict[str, Any] | None = None
    architecture: Architecture = "explorer"
    start: tuple[float, float, float] | None = None
    goal: tuple[float, float] | tuple[float, float, float] | None = None
    goal_radius: Positive | None = None
    max_unknown: Annotated[float, Field(ge=0, le=1)] | None = None
    hover_time: NonNegative = 0.0
    altitude: float = -2.0
    resolution: Positive = 0.1
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    time_limit: Positive = 900.0
    target_coverage: Share | None = 0.99
    office: OfficeSettings = OfficeSettings()
    robot: RobotSettings = RobotSettings()
    lidar: LidarSettings = LidarSettings()
    camera: CameraSettings | None = None
    watch: WatchSettings | None = None
    terrain: TerrainSettings = TerrainSettings()
    sensor_model: SensorModelSettings = SensorModelSettings()
    fields: FieldSettings = FieldSettings()
    controller: ControllerSettings = ControllerSettings()
    portfolio: PortfolioSettings = PortfolioSettings()
    informative: InformativeSettings = InformativeSettings()
    rates: RatesSettings = RatesSettings()
    parameters: Parameters = Field(default_factory=dict)


def scenario_path(name: str) -> Path:
    """Return the settings file of one of the `SCENARIOS`."""
    return Path(str(importlib.resources.files("jaxplore.settings"))) / "scenarios" / f"{name}.yaml"


def is_scenario_file(path: str | os.PathLike[str]) -> bool:
    """Say whether a YAML file is a scenario: settings that hold a world."""
    try:
        entries = read_settings(path)
    except ValueError:
        return False
    return "world" in entries


def make_settings(entries: dict[str, Any]) -> Settings:
    """Return checked settings.

    Raises:
        ValueError: an unknown name or a value that is not accepted; one line that names it.
    """
    return validated(Settings, _with_defaults(entries))


def _with_defaults(entries: dict[str, Any]) -> dict[str, Any]:
    """Return the entries over the defaults of their architecture and map."""
    if entries.get("map") in SCENARIOS and entries.get("world") is None:
        entries = merged(read_settings(scenario_path(entries["map"])), entries)
    if entries.get("map") == ZONES:
        entries = {"architecture": "two-layer", "time_limit": 60.0, **entries}
    if entries.get("architecture", "explorer") in GROUND:
        return entries
    return merged(FLIGHT, entries)


def merged(defaults: dict[str, Any], entries: dict[str, Any]) -> dict[str, Any]:
    """Return the entries over defaults, section by section."""
    merged = {**defaults, **entries}
    for name, section in defaults.items():
        given = merged[name]
        if isinstance(section, dict) and isinstance(given, dict):
            merged[name] = {**section, **given}
    return merged
