"""Settings of robots and their sensors, which all kinds of runs share."""

from typing import Annotated, Literal

from pydantic import Field

from jaxplore.dynamics.ackermann import Ackermann
from jaxplore.dynamics.differential_drive import DifferentialDrive
from jaxplore.dynamics.omnidirectional import Omnidirectional
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.sensing.camera import Camera
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.lidar import Lidar
from jaxplore.sensing.lidar_errors import LidarErrors
from jaxplore.sensing.mount import MOST_MOUNT, LidarMount
from jaxplore.settings.architectures import QUADROTOR
from jaxplore.settings.code_names import WordsOrOwn
from jaxplore.settings.defaults import in_degrees, setting
from jaxplore.settings.readers import EVERY, Readers, models
from jaxplore.settings.sections import (
    Beams,
    Body,
    Fraction,
    Negative,
    NonNegative,
    Positive,
    Range,
    Real,
    Section,
    Steering,
)

CARS = ("ackermann", "bicycle")
"""Models that cannot turn on the spot."""
GROUND_ROBOTS = ("differential_drive", "omnidirectional", "unicycle", *CARS)
"""Models of robots on the ground."""

ViewDegrees = Annotated[float, Field(gt=0, lt=180)]


_DRIVEN = ("differential_drive", "omnidirectional")
WHEELED = models(*_DRIVEN)
TURNING = models(*_DRIVEN, "unicycle")
BRAKING = models(*_DRIVEN, "ackermann")
ACCELERATING = models(*_DRIVEN, *CARS)
ROUND = models(*_DRIVEN, "unicycle", "bicycle", "quadrotor")
A_CAR, SHAPED = models(*CARS), models("ackermann")
REVERSING = models("omnidirectional", "unicycle", *CARS)
DRIVING = models(*GROUND_ROBOTS)
# A quadrotor's speed is limited by a cost of its controller, not by its model.
FAST = Readers(
    f"{DRIVING.text}; {', '.join(QUADROTOR)}",
    lambda settings: DRIVING.reads(settings) or settings.architecture in QUADROTOR,
    "robot.model",
)
LOG_ODDS = Readers(
    "sensor_model.kind log_odds",
    lambda settings: settings.sensor_model.kind == "log_odds",
    "sensor_model.kind",
)


class RobotSettings(Section):
    """The robot: a model and its bounds.

    Each model uses the settings among its parameters. Where several models share a setting, the
    default is that of `DifferentialDrive`. A quadrotor's speed is limited by a cost.

    Args:
        model: name of the robot's model, or MODULE:NAME, a `jaxplore.Dynamics` of your own, which
            has its own numbers. A `bicycle` is a car with a radius and without steering dynamics.
        length: length of an `ackermann`, which has no radius [m].
        width: width of an `ackermann` [m].
    """

    model: Annotated[str, WordsOrOwn((*GROUND_ROBOTS, "quadrotor"))] = "differential_drive"
    max_speed: Annotated[Positive, FAST] = setting(DifferentialDrive, "max_speed")
    max_turn_rate: Annotated[Positive, TURNING] = setting(DifferentialDrive, "max_turn_rate")
    max_acceleration: Annotated[Positive, ACCELERATING] = setting(
        DifferentialDrive, "max_acceleration"
    )
    max_deceleration: Annotated[Positive | None, BRAKING] = setting(
        DifferentialDrive, "max_deceleration"
    )
    max_angular_acceleration: Annotated[Positive, WHEELED] = setting(
        DifferentialDrive, "max_angular_acceleration"
    )
    drag: Annotated[NonNegative, BRAKING] = setting(DifferentialDrive, "drag")
    radius: Annotated[Body, ROUND] = setting(DifferentialDrive, "radius")
    mass: Annotated[Positive, models("quadrotor")] = setting(Quadrotor, "mass")
    wheelbase: Annotated[Body, A_CAR] = setting(Ackermann, "wheelbase")
    length: Annotated[Body, SHAPED] = 0.75
    width: Annotated[Body, SHAPED] = 0.4
    max_steering: Annotated[Steering, A_CAR] = setting(Ackermann, "max_steering")
    max_steering_rate: Annotated[Positive, SHAPED] = setting(Ackermann, "max_steering_rate")
    min_speed: Annotated[Real, REVERSING] = setting(Ackermann, "min_speed")
    max_lateral_speed: Annotated[Positive | None, models("omnidirectional")] = setting(
        Omnidirectional, "max_lateral_speed"
    )


TiltDegrees = Annotated[float, Field(ge=-28, le=28)]


MountLength = Annotated[float, Field(ge=-MOST_MOUNT, le=MOST_MOUNT)]


class LidarSettings(Section):
    """A planar lidar: see `jaxplore.Lidar`, `jaxplore.sensing.LidarErrors` and
    `jaxplore.sensing.LidarMount`."""

    num_beams: Beams = setting(Lidar, "num_beams")
    max_range: Range = setting(Lidar, "max_range")
    field_of_view_degrees: Annotated[float, Field(gt=0, le=360)] = setting(
        Lidar, "field_of_view", in_degrees
    )
    range_noise: NonNegative = setting(Lidar, "range_noise")
    height: NonNegative = setting(Lidar, "height")
    least_range: NonNegative = setting(LidarErrors, "least_range")
    missing: Fraction = setting(LidarErrors, "missing")
    false_returns: Fraction = setting(LidarErrors, "false_returns")
    pitch_degrees: TiltDegrees = setting(LidarErrors, "pitch", in_degrees)
    roll_degrees: TiltDegrees = setting(LidarErrors, "roll", in_degrees)
    x: MountLength = setting(LidarMount, "x")
    y: MountLength = setting(LidarMount, "y")
    yaw_degrees: Real = setting(LidarMount, "yaw", in_degrees)
    is_turning: bool = setting(LidarMount, "is_turning")


class CameraSettings(Section):
    """A forward depth camera: see `jaxplore.Camera`."""

    num_beams: Beams = setting(Camera, "num_beams")
    max_range: Range = setting(Camera, "max_range")
    field_of_view_degrees: ViewDegrees = setting(Camera, "field_of_view", in_degrees)
    vertical_view_degrees: ViewDegrees = setting(Camera, "vertical_view", in_degrees)
    range_noise: NonNegative = setting(Camera, "range_noise")
    height: Positive = setting(Camera, "height")
    tilt: Real = setting(Camera, "tilt")


class SensorModelSettings(Section):
    """The inverse sensor model: see `jaxplore.InverseSensorModel`.

    Args:
        kind: `log_odds` uses the numbers of this section; with `line_of_sight` one measurement
            makes a cell certain.
    """

    readers = LOG_ODDS

    kind: Annotated[Literal["log_odds", "line_of_sight"], EVERY] = "log_odds"
    occupied: Positive = setting(InverseSensorModel, "occupied")
    free: Negative = setting(InverseSensorModel, "free")
    minimum: Negative = setting(InverseSensorModel, "minimum")
    maximum: Positive = setting(InverseSensorModel, "maximum")
