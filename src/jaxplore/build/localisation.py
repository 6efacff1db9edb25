"""The localisation of a robot, from settings."""

import math

from jaxplore.belief.certainty import CertaintyField
from jaxplore.dynamics.uncertain import UncertainRobot
from jaxplore.localisation.closing import LoopCloser
from jaxplore.localisation.localiser import Localiser
from jaxplore.localisation.odometry import Odometry
from jaxplore.sensing.beams import Beams
from jaxplore.settings.defaults import arguments
from jaxplore.settings.exploration import Settings
from jaxplore.simulation.exploration.located import Localisation
from jaxplore.simulation.exploration.scenario import ExplorationScenario


def build_localisation(settings: Settings, sensor: Beams, resolution: float) -> Localisation | None:
    """Build what lets a robot find its pose; None for one that knows it.

    Args:
        settings: settings of the run.
        sensor: the first sensor.
        resolution: side of a cell of the map [m].
    """
    given = settings.localisation
    if given is None:
        return None
    is_planned = given.uncertainty_weight > 0.0
    angles = ("turn_per_distance", "turn_noise")
    # `arguments` returns angles in degrees, as settings have them.
    odometry = Odometry(
        **arguments(given, Odometry)
        | {name: math.radians(getattr(given, f"{name}_degrees")) for name in angles}
    )
    return Localisation(
        localiser=Localiser(odometry, **arguments(given, Localiser)),
        certainty=CertaintyField(sensor, resolution) if is_planned else None,
        closer=LoopCloser(**arguments(given, LoopCloser)) if given.loops else None,
        **arguments(given, Localisation),
    )


def uncertain_robot(scenario: ExplorationScenario, rate: float) -> UncertainRobot | None:
    """Return the robot with the variance of its position; None if plans do not know it.

    Args:
        scenario: scenario of the run.
        rate: rate of scans [Hz].
    """
    known = scenario.localisation
    if known is None or known.certainty is None:
        return None
    added = known.localiser.odometry.distance_noise**2
    return UncertainRobot(scenario.robot, known.certainty.blank(), added, rate)
