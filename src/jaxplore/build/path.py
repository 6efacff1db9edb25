"""A run along a path, from settings."""

from typing import NamedTuple

import jax
import numpy as np

from jaxplore._types import Key
from jaxplore.control.base import Controller
from jaxplore.control.disturbance import Disturbance, UncertainObstacles
from jaxplore.parameters import set_parameters
from jaxplore.control.risk import ConditionalValueAtRisk, Risk
from jaxplore.costs.base import Cost
from jaxplore.costs.comfort import ComfortCost
from jaxplore.costs.obstacle_distance import ObstacleDistanceCost
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.kinematic_bicycle import KinematicBicycle
from jaxplore.build.parts import robot_of
from jaxplore.geometry.outlines import Outlines
from jaxplore.geometry.path import Path
from jaxplore.geometry.track import race_track
from jaxplore.maps.files.path_file import read_path
from jaxplore.settings.path import TRACK, PathRobotSettings, PathSettings
from jaxplore.planning.presets.path_following import mpcc
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.following.scenario import PathScenario
from jaxplore.simulation.following.traffic import Traffic


def build_path(settings: PathSettings) -> Experiment:
    """Return the run that settings describe.

    Raises:
        ValueError: a file that cannot be read, and what the parts refuse.
    """
    path = _path(settings)
    robot = _robot(settings.robot)
    traffic, standing = _traffic(settings, path), _standing(settings)
    given, obstacles = settings.controller, settings.obstacles
    other: Cost = given.comfort_weight * ComfortCost(
        lateral=1.0,
        longitudinal=1.0,
        free_lateral=given.max_lateral,
        free_longitudinal=given.max_longitudinal,
    )
    disturbance: Disturbance | None = None
    risk: Risk | None = None
    if traffic is not None or standing is not None:
        caution = obstacles.caution
        if given.risk_level is not None:
            disturbance, risk = UncertainObstacles(), ConditionalValueAtRisk(given.risk_level)
            caution = 0.0
        other = other + obstacles.weight * ObstacleDistanceCost(
            clearance=obstacles.clearance,
            collision=1.0,
            margin=obstacles.margin,
            caution=caution,
        )
    half_range = np.asarray(robot.control_half_range)
    following = mpcc(
        robot,
        path,
        noise_std=given.noise_share * half_range,
        max_speed=settings.robot.max_speed,
        other=other,
        disturbance=disturbance,
        num_outcomes=1 if disturbance is None else given.num_outcomes,
        risk=risk,
        **given.model_dump(include=set(_MPCC)),
    )
    scenario = PathScenario(
        following.model,
        path,
        start=settings.start,
        laps=settings.laps,
        traffic=traffic,
        standing=standing,
        control_rate=settings.control_rate,
        prediction=obstacles.prediction,
        growth=obstacles.growth,
        turn_growth=obstacles.turn_growth,
    )
    return Experiment(
        set_parameters(following.planner.mppi, settings.parameters),
        scenario,
        max(1, round(settings.time_limit * settings.control_rate)),
        jax.random.key(settings.seed),
    )


_MPCC = (
    "horizon",
    "num_samples",
    "dt",
    "temperature",
    "contouring_weight",
    "lag_weight",
    "progress_weight",
    "progress_noise",
    "corridor_margin",
)
"""Settings that `mpcc` takes by the same name."""


def _path(settings: PathSettings) -> Path:
    if settings.path == TRACK:
        return race_track(**settings.track.model_dump())
    path = read_path(settings.path, method=settings.method, is_closed=settings.is_closed)
    if settings.half_width is not None and not path.has_room:
        path = path.with_room([settings.half_width, settings.half_width])
    return path


def _robot(given: PathRobotSettings) -> Dynamics:
    if given.model != "bicycle":
        return robot_of(given)
    half = 0.5 * given.wheelbase
    return KinematicBicycle(
        half,
        half,
        max_speed=given.max_speed,
        max_steering=given.max_steering,
        max_acceleration=given.max_acceleration,
        min_speed=given.min_speed,
        radius=given.radius,
    )


def _traffic(settings: PathSettings, path: Path) -> Traffic | None:
    given = settings.obstacles
    if given.speeds[0] > given.speeds[1]:
        raise ValueError(
            f"setting obstacles.speeds is {given.speeds}; accepted: the least and the greatest"
        )
    if not given.number:
        return None
    return Traffic.random(
        path,
        given.number,
        seed=settings.seed if given.seed is None else given.seed,
        radius=given.radius,
        rates=given.speeds,
    )


def _standing(settings: PathSettings) -> Outlines | None:
    given = settings.obstacles
    if not given.discs and not given.polygons:
        return None
    discs = np.reshape(given.discs, (-1, 3))
    return Outlines.discs(discs[:, :2], discs[:, 2]) + Outlines.polygons(given.polygons)
