"""Settings of the wheels and the centre of mass of a vehicle."""

import math

from jaxplore.geometry.chassis import Chassis
from jaxplore.parts.capability import Built, Capability, Surroundings
from jaxplore.parts.wheels.truth import Wheels
from jaxplore.settings.defaults import arguments, setting
from jaxplore.settings.robot import CARS
from jaxplore.settings.sections import Body, Section


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


def build_chassis(given: ChassisSettings, around: Surroundings) -> Chassis:
    """Build the wheels and the centre of mass of the robot.

    The robot's radius is that of the discs that cover it. A robot that flies has no chassis.
    """
    robot = around.robot
    if robot is None or robot.model == "quadrotor":
        raise ValueError("setting chassis is given beside a quadrotor; accepted: null")
    side = math.sqrt(2.0) * around.radius
    wheelbase = given.wheelbase or (robot.wheelbase if robot.model in CARS else side)
    return Chassis(
        wheelbase,
        given.track or (robot.width if robot.model == "ackermann" else side),
        # The position of an `ackermann` is the middle of its rear axle.
        offset=0.5 * wheelbase if robot.model == "ackermann" else 0.0,
        **arguments(given, Chassis),
    )


CHASSIS = Capability(
    name="chassis",
    meaning="wheels and centre of mass of the robot, which can then tip over; it cannot when "
    "absent.",
    settings=ChassisSettings,
    build=lambda given, around: Built(truth=Wheels(build_chassis(given, around))),
    control=lambda given, around: {"chassis": build_chassis(given, around)},
)
