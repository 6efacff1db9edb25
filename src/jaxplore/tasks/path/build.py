"""Path-following experiments, from settings."""

import jax
import numpy as np

from jaxplore.control.disturbance import Disturbance, UncertainObstacles
from jaxplore.control.risk import ConditionalValueAtRisk, Risk
from jaxplore.costs.base import Cost
from jaxplore.geometry.outlines import Outlines
from jaxplore.geometry.path import Path
from jaxplore.geometry.track import race_track
from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.maps.files.path_file import path_datum, read_path
from jaxplore.parameters import set_parameters
from jaxplore.parts.capability import Surroundings
from jaxplore.parts.registry import build_parts
from jaxplore.planning.presets.path_following import PathFollowing, avoidance_cost, mpcc
from jaxplore.settings.defaults import arguments
from jaxplore.simulation.experiment import Experiment
from jaxplore.simulation.following.scenario import PathScenario
from jaxplore.simulation.following.traffic import Traffic
from jaxplore.tasks.path.settings import TRACK, PathSettings
from jaxplore.tasks.robot import (
    build_robot,
    with_adaptive_horizon,
    with_latency,
)


def build_path_following(settings: PathSettings) -> Experiment:
    """Build the experiment that settings describe."""
    datum = ORIGIN if settings.path == TRACK else path_datum(settings.path)
    path = build_path(settings, datum)
    traffic, standing = _traffic(settings, path), _build_standing(settings, datum)
    has_obstacles = traffic is not None or standing is not None
    following = _build_following(settings, path, has_obstacles=has_obstacles)
    scenario = PathScenario(
        following.model,
        path,
        start=None if settings.start is None else datum.to_local(settings.start),
        traffic=traffic,
        standing=standing,
        datum=datum,
        **arguments(settings, PathScenario),
        **arguments(settings.obstacles, PathScenario),
    ).with_disturbances(build_parts(settings, Surroundings(datum)).disturbances)
    controller = with_adaptive_horizon(
        set_parameters(following.controller, settings.parameters), settings.adaptive_horizon
    )
    return Experiment(
        with_latency(controller, settings, scenario),
        scenario,
        max(1, round(settings.time_limit * settings.control_rate)),
        jax.random.key(settings.seed),
    )


def _build_following(settings: PathSettings, path: Path, *, has_obstacles: bool) -> PathFollowing:
    other: Cost | None = None
    disturbance: Disturbance | None = None
    risk: Risk | None = None
    given = settings.controller
    if has_obstacles:
        avoidance = arguments(settings.obstacles, avoidance_cost)
        if given.risk_level is not None:
            disturbance, risk = UncertainObstacles(), ConditionalValueAtRisk(given.risk_level)
            # With outcomes, the sampled motions represent the uncertainty: no caution on top of
            # them.
            avoidance["caution"] = 0.0
        other = avoidance_cost(**avoidance)
    return mpcc(
        build_robot(settings.robot),
        path,
        other=other,
        disturbance=disturbance,
        risk=risk,
        **arguments(given, mpcc),
    )


def build_path(settings: PathSettings, datum: Datum) -> Path:
    """Build the path of a run, relative to a datum."""
    if settings.path == TRACK:
        return race_track(**arguments(settings.track, race_track))
    path = read_path(settings.path, datum=datum, **arguments(settings, read_path))
    if settings.half_width is not None and not path.has_room:
        path = path.with_room([settings.half_width, settings.half_width])
    return path


def _traffic(settings: PathSettings, path: Path) -> Traffic | None:
    given = settings.obstacles
    if not given.number:
        return None
    if given.speeds[0] > given.speeds[1]:
        raise ValueError(
            f"setting obstacles.speeds is {given.speeds}; accepted: the least and the greatest"
        )
    return Traffic.random(
        path,
        given.number,
        seed=settings.seed if given.seed is None else given.seed,
        **arguments(given, Traffic.random),
    )


def _build_standing(settings: PathSettings, datum: Datum) -> Outlines | None:
    given = settings.obstacles
    if not given.discs and not given.polygons:
        return None
    discs = datum.to_local(np.reshape(given.discs, (-1, 3)))
    polygons = [datum.to_local(each) for each in given.polygons]
    return Outlines.discs(discs[:, :2], discs[:, 2]) + Outlines.polygons(polygons)
