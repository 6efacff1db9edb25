"""Every setting of a run, from a YAML file or the command line."""

import math
import os
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import jax
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from jaxplore._types import Key
from jaxplore.control.mppi import MPPI
from jaxplore.dynamics.differential_drive import DifferentialDrive
from jaxplore.information.perception import Perception
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.office import office, start_pose
from jaxplore.planning.explorer import explorer
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.lidar import Lidar
from jaxplore.simulation.reachability import open_spot
from jaxplore.simulation.scenario import Scenario

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Negative = Annotated[float, Field(lt=0)]
Share = Annotated[float, Field(gt=0, le=1)]
Count = Annotated[int, Field(ge=1)]

OFFICE = "office"
"""The map that is generated instead of read."""


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class OfficeSettings(_Section):
    """The generated office: seed of its plan, size and cells [m]."""

    seed: Annotated[int, Field(ge=0)] = 0
    width: Positive = 20.0
    height: Positive = 14.0


class RobotSettings(_Section):
    """The robot: model, bounds [m/s, rad/s, m/s^2, rad/s^2], drag [1/s] and radius [m]."""

    model: Literal["differential_drive"] = "differential_drive"
    max_speed: Positive = 1.0
    max_turn_rate: Positive = 2.0
    max_acceleration: Positive = 1.0
    max_angular_acceleration: Positive = 2.0
    drag: NonNegative = 0.1
    radius: Positive = 0.2


class LidarSettings(_Section):
    """The lidar: beams, reach [m], field of view [degrees], noise [m]."""

    num_beams: Count = 360
    max_range: Positive = 5.0
    field_of_view_degrees: Annotated[float, Field(gt=0, le=360)] = 360.0
    range_noise: NonNegative = 0.02


class SensorModelSettings(_Section):
    """The inverse sensor model: log-odds added by a hit and a pass, and the clamp."""

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


class RatesSettings(_Section):
    """How often things happen [Hz]."""

    control: Positive = 50.0
    sensing: Positive = 10.0
    fields: Positive = 5.0


class Settings(_Section):
    """A whole run; what is not given has the default shown.

    Args:
        map: YAML file of a ROS map, or `office`.
        start: pose (x, y, yaw) [m, m, rad]; the office has one of its own.
        resolution: side of a map cell [m]; a finer map is resampled, a coarser one is kept.
        seed: of everything random in the run.
        time_limit: simulated time [s].
        target_coverage: share of the reachable free cells at which exploration is finished.
    """

    map: str
    start: tuple[float, float, float] | None = None
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
    rates: RatesSettings = RatesSettings()


class Experiment(NamedTuple):
    """What `simulate` takes."""

    controller: MPPI
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
        return Settings.model_validate(entries)
    except ValidationError as error:
        first = error.errors()[0]
        raise ValueError(
            _one_line(first["loc"], first["type"], first["input"], first["msg"])
        ) from None


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
    robot = DifferentialDrive(**settings.robot.model_dump(exclude={"model"}))
    world, start = _world(settings, float(robot.radius))
    view = settings.lidar.field_of_view_degrees
    lidar = Lidar(
        settings.lidar.num_beams,
        settings.lidar.max_range,
        math.radians(view),
        settings.lidar.range_noise,
    )
    perception = Perception(
        lidar,
        world.resolution,
        robot.radius,
        sensor_model=InverseSensorModel(**settings.sensor_model.model_dump()),
        **settings.fields.model_dump(),
    )
    scenario = Scenario(
        world,
        robot,
        lidar,
        start,
        perception=perception,
        control_rate=settings.rates.control,
        sensing_rate=settings.rates.sensing,
        field_rate=settings.rates.fields,
        target_coverage=settings.target_coverage,
    )
    return Experiment(
        explorer(robot, **settings.controller.model_dump()),
        scenario,
        max(1, round(settings.time_limit * settings.rates.control)),
        jax.random.key(settings.seed),
    )


def _world(settings: Settings, radius: float) -> tuple[OccupancyGrid, tuple[float, float, float]]:
    if settings.map == OFFICE:
        grid = office(
            settings.office.seed,
            width=settings.office.width,
            height=settings.office.height,
            resolution=settings.resolution,
        )
        return grid, start_pose(grid) if settings.start is None else settings.start
    grid = OccupancyGrid.from_ros(settings.map)
    if grid.resolution < settings.resolution * (1.0 - 1e-6):
        grid = grid.resample(settings.resolution)
    if settings.start is None:
        x, y = open_spot(grid, radius)
        raise ValueError(
            f"start is missing; accepted: a pose in free space, for example {x:.2f} {y:.2f} 0"
        )
    return grid, settings.start
