"""Settings of a robot that does not know its pose."""

from typing import Annotated, Any, Literal

from jaxplore.localisation.closing import LoopCloser
from jaxplore.localisation.inertial import InertialOdometry
from jaxplore.localisation.localiser import Localiser
from jaxplore.localisation.odometry import Odometry
from jaxplore.localisation.particle_localiser import ParticleLocaliser
from jaxplore.localisation.particles import ParticleFilter
from jaxplore.planning.presets.explorer import explorer
from jaxplore.robot.localisation import Localisation
from jaxplore.settings.defaults import in_degrees, setting
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
