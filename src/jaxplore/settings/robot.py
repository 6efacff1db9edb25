"""Settings of robots and their sensors, which all kinds of runs share."""

from typing import Annotated, Literal

from pydantic import Field

from jaxplore.dynamics.ackermann import Ackermann
from jaxplore.dynamics.differential_drive import DifferentialDrive
from jaxplore.dynamics.omnidirectional import Omnidirectional
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.geometry.chassis import Chassis
from jaxplore.sensing.camera import Camera
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.lidar import Lidar
from jaxplore.sensing.lidar_errors import LidarErrors
from jaxplore.sensing.mount import MOST_MOUNT, LidarMount
from jaxplore.settings.code_names import WordsOrOwn
from jaxplore.settings.defaults import in_degrees, setting
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
    max_speed: Positive = setting(DifferentialDrive, "max_speed")
    max_turn_rate: Positive = setting(DifferentialDrive, "max_turn_rate")
    max_acceleration: Positive = setting(DifferentialDrive, "max_acceleration")
    max_deceleration: Positive | None = setting(DifferentialDrive, "max_deceleration")
    max_angular_acceleration: Positive = setting(DifferentialDrive, "max_angular_acceleration")
    drag: NonNegative = setting(DifferentialDrive, "drag")
    radius: Body = setting(DifferentialDrive, "radius")
    mass: Positive = setting(Quadrotor, "mass")
    wheelbase: Body = setting(Ackermann, "wheelbase")
    length: Body = 0.75
    width: Body = 0.4
    max_steering: Steering = setting(Ackermann, "max_steering")
    max_steering_rate: Positive = setting(Ackermann, "max_steering_rate")
    min_speed: Real = setting(Ackermann, "min_speed")
    max_lateral_speed: Positive | None = setting(Omnidirectional, "max_lateral_speed")


TiltDegrees = Annotated[float, Field(ge=-28, le=28)]


class ChassisSettings(Section):
    """The wheels and the centre of mass of a vehicle: see `jaxplore.geometry.Chassis`.

    Args:
        wheelbase: distance between the axles [m]; when absent that of a car, and of another robot
            the side of the square in its disc.
        track: distance between the left and the right wheels [m]; when absent the width of an
            `ackermann`, and of another robot the side of the square in its disc.
    """

    wheelbase: Body | None = None
    track: Body | None = None
    mass_height: Body = setting(Chassis, "mass_height")
    suspension: Body = setting(Chassis, "suspension")


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

    kind: Literal["log_odds", "line_of_sight"] = "log_odds"
    occupied: Positive = setting(InverseSensorModel, "occupied")
    free: Negative = setting(InverseSensorModel, "free")
    minimum: Negative = setting(InverseSensorModel, "minimum")
    maximum: Positive = setting(InverseSensorModel, "maximum")
