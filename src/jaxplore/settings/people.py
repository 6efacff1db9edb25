"""Settings of people around the robot."""

from typing import Annotated

from pydantic import Field

from jaxplore._limits import MOST_PEOPLE
from jaxplore.belief.tracks import ObstacleTracker
from jaxplore.maps.generators.people import walking_people
from jaxplore.settings.defaults import setting
from jaxplore.settings.readers import Readers
from jaxplore.settings.sections import Body, NonNegative, Positive, Section, Seed

WALKING = Readers("runs with people", lambda settings: settings.people.number > 0, "people.number")


class PeopleSettings(Section):
    """People who walk on the map (`jaxplore.maps.walking_people`), and how the robot minds them
    (`jaxplore.belief.ObstacleTracker`).

    Args:
        number: number of people in the simulation, beside the moving obstacles of a world.
        seed: seed of their ways; the run's when absent.
        are_expected: whether the robot looks out for people: it tracks what moves, drives slowly
            past places that can hide somebody, and brakes for what could reach it. When absent it
            does so where something moves, and a node always does.
    """

    number: Annotated[int, Field(ge=0, le=MOST_PEOPLE)] = 0
    speed: Annotated[NonNegative, WALKING] = setting(walking_people, "speed")
    radius: Annotated[Body, WALKING] = setting(walking_people, "radius")
    seed: Annotated[Seed | None, WALKING] = None
    are_expected: bool | None = None
    max_speed: Positive = setting(ObstacleTracker, "max_speed")
