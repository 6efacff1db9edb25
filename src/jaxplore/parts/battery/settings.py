"""Settings of a battery and its dock."""

import dataclasses
from typing import Annotated

from pydantic import Field

from jaxplore.parts.battery.robot import Battery
from jaxplore.parts.battery.truth import TrueBattery
from jaxplore.parts.capability import Built, Capability, Surroundings
from jaxplore.settings.defaults import arguments, setting
from jaxplore.settings.sections import NonNegative, Positive, Real, Section, Share


class EnergySettings(Section):
    """A battery, and the dock where it is charged: see `jaxplore.parts.Battery`."""

    dock: tuple[Real, ...] | None = None
    capacity: Positive = setting(Battery, "capacity")
    idle: NonNegative = setting(Battery, "idle")
    per_metre: NonNegative = setting(Battery, "per_metre")
    mass: NonNegative = setting(Battery, "mass")
    reserve: Annotated[float, Field(ge=0, lt=1)] = setting(Battery, "reserve")
    enough: Share = setting(Battery, "enough")
    cruise: Positive = setting(Battery, "cruise")
    power: Positive = setting(TrueBattery, "power")
    charge: Share = setting(TrueBattery, "charge")


class BatterySettings(EnergySettings):
    """A battery, and the dock where it is charged: see `jaxplore.parts.Battery`.

    Args:
        dock: position (x, y) of the dock [m]; that of the start of each robot when absent.
    """

    dock: tuple[Real, Real] | None = None


class FlightBatterySettings(EnergySettings):
    """The battery of a robot in a volume, and its dock: see `jaxplore.parts.Battery`.

    Args:
        dock: position (x, y, z) of the dock, with z up [m]; that of the start when absent.
    """

    dock: tuple[Real, Real, Real] | None = None


def build_battery(given: EnergySettings, around: Surroundings) -> Built:
    """Build the part on board and its truth."""
    dock = None if given.dock is None else around.datum.to_local(given.dock)
    battery = Battery(dock, **arguments(given, Battery))
    return Built(battery, TrueBattery(battery, **arguments(given, TrueBattery)))


BATTERY = Capability(
    name="battery",
    meaning="the robot's battery and its dock; it never runs down when absent.",
    settings=BatterySettings,
    build=build_battery,
    sends_robot=True,
)
BATTERY_IN_VOLUME = dataclasses.replace(BATTERY, settings=FlightBatterySettings, dimensions=3)
