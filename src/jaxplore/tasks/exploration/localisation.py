"""The localisation of a robot, from settings."""

import math
from typing import Any

from jaxplore.belief.certainty import CertaintyField
from jaxplore.dynamics.uncertain import UncertainRobot
from jaxplore.localisation.closing import LoopCloser
from jaxplore.localisation.inertial import InertialOdometry
from jaxplore.localisation.localiser import Localiser
from jaxplore.localisation.odometry import Odometry
from jaxplore.localisation.odometry_model import OdometryModel
from jaxplore.localisation.particle_localiser import ParticleLocaliser
from jaxplore.localisation.particles import ParticleFilter
from jaxplore.robot.localisation import Localisation
from jaxplore.sensing.beams import Beams
from jaxplore.settings.defaults import arguments
from jaxplore.settings.localisation import LocalisationSettings
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.tasks.exploration.settings import Settings


def build_localisation(
    settings: Settings, sensor: Beams, resolution: float, *, is_map_known: bool = False
) -> Localisation | None:
    """Build what lets a robot find its pose; None for one that knows it.

    The sensor is the first one, and `resolution` is the side of a cell of the map [m].

    Raises:
        ValueError: particles without a known map, or with a bound of the uncertainty.
    """
    given = settings.localisation
    if given is None:
        return None
    is_planned = given.uncertainty_weight > 0.0
    odometry = _odometry(given, settings.robot.model)
    common: dict[str, Any] = {
        "certainty": CertaintyField(sensor, resolution) if is_planned else None,
        **arguments(given, Localisation),
    }
    if given.method == "particles":
        if not is_map_known:
            raise ValueError(
                "setting localisation.method is 'particles' without a known map; accepted: "
                "is_map_known true, or a world, which says what is known of it"
            )
        if given.most_uncertainty is not None:
            raise ValueError(
                f"setting localisation.most_uncertainty is {given.most_uncertainty:g} with "
                "localisation.method particles; accepted: none, for it closes no loops"
            )
        known = ParticleFilter(odometry, **arguments(given, ParticleFilter))
        localiser = ParticleLocaliser(
            known, spacing=given.spacing, **arguments(given, ParticleLocaliser)
        )
        return Localisation(localiser=localiser, **common)
    return Localisation(
        localiser=Localiser(odometry, **arguments(given, Localiser)),
        closer=LoopCloser(**arguments(given, LoopCloser)) if given.loops else None,
        **common,
    )


def _odometry(given: LocalisationSettings, model: str) -> OdometryModel:
    """Build the odometry of a robot with a model."""
    if given.odometry_of(model) == "imu":
        return InertialOdometry(**arguments(given, InertialOdometry))
    angles = ("turn_per_distance", "turn_noise")
    # `arguments` returns angles in degrees, as settings have them.
    return Odometry(
        **arguments(given, Odometry)
        | {name: math.radians(getattr(given, f"{name}_degrees")) for name in angles}
    )


def uncertain_robot(scenario: ExplorationScenario, rate: float) -> UncertainRobot | None:
    """Return the robot with the variance of its position; None if plans do not know it.

    `rate` is that of the scans [Hz].
    """
    known = scenario.localisation
    if known is None or known.certainty is None:
        return None
    added = known.localiser.expected_odometry.variance_per_metre
    return UncertainRobot(scenario.robot, known.certainty.blank(), added, rate)
