"""Fleets, from settings."""

from jaxplore.control.base import Controller
from jaxplore.control.fleet_controller import FleetController, same_for_all
from jaxplore.costs.moving import MovingObstacleCost
from jaxplore.maps.datum import Datum
from jaxplore.settings.defaults import arguments
from jaxplore.settings.fleet import FleetSettings
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.fleet.radio import Radio
from jaxplore.simulation.fleet.scenario import Fleet
from jaxplore.simulation.fleet.starts import near_starts
from jaxplore.tasks.exploration.settings import Settings

ROOM = 0.3
"""Distance from another robot below which a robot pays for nearness [m], beyond both radii."""


def has_others(settings: Settings) -> bool:
    """Check whether a robot has other robots beside it."""
    return settings.fleet is not None and settings.fleet.robots > 1


def cost_of_others(settings: Settings) -> MovingObstacleCost | None:
    """Return the cost of nearness to moving obstacles in a fleet; None without other robots.

    The others tell where they drive, so there is no Gaussian around where they may be.
    """
    if not has_others(settings):
        return None
    return MovingObstacleCost(nearness=None, clearance=2.0 * settings.robot.radius + ROOM)


def build_fleet(
    given: FleetSettings,
    settings: Settings,
    scenario: ExplorationScenario,
    controller: Controller,
    datum: Datum,
) -> tuple[FleetController, Fleet]:
    """Build the controller and the scenario of a fleet of equal robots from those of one robot.

    All positions of the fleet are relative to the datum.
    """
    if settings.target not in (None, "coverage", "never"):
        raise ValueError(
            f"target is {settings.target!r}; accepted in a fleet: coverage, never: another robot "
            "may know what one has left to learn"
        )
    if given.starts is None:
        starts = near_starts(scenario, given.robots)
        # A robot alone has the start of an exploration to the bit.
        poses = None if given.robots == 1 else starts
    else:
        if len(given.starts) != given.robots:
            raise ValueError(
                f"fleet.starts has {len(given.starts)} poses for {given.robots} robots; accepted: "
                "one for each"
            )
        poses = datum.to_local([list(each) for each in given.starts])
    fleet = Fleet(
        scenario,
        poses,
        radio=Radio(**arguments(given, Radio)),
        plan_step=settings.controller.dt,
        plan_length=min(settings.controller.horizon, 60),
        **arguments(given, Fleet),
    )
    return same_for_all(controller, fleet.robot), fleet
