"""Settings of people around the robot."""

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from jaxplore._limits import MOST_PEOPLE
from jaxplore.belief.tracks import ObstacleTracker
from jaxplore.costs.occlusion import OcclusionCost
from jaxplore.maps.generators.people import walking_people
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.maps.world import MovingObstacle
from jaxplore.parts.capability import Built, Capability, Surroundings
from jaxplore.parts.moving.truth import MovingObstacles
from jaxplore.settings.defaults import arguments, setting
from jaxplore.settings.readers import Readers
from jaxplore.settings.sections import Body, NonNegative, Positive, Section, Seed
from jaxplore.simulation.volume.people import floor_plan

WALKING = Readers("runs with people", lambda settings: settings.people.number > 0, "people.number")


class WalkerSettings(Section):
    """People who walk on the floor of the volume: see `jaxplore.maps.walking_people`.

    Args:
        number: number of people.
        seed: seed of their ways; the run's when absent.
    """

    number: Annotated[int, Field(ge=0, le=MOST_PEOPLE)] = 0
    speed: Annotated[NonNegative, WALKING] = setting(walking_people, "speed")
    radius: Annotated[Body, WALKING] = setting(walking_people, "radius")
    seed: Annotated[Seed | None, WALKING] = None


class PeopleSettings(WalkerSettings):
    """People who walk on the map (`jaxplore.maps.walking_people`), and how the robot minds them
    (`jaxplore.belief.ObstacleTracker`).

    Args:
        number: number of people in the simulation, beside the moving obstacles of a world.
        are_expected: whether the robot looks out for people: it tracks what moves, drives slowly
            past places that can hide somebody, and brakes for what could reach it. When absent it
            does so where something moves, and a node always does.
    """

    are_expected: bool | None = None
    max_speed: Positive = setting(ObstacleTracker, "max_speed")


def place_walkers(given: WalkerSettings, around: Surroundings) -> MovingObstacles | None:
    """Let people walk on the map or in the volume, after the moving obstacles of the world."""
    moving: tuple[MovingObstacle, ...] = () if around.world is None else around.world.movers
    if around.grid is not None and given.number:
        world = around.grid
        floor = floor_plan(world) if isinstance(world, VoxelGrid) else world.unpad()
        seed = around.seed if given.seed is None else given.seed
        walking = walking_people(
            floor, given.number, speed=given.speed, radius=given.radius, seed=seed
        )
        moving = (*moving, *walking)
    return MovingObstacles(moving) if moving else None


def has_moving(given: WalkerSettings, around: Surroundings) -> bool:
    """Check whether anything moves in the world beside robots."""
    has_movers = around.world is not None and bool(around.world.movers)
    return has_movers or (around.grid is not None and given.number > 0)


def are_expected(given: PeopleSettings, around: Surroundings) -> bool:
    """Check whether the robot looks out for people.

    A robot among others of a fleet, or on a known ground, is told of what moves.
    """
    expected = has_moving(given, around) if given.are_expected is None else given.are_expected
    return expected and not around.has_others and around.ground is None


def build_people(given: PeopleSettings, around: Surroundings) -> Built:
    """Build the people, and the tracker by which the robot finds them."""
    tracker = ObstacleTracker(**arguments(given, ObstacleTracker))
    found = {"tracker": tracker} if are_expected(given, around) else {}
    return Built(truth=place_walkers(given, around), perception=found)


def mind_people(given: PeopleSettings, around: Surroundings) -> Mapping[str, Any]:
    """Return how a controller minds people: the cost of places that can hide somebody."""
    if not are_expected(given, around):
        return {"has_moving_obstacles": True} if has_moving(given, around) else {}
    robot = around.robot
    assert robot is not None
    brakes = robot.max_acceleration if robot.max_deceleration is None else robot.max_deceleration
    cost = OcclusionCost(given.max_speed, brakes)
    return {"has_moving_obstacles": True, "occlusion_cost": cost}


PEOPLE = Capability(
    name="people",
    meaning="people who walk on the map, and how the robot minds them.",
    settings=PeopleSettings,
    build=build_people,
    control=mind_people,
    is_optional=False,
    on_board={"are_expected": True},
)
PEOPLE_IN_VOLUME = Capability(
    name="people",
    meaning="people who walk in the volume.",
    settings=WalkerSettings,
    build=lambda given, around: Built(truth=place_walkers(given, around)),
    dimensions=3,
    control=lambda given, around: {"has_moving_obstacles": has_moving(given, around)},
    is_optional=False,
)
