"""Every setting of a run, from a YAML file or the command line."""

import math
import os
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import jax
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from jaxplore._types import Key
from jaxplore.control.base import Controller
from jaxplore.control.knots import Knots
from jaxplore.control.parameterisations import Direct
from jaxplore.control.smooth import Smooth
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.differential_drive import DifferentialDrive
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.information.perception import Perception
from jaxplore.information.zones import Zones
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.office import office, start_pose
from jaxplore.maps.world import World, is_world_file, three_zones
from jaxplore.planning.architectures import (
    FieldNumbers,
    Flight,
    goal_mppi,
    informative_mppi,
    random_walk,
)
from jaxplore.planning.explorer import explorer
from jaxplore.planning.gradient_reference import GradientReference
from jaxplore.planning.targets import RemainingInformation, TargetReference
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.lidar import Lidar
from jaxplore.simulation.reachability import open_spot
from jaxplore.simulation.scenario import Scenario

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Negative = Annotated[float, Field(lt=0)]
Share = Annotated[float, Field(gt=0, le=1)]
Count = Annotated[int, Field(ge=1)]

Architecture = Literal["explorer", "two-layer", "parallel", "sequential", "random-walk", "goal"]

OFFICE = "office"
"""The map that is generated instead of read."""
ZONES = "zones"
"""The world with three unknown zones of the quadrotor design notes."""

FLIGHT: dict[str, Any] = {
    "robot": {"model": "quadrotor", "radius": 0.3, "max_speed": 2.0},
    "lidar": {
        "num_beams": 24,
        "max_range": 4.0,
        "field_of_view_degrees": 90.0,
        "range_noise": 0.0,
    },
    "sensor_model": {"kind": "line_of_sight"},
    "rates": {"sensing": 50.0},
}
"""What differs by default if the architecture is not `explorer`: a quadrotor with a camera."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class OfficeSettings(_Section):
    """The generated office: seed of its plan, size and cells [m]."""

    seed: Annotated[int, Field(ge=0)] = 0
    width: Positive = 20.0
    height: Positive = 14.0


class RobotSettings(_Section):
    """The robot: model, bounds [m/s, rad/s, m/s^2, rad/s^2], drag [1/s] and radius [m].

    A quadrotor has a radius, a speed limit that is a cost, and a mass [kg].
    """

    model: Literal["differential_drive", "quadrotor"] = "differential_drive"
    max_speed: Positive = 1.0
    max_turn_rate: Positive = 2.0
    max_acceleration: Positive = 1.0
    max_angular_acceleration: Positive = 2.0
    drag: NonNegative = 0.1
    radius: Positive = 0.2
    mass: Positive = 1.0


class LidarSettings(_Section):
    """The lidar: beams, reach [m], field of view [degrees], noise [m]."""

    num_beams: Count = 360
    max_range: Positive = 5.0
    field_of_view_degrees: Annotated[float, Field(gt=0, le=360)] = 360.0
    range_noise: NonNegative = 0.02


class SensorModelSettings(_Section):
    """The inverse sensor model: log-odds added by a hit and a pass, and the clamp; or
    `line_of_sight`, for which one look settles a cell."""

    kind: Literal["log_odds", "line_of_sight"] = "log_odds"
    occupied: Positive = 2.0
    free: Negative = -2.0
    minimum: Negative = -7.0
    maximum: Positive = 5.0


class FieldSettings(_Section):
    """The information and guidance fields: see `jaxplore.Perception`."""

    num_directions: Annotated[int, Field(ge=4)] = 32
    node_spacing: Positive = 0.2
    max_clearance: Positive = 1.0
    margin: NonNegative = 0.05
    decay_length: Positive = 4.0
    min_information: Positive = 3.0
    patience: Positive = 3.0
    memory: Positive = 60.0


class ControllerSettings(_Section):
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


class InformativeSettings(_Section):
    """Informative MPPI: see `jaxplore.informative_mppi`, `jaxplore.Flight` and
    `jaxplore.FieldNumbers`. The defaults are the quadrotor design notes' where they have one."""

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
    distance_weight: NonNegative = 0.05
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


class RatesSettings(_Section):
    """How often things happen [Hz]."""

    control: Positive = 50.0
    sensing: Positive = 10.0
    fields: Positive = 5.0


class Settings(_Section):
    """A whole run; what is not given has the default shown.

    Args:
        map: YAML file of a ROS map or of a world (`jaxplore.World`), `office` or `zones`.
        architecture: what decides: the ground robots' `explorer`; informative MPPI, `two-layer`,
            `parallel`, or `sequential`, which is two-layer from zone to zone of a world; or a
            baseline: a random walk, MPPI that only goes to the goal.
        start: pose (x, y, yaw) [m, m, rad]; office and worlds have one of their own.
        goal: (x, y) or (x, y, z) to be at in the end [m]; worlds may have one of their own.
        goal_radius: distance at which it is reached [m].
        max_unknown: share of unknown cells below which a map with a goal counts as explored.
        hover_time: simulated after the end [s].
        altitude: z to fly at [m]; down is positive.
        resolution: side of a map cell [m]; a finer map is resampled, a coarser one is kept.
        seed: of everything random in the run.
        time_limit: simulated time [s].
        target_coverage: share of the reachable free cells at which exploration is finished.
    """

    map: str
    architecture: Architecture = "explorer"
    start: tuple[float, float, float] | None = None
    goal: tuple[float, float] | tuple[float, float, float] | None = None
    goal_radius: Positive = 1.5
    max_unknown: Annotated[float, Field(ge=0, le=1)] = 0.05
    hover_time: NonNegative = 0.0
    altitude: float = -2.0
    resolution: Positive = 0.1
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    time_limit: Positive = 900.0
    target_coverage: Share = 0.99
    office: OfficeSettings = OfficeSettings()
    robot: RobotSettings = RobotSettings()
    lidar: LidarSettings = LidarSettings()
    sensor_model: SensorModelSettings = SensorModelSettings()
    fields: FieldSettings = FieldSettings()
    controller: ControllerSettings = ControllerSettings()
    informative: InformativeSettings = InformativeSettings()
    rates: RatesSettings = RatesSettings()


class Experiment(NamedTuple):
    """What `simulate` takes."""

    controller: Controller
    scenario: Scenario
    num_steps: int
    key: Key


def read_settings(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read settings from a YAML file.

    Raises:
        ValueError: a file that is missing, unreadable, not YAML or not a mapping.
    """
    try:
        entries = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ValueError(f"settings file {path} cannot be read: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise ValueError(f"settings file {path} is not YAML: {reason}") from None
    if not isinstance(entries, dict):
        raise ValueError(
            f"settings file {path} holds {type(entries).__name__}; accepted: a mapping of settings"
        )
    return entries


def make_settings(entries: dict[str, Any]) -> Settings:
    """Return checked settings.

    Raises:
        ValueError: an unknown name or a value that is not accepted; one line that names it.
    """
    try:
        return Settings.model_validate(_with_defaults(entries))
    except ValidationError as error:
        first = error.errors()[0]
        raise ValueError(
            _one_line(first["loc"], first["type"], first["input"], first["msg"])
        ) from None


def _with_defaults(entries: dict[str, Any]) -> dict[str, Any]:
    """Return the entries over the defaults of their architecture and map."""
    if entries.get("map") == ZONES:
        entries = {"architecture": "two-layer", "time_limit": 60.0, **entries}
    if entries.get("architecture", "explorer") == "explorer":
        return entries
    merged = dict(entries)
    for name, defaults in FLIGHT.items():
        given = entries.get(name, {})
        merged[name] = {**defaults, **given} if isinstance(given, dict) else given
    return merged


def _one_line(where: tuple[int | str, ...], kind: str, value: object, message: str) -> str:
    name = ".".join(str(part) for part in where)
    if kind == "extra_forbidden":
        section: type[BaseModel] = Settings
        for part in where[:-1]:
            section = _section(section, str(part))
        return f"unknown setting {name}; accepted here: {', '.join(section.model_fields)}"
    if kind == "missing":
        return f"setting {name} is missing; accepted: the YAML file of a ROS map, or office"
    shown = repr(value) if len(repr(value)) <= 80 else repr(value)[:77] + "..."
    return f"setting {name} is {shown}; accepted: {message.removeprefix('Input should be ')}"


def _section(section: type[BaseModel], name: str) -> type[BaseModel]:
    inner = section.model_fields[name].annotation
    assert isinstance(inner, type)
    assert issubclass(inner, BaseModel)
    return inner


def build(settings: Settings) -> Experiment:
    """Return the controller, scenario, number of steps and key that settings describe.

    Raises:
        ValueError: a map that cannot be read, a start that is not possible, a part that does not
            accept its settings.
    """
    robot = _robot(settings)
    place = _place(settings, float(robot.radius))
    world = place.world
    view = math.radians(settings.lidar.field_of_view_degrees)
    lidar = Lidar(
        settings.lidar.num_beams, settings.lidar.max_range, view, settings.lidar.range_noise
    )
    model = _sensor_model(settings.sensor_model)
    goal = None if place.goal is None else place.goal[:2]
    perception = Perception(
        lidar,
        world.resolution,
        robot.radius,
        sensor_model=model,
        goal=goal,
        max_unknown=settings.max_unknown,
        **settings.fields.model_dump(),
    )
    scenario = Scenario(
        world,
        robot,
        lidar,
        place.start,
        perception=perception,
        control_rate=settings.rates.control,
        sensing_rate=settings.rates.sensing,
        field_rate=settings.rates.fields,
        target_coverage=settings.target_coverage,
        prior=place.prior,
        goal=goal,
        goal_radius=settings.goal_radius,
        max_unknown=settings.max_unknown,
        altitude=settings.altitude,
        hover_time=settings.hover_time,
    )
    return Experiment(
        _controller(settings, robot, place, model, view),
        scenario,
        max(1, round(settings.time_limit * settings.rates.control)),
        jax.random.key(settings.seed),
    )


def comparable(settings: Settings) -> tuple[str, ...]:
    """Return the architectures for quadrotors that the map of some settings allows.

    Raises:
        ValueError: a map that cannot be read.
    """
    place = _place(settings, settings.robot.radius)
    has_goal, has_zones = place.goal is not None, bool(place.zones)
    allowed = {
        "two-layer": True,
        "parallel": True,
        "sequential": has_goal and has_zones,
        "random-walk": True,
        "goal": has_goal,
    }
    return tuple(name for name, is_allowed in allowed.items() if is_allowed)


class _Place(NamedTuple):
    """Where a run takes place."""

    world: OccupancyGrid
    start: tuple[float, float, float]
    prior: OccupancyGrid | None = None
    goal: tuple[float, ...] | None = None
    zones: tuple[tuple[float, ...], ...] = ()


def _robot(settings: Settings) -> Dynamics:
    given = settings.robot
    if given.model == "quadrotor":
        return Quadrotor(given.mass, radius=given.radius)
    return DifferentialDrive(**given.model_dump(exclude={"model", "mass"}))


def _sensor_model(settings: SensorModelSettings) -> InverseSensorModel:
    if settings.kind == "line_of_sight":
        return InverseSensorModel.line_of_sight()
    return InverseSensorModel(**settings.model_dump(exclude={"kind"}))


def _controller(
    settings: Settings, robot: Dynamics, place: _Place, model: InverseSensorModel, view: float
) -> Controller:
    if settings.architecture == "explorer":
        return explorer(robot, **settings.controller.model_dump())
    given = settings.informative.model_dump()
    parameterisation = {"direct": Direct(), "smooth": Smooth(), "knots": Knots(8)}
    given["parameterisation"] = parameterisation[given["parameterisation"]]
    period = 1.0 / settings.rates.control
    flight = Flight(
        **{name: given.pop(name) for name in Flight._fields if name in given},
        control_period=period,
        altitude=settings.altitude,
        max_speed=settings.robot.max_speed,
    )
    if settings.architecture == "random-walk":
        return random_walk(robot, flight)
    goal = place.goal
    if goal is not None and "z" not in robot.state_names:
        goal = goal[:2]
    if settings.architecture == "goal":
        if goal is None:
            raise ValueError("goal is missing; accepted: a position, for the architecture goal")
        return goal_mppi(robot, goal, flight)
    fields = FieldNumbers(
        **{name: given.pop(name) for name in FieldNumbers._fields if name in given},
        field_of_view=view,
        field_period=1.0 / settings.rates.fields,
    )
    weight, depleted = given.pop("distance_weight"), given.pop("depleted")
    reference = None
    if settings.architecture == "sequential":
        if goal is None or not place.zones:
            raise ValueError(
                "architecture is 'sequential', which goes from zone to zone and then to the goal; "
                "accepted: a world with both"
            )
        zones = Zones.from_rectangles(place.zones, place.world)
        clearance = settings.robot.radius + settings.fields.margin
        choice = RemainingInformation(
            zones, goal[:2], weight, depleted, required_clearance=clearance
        )
        walk = GradientReference(given["reference_speed"], given["reference_steps"], flight.dt)
        reference = TargetReference(choice, walk)
    return informative_mppi(
        robot,
        "parallel" if settings.architecture == "parallel" else "two-layer",
        reference=reference,
        resolution=place.world.resolution,
        sensor_model=model,
        goal=goal,
        flight=flight,
        fields=fields,
        patience=settings.fields.patience,
        **given,
    )


def _place(settings: Settings, radius: float) -> _Place:
    if settings.map == OFFICE:
        grid = office(
            settings.office.seed,
            width=settings.office.width,
            height=settings.office.height,
            resolution=settings.resolution,
        )
        start = start_pose(grid) if settings.start is None else settings.start
        return _Place(grid, start, None, settings.goal)
    if settings.map == ZONES or is_world_file(settings.map):
        world = three_zones() if settings.map == ZONES else World.from_yaml(settings.map)
        start = world.start if settings.start is None else settings.start
        goal = world.goal if settings.goal is None else settings.goal
        return _Place(world.truth(), start, world.prior(), goal, world.zones)
    grid = OccupancyGrid.from_ros(settings.map)
    if grid.resolution < settings.resolution * (1.0 - 1e-6):
        grid = grid.resample(settings.resolution)
    if settings.start is None:
        x, y = open_spot(grid, radius)
        raise ValueError(
            f"start is missing; accepted: a pose in free space, for example {x:.2f} {y:.2f} 0"
        )
    return _Place(grid, settings.start, None, settings.goal)
