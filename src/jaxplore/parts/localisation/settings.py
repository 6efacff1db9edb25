"""Settings of a robot that does not know its pose."""

import math
from typing import Annotated, Any, Literal

from jaxplore.belief.certainty import CertaintyField
from jaxplore.localisation.closing import LoopCloser
from jaxplore.localisation.inertial import InertialOdometry
from jaxplore.localisation.localiser import Localiser
from jaxplore.localisation.odometry import Odometry
from jaxplore.localisation.odometry_model import OdometryModel
from jaxplore.localisation.particle_localiser import ParticleLocaliser
from jaxplore.localisation.particles import ParticleFilter
from jaxplore.localisation.volume_localiser import VolumeLocaliser
from jaxplore.localisation.volume_odometry import VolumeOdometry
from jaxplore.parts.capability import Built, Capability, Surroundings
from jaxplore.planning.presets.explorer import explorer
from jaxplore.robot.localisation import Localisation
from jaxplore.sensing.beams import Beams as LidarBeams
from jaxplore.settings.defaults import arguments, in_degrees, setting
from jaxplore.settings.readers import Readers
from jaxplore.settings.sections import (
    Beams,
    Length,
    NonNegative,
    Positive,
    Rate,
    Samples,
    Section,
    Share,
)


def _by_method(method: str) -> Readers:
    text = f"runs with localisation.method {method}"
    return Readers(
        text, lambda settings: settings.localisation.method == method, "localisation.method"
    )


def _by_odometry(odometry: str, words: str) -> Readers:
    def reads(settings: Any) -> bool:
        found: str = settings.localisation.odometry_of(settings.robot.model)
        return found == odometry

    return Readers(f"runs whose localisation has {words}", reads)


MATCHING, FILTERING = _by_method("matching"), _by_method("particles")
ON_WHEELS, INERTIAL = _by_odometry("wheels", "wheels"), _by_odometry("imu", "an IMU")
CLOSING = Readers(
    "runs with a localisation that closes loops",
    lambda settings: MATCHING.reads(settings) and settings.localisation.loops,
)
IN_PLANS = Readers(
    "the explorer with a localisation",
    lambda settings: settings.architecture == "explorer",
    "architecture",
)


class LocalisationSettings(Section):
    """Odometry with errors, and how the robot finds its pose: see
    `jaxplore.localisation.Odometry`, `jaxplore.localisation.InertialOdometry`,
    `jaxplore.localisation.Localiser`, `jaxplore.localisation.LoopCloser` and
    `jaxplore.localisation.ParticleLocaliser`.

    Args:
        method: `matching` matches scans while it maps; `particles` finds the pose on a map that is
            known in advance, by a particle filter.
        odometry: `wheels`, or `imu`, which integrates accelerations and turn rates. None is `imu`
            for a quadrotor and `wheels` for robots on the ground.
        loops: whether loops are closed.
    """

    method: Literal["matching", "particles"] = "matching"
    odometry: Literal["wheels", "imu"] | None = None
    distance_noise: Annotated[NonNegative, ON_WHEELS] = setting(Odometry, "distance_noise")
    turn_per_distance_degrees: Annotated[NonNegative, ON_WHEELS] = setting(
        Odometry, "turn_per_distance", in_degrees
    )
    turn_noise_degrees: Annotated[NonNegative, ON_WHEELS] = setting(
        Odometry, "turn_noise", in_degrees
    )
    slip_in_turns: Annotated[NonNegative, ON_WHEELS] = setting(Odometry, "slip_in_turns")
    scale: Annotated[NonNegative, ON_WHEELS] = setting(Odometry, "scale")
    turn_scale: Annotated[NonNegative, ON_WHEELS] = setting(Odometry, "turn_scale")
    turn_per_metre: Annotated[NonNegative, ON_WHEELS] = setting(Odometry, "turn_per_metre")
    gyro: Annotated[NonNegative, ON_WHEELS] = setting(Odometry, "gyro")
    acceleration_noise: Annotated[NonNegative, INERTIAL] = setting(
        InertialOdometry, "acceleration_noise"
    )
    acceleration_bias: Annotated[NonNegative, INERTIAL] = setting(
        InertialOdometry, "acceleration_bias"
    )
    gyro_noise: Annotated[NonNegative, INERTIAL] = setting(InertialOdometry, "gyro_noise")
    gyro_bias: Annotated[NonNegative, INERTIAL] = setting(InertialOdometry, "gyro_bias")
    bias_time: Annotated[Positive, INERTIAL] = setting(InertialOdometry, "bias_time")
    spacing: Length = setting(Localiser, "spacing")
    num_particles: Annotated[Samples, FILTERING] = setting(ParticleFilter, "num_particles")
    num_beams: Annotated[Beams, FILTERING] = setting(ParticleFilter, "num_beams")
    is_start_known: Annotated[bool, FILTERING] = setting(ParticleLocaliser, "is_start_known")
    memory: Annotated[Length, MATCHING] = setting(Localiser, "memory")
    loops: Annotated[bool, MATCHING] = True
    uncertainty_weight: Annotated[NonNegative, IN_PLANS] = setting(explorer, "uncertainty_weight")
    most_uncertainty: Length | None = setting(Localisation, "most_uncertainty")
    closing_rate: Annotated[Rate, CLOSING] = setting(Localisation, "closing_rate")
    reach: Annotated[Length, CLOSING] = setting(LoopCloser, "reach")
    least_share: Annotated[Share, CLOSING] = setting(LoopCloser, "least_share")
    tolerance: Annotated[Positive, CLOSING] = setting(LoopCloser, "tolerance")

    def odometry_of(self, model: str) -> Literal["wheels", "imu"]:
        """Return which odometry a robot has."""
        if self.odometry is not None:
            return self.odometry
        return "imu" if model == "quadrotor" else "wheels"


class VolumeLocalisationSettings(Section):
    """Odometry with errors, and a robot that finds its pose by its scans: see
    `jaxplore.localisation.VolumeOdometry` and `jaxplore.localisation.VolumeLocaliser`."""

    distance_noise: NonNegative = setting(VolumeOdometry, "distance_noise")
    turn_per_distance_degrees: NonNegative = setting(
        VolumeOdometry, "turn_per_distance", in_degrees
    )
    turn_noise_degrees: NonNegative = setting(VolumeOdometry, "turn_noise", in_degrees)
    scale: NonNegative = setting(VolumeOdometry, "scale")


def make_localisation(
    given: LocalisationSettings,
    model: str,
    sensor: LidarBeams,
    resolution: float,
    *,
    is_map_known: bool = False,
) -> Localisation:
    """Make what lets a robot with a model find its pose.

    The sensor is the first one, and `resolution` is the side of a cell of the map [m].

    Raises:
        ValueError: particles without a known map, or with a bound of the uncertainty.
    """
    is_planned = given.uncertainty_weight > 0.0
    odometry = _odometry(given, model)
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


def build_localisation(given: LocalisationSettings, around: Surroundings) -> Built:
    """Build what lets a robot in the plane find its pose."""
    assert around.robot is not None
    assert around.grid is not None
    found = make_localisation(
        *(given, around.robot.model, around.sensors[0], around.grid.resolution),
        is_map_known=around.is_map_known,
    )
    return Built(perception={"is_localising": True}, scenario={"localisation": found})


def build_volume_localisation(given: VolumeLocalisationSettings, _: Surroundings) -> Built:
    """Build what lets a robot in a volume find its pose."""
    # `arguments` returns angles in degrees, as settings have them.
    numbers = {
        "turn_per_distance": math.radians(given.turn_per_distance_degrees),
        "turn_noise": math.radians(given.turn_noise_degrees),
    }
    odometry = VolumeOdometry(**arguments(given, VolumeOdometry) | numbers)
    return Built(scenario={"localiser": VolumeLocaliser(odometry)})


LOCALISATION = Capability(
    name="localisation",
    meaning="odometry with errors and how the robot finds its pose; it knows its pose when absent.",
    settings=LocalisationSettings,
    build=build_localisation,
)
LOCALISATION_IN_VOLUME = Capability(
    name="localisation",
    meaning="odometry with errors and how the robot finds its pose; it knows its pose when absent.",
    settings=VolumeLocalisationSettings,
    build=build_volume_localisation,
    dimensions=3,
)
