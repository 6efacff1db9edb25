"""The chassis that settings describe, and who gets it."""

import math

import numpy as np
import pytest

from jaxplore.costs import StabilityCost
from jaxplore.maps.datum import ORIGIN
from jaxplore.parts.capability import Surroundings
from jaxplore.parts.wheels.settings import ChassisSettings, build_chassis
from jaxplore.settings.robot import RobotSettings
from jaxplore.tasks.exploration.build import build_exploration
from jaxplore.tasks.exploration.settings import make_exploration_settings
from jaxplore.tasks.robot import build_robot

PLACE = {"map": "office"}


def built(robot: dict[str, object], **chassis: float):
    given = RobotSettings(**robot)
    around = Surroundings(ORIGIN, robot=given, radius=float(build_robot(given).radius))
    return build_chassis(ChassisSettings(**chassis), around)


def test_a_car_has_its_own_wheels() -> None:
    car = built({"model": "ackermann", "wheelbase": 0.5, "width": 0.4, "length": 0.7})
    assert float(car.wheelbase) == pytest.approx(0.5)
    assert float(car.track) == pytest.approx(0.4)
    # The position of the model is the middle of the rear axle.
    assert float(car.offset) == pytest.approx(0.25)
    bicycle = built({"model": "bicycle", "wheelbase": 0.6, "radius": 0.4}, track=0.3)
    assert float(bicycle.wheelbase) == pytest.approx(0.6)
    assert float(bicycle.track) == pytest.approx(0.3)
    assert float(bicycle.offset) == 0.0


def test_the_wheels_of_a_disc_are_the_corners_of_a_square_in_it() -> None:
    square = built({"radius": 0.3}, mass_height=0.7, suspension=0.02)
    corner = 0.5 * np.array([float(square.wheelbase), float(square.track)])
    assert math.hypot(*corner) == pytest.approx(0.3)
    assert float(square.mass_height) == pytest.approx(0.7)
    assert float(square.suspension) == pytest.approx(0.02)


@pytest.mark.parametrize("architecture", ["explorer", "portfolio", "nearest-cluster"])
def test_whoever_drives_knows_it(architecture: str) -> None:
    def costs(**more: object) -> list[StabilityCost]:
        entries = {**PLACE, "architecture": architecture, **more}
        made = build_exploration(make_exploration_settings(entries))
        assert [each.name for each in made.scenario.truths] == (["wheels"] if more else [])
        leaves = _all(made.controller)
        return [each for each in leaves if isinstance(each, StabilityCost)]

    assert costs() == []
    (found,) = costs(chassis={"mass_height": 0.33})
    assert float(found.chassis.mass_height) == pytest.approx(0.33)


def _all(node: object) -> list[object]:
    """Return a module and everything in it."""
    if isinstance(node, tuple):
        return [each for part in node for each in _all(part)]
    inner = vars(node).values() if hasattr(node, "__dict__") else ()
    return [node, *(each for part in inner for each in _all(part))]


@pytest.mark.parametrize(
    ("chassis", "message"),
    [
        ({"mass_height": 0.0}, r"setting chassis.mass_height is 0.0; accepted: greater than 0"),
        ({"height": 1.0}, r"unknown setting chassis.height; accepted here: wheelbase, track, mass"),
        (3, r"setting chassis is 3; accepted: a mapping of settings"),
    ],
)
def test_another_chassis_is_refused(chassis: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_exploration_settings({**PLACE, "chassis": chassis})


def test_a_quadrotor_has_none() -> None:
    entries = {"map": "zones", "chassis": {"mass_height": 0.3}}
    with pytest.raises(ValueError, match=r"setting chassis is given beside a quadrotor; accepted"):
        build_exploration(make_exploration_settings(entries))
