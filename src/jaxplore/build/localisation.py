"""The localisation of a robot, from settings."""

import math

from jaxplore.localisation.closing import LoopCloser
from jaxplore.localisation.localiser import Localiser
from jaxplore.localisation.odometry import Odometry
from jaxplore.settings.defaults import arguments
from jaxplore.settings.localisation import LocalisationSettings
from jaxplore.simulation.exploration.located import Localisation


def build_localisation(given: LocalisationSettings | None) -> Localisation | None:
    """Build what lets a robot find its pose; None for one that knows it.

    Args:
        given: settings of the localisation.
    """
    if given is None:
        return None
    angles = ("turn_per_distance", "turn_noise", "turn_per_metre", "gyro")
    # `arguments` returns angles in degrees, as settings have them.
    odometry = Odometry(
        **arguments(given, Odometry)
        | {name: math.radians(getattr(given, f"{name}_degrees")) for name in angles}
    )
    return Localisation(
        localiser=Localiser(odometry, **arguments(given, Localiser)),
        closer=LoopCloser(**arguments(given, LoopCloser)) if given.loops else None,
        **arguments(given, Localisation),
    )
