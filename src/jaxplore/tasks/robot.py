"""The robot, its sensors and their inverse sensor model, from settings."""

import math
from collections.abc import Callable
from typing import Any

from jaxplore.control.adaptive_horizon import (
    AdaptiveHorizon,
    HorizonByClearance,
    HorizonByInformation,
    HorizonBySpeed,
    HorizonRule,
)
from jaxplore.control.base import Controller
from jaxplore.control.latency import LatencyCompensation
from jaxplore.control.mppi import MPPI
from jaxplore.dynamics.ackermann import Ackermann
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.differential_drive import DifferentialDrive
from jaxplore.dynamics.integrators import Integrator
from jaxplore.dynamics.kinematic_bicycle import KinematicBicycle
from jaxplore.dynamics.omnidirectional import Omnidirectional
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.dynamics.unicycle import Unicycle
from jaxplore.geometry.footprint import Rectangle
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.camera import Camera
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.lidar import Lidar
from jaxplore.sensing.lidar_errors import LidarErrors
from jaxplore.sensing.mount import LidarMount
from jaxplore.settings.code_names import is_own
from jaxplore.settings.defaults import arguments
from jaxplore.settings.robot import RobotSettings, SensorModelSettings
from jaxplore.settings.sections import AdaptiveHorizonSettings, RunSettings
from jaxplore.simulation.scenario import Scenario
from jaxplore.tasks.exploration.settings import Settings
from jaxplore.tasks.user_code import import_robot


def build_robot(given: RobotSettings, integrator: Integrator | None = None) -> Dynamics:
    """Build the model of the robot.

    `integrator` is that of a car or of a robot on driven wheels; the model's default when None. A
    model of the user's own has its own.
    """
    if is_own(given.model):
        return import_robot(given.model)
    if given.model == "quadrotor":
        return Quadrotor(given.mass, radius=given.radius)
    if given.model == "unicycle":
        return Unicycle(
            max_speed=given.max_speed,
            max_turn_rate=given.max_turn_rate,
            min_speed=given.min_speed,
            radius=given.radius,
        )
    if given.model == "bicycle":
        # Settings have no centre of gravity: it is taken half-way between the axles.
        half = 0.5 * given.wheelbase
        return KinematicBicycle(
            half,
            half,
            max_speed=given.max_speed,
            max_steering=given.max_steering,
            max_acceleration=given.max_acceleration,
            min_speed=given.min_speed,
            radius=given.radius,
            integrator=integrator,
        )
    if given.model == "ackermann":
        # The body reaches equally far beyond both axles. The origin is the middle of the rear axle.
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
            max_deceleration=given.max_deceleration,
            footprint=Rectangle(given.wheelbase + overhang, overhang, given.width),
        )
    wheeled: dict[str, Any] = {
        "max_speed": given.max_speed,
        "max_turn_rate": given.max_turn_rate,
        "max_acceleration": given.max_acceleration,
        "max_deceleration": given.max_deceleration,
        "max_angular_acceleration": given.max_angular_acceleration,
        "drag": given.drag,
        "radius": given.radius,
        "integrator": integrator,
    }
    if given.model == "omnidirectional":
        return Omnidirectional(
            **wheeled, min_speed=given.min_speed, max_lateral_speed=given.max_lateral_speed
        )
    return DifferentialDrive(**wheeled)


_RULES: dict[str, Callable[..., HorizonRule]] = {
    "speed": HorizonBySpeed,
    "clearance": HorizonByClearance,
    "information": HorizonByInformation,
}


def with_adaptive_horizon(controller: Controller, given: AdaptiveHorizonSettings) -> Controller:
    """Return a controller that chooses its horizon in each step, if settings name a rule.

    The controller must be one MPPI, with a horizon of at least `min_horizon` steps.
    """
    if given.rule is None:
        return controller
    if not isinstance(controller, MPPI):
        raise ValueError(
            f"setting adaptive_horizon.rule is {given.rule!r} for {type(controller).__name__}; "
            "accepted: with a controller that is one MPPI, such as the explorer"
        )
    if given.min_horizon > controller.horizon:
        raise ValueError(
            f"setting adaptive_horizon.min_horizon is {given.min_horizon}; accepted: at most the "
            f"horizon of the controller, {controller.horizon}"
        )
    ends = {"at_shortest": given.at_shortest, "at_longest": given.at_longest}
    rule = _RULES[given.rule](**{name: each for name, each in ends.items() if each is not None})
    return AdaptiveHorizon(controller, rule, given.min_horizon)


def with_latency(controller: Controller, settings: RunSettings, scenario: Scenario) -> Controller:
    """Return a controller that plans for the time when its command takes effect."""
    if settings.latency == 0.0:
        return controller
    return LatencyCompensation(
        controller, settings.latency, scenario.robot, scenario.control_period
    )


def build_sensors(settings: Settings) -> tuple[Sensor, ...]:
    """Build the sensors. The first, primary one is the camera if there is one, else the lidar."""
    given, camera = settings.lidar, settings.camera
    view = math.radians(given.field_of_view_degrees)
    # `arguments` returns angles in degrees, as settings have them.
    tilt = {name: math.radians(getattr(given, f"{name}_degrees")) for name in ("pitch", "roll")}
    numbers = {**arguments(given, LidarErrors), **tilt}
    errors = LidarErrors(**numbers) if any(numbers.values()) else None
    place = {**arguments(given, LidarMount), "yaw": math.radians(given.yaw_degrees)}
    mount = LidarMount(**place) if any(place.values()) else None
    lidar = Lidar(**{**arguments(given, Lidar), "field_of_view": view}, errors=errors, mount=mount)
    if camera is None:
        return (lidar,)
    views = {
        "field_of_view": math.radians(camera.field_of_view_degrees),
        "vertical_view": math.radians(camera.vertical_view_degrees),
    }
    return (Camera(**{**arguments(camera, Camera), **views}), lidar)


def build_sensor_model(given: SensorModelSettings) -> InverseSensorModel:
    """Build the inverse sensor model, the update of a cell by a measurement."""
    if given.kind == "line_of_sight":
        return InverseSensorModel.line_of_sight()
    return InverseSensorModel(**arguments(given, InverseSensorModel))
