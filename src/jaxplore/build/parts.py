"""The robot, its sensors and what they do to its map, from settings."""

import math

from jaxplore.dynamics.ackermann import Ackermann
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.differential_drive import DifferentialDrive
from jaxplore.dynamics.integrators import Integrator
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.dynamics.unicycle import Unicycle
from jaxplore.geometry.footprint import Rectangle
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.camera import Camera
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.lidar import Lidar
from jaxplore.settings.exploration import RobotSettings, SensorModelSettings, Settings


def robot_of(given: RobotSettings, integrator: Integrator | None = None) -> Dynamics:
    """Return the model of the robot.

    Args:
        given: its settings.
        integrator: of a continuous model on the ground; the model's own when absent.
    """
    if given.model == "quadrotor":
        return Quadrotor(given.mass, radius=given.radius)
    if given.model == "unicycle":
        return Unicycle(
            max_speed=given.max_speed, max_turn_rate=given.max_turn_rate, radius=given.radius
        )
    if given.model == "ackermann":
        overhang = 0.5 * (given.length - given.wheelbase)
        if overhang < 0.0:
            raise ValueError(
                f"setting robot.length is {given.length:g}; accepted: at least the wheelbase, "
                f"{given.wheelbase:g}"
            )
        return Ackermann(
            wheelbase=given.wheelbase,
            max_speed=given.max_speed,
            max_steering=given.max_steering,
            max_acceleration=given.max_acceleration,
            max_steering_rate=given.max_steering_rate,
            min_speed=given.min_speed,
            drag=given.drag,
            integrator=integrator,
            footprint=Rectangle(given.wheelbase + overhang, overhang, given.width),
        )
    return DifferentialDrive(
        max_speed=given.max_speed,
        max_turn_rate=given.max_turn_rate,
        max_acceleration=given.max_acceleration,
        max_angular_acceleration=given.max_angular_acceleration,
        drag=given.drag,
        radius=given.radius,
        integrator=integrator,
    )


def sensors_of(settings: Settings) -> tuple[Sensor, ...]:
    """Return the sensors, the one that leads first: a camera if there is one, else the lidar."""
    given, seen = settings.lidar, settings.camera
    lidar = Lidar(
        given.num_beams,
        given.max_range,
        math.radians(given.field_of_view_degrees),
        given.range_noise,
        height=given.height,
    )
    if seen is None:
        return (lidar,)
    camera = Camera(
        seen.num_beams,
        seen.max_range,
        math.radians(seen.field_of_view_degrees),
        math.radians(seen.vertical_view_degrees),
        height=seen.height,
        tilt=seen.tilt,
        range_noise=seen.range_noise,
    )
    return (camera, lidar)


def sensor_model_of(settings: SensorModelSettings) -> InverseSensorModel:
    """Return what a measurement does to a cell."""
    if settings.kind == "line_of_sight":
        return InverseSensorModel.line_of_sight()
    return InverseSensorModel(**settings.model_dump(exclude={"kind"}))
