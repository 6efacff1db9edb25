"""Settings of a robot that does not know its pose."""

from typing import Literal

from jaxplore.localisation.closing import LoopCloser
from jaxplore.localisation.inertial import InertialOdometry
from jaxplore.localisation.localiser import Localiser
from jaxplore.localisation.odometry import Odometry
from jaxplore.localisation.particle_localiser import ParticleLocaliser
from jaxplore.localisation.particles import ParticleFilter
from jaxplore.planning.presets.explorer import explorer
from jaxplore.robot.localisation import Localisation
from jaxplore.settings.defaults import in_degrees, setting
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
    distance_noise: NonNegative = setting(Odometry, "distance_noise")
    turn_per_distance_degrees: NonNegative = setting(Odometry, "turn_per_distance", in_degrees)
    turn_noise_degrees: NonNegative = setting(Odometry, "turn_noise", in_degrees)
    slip_in_turns: NonNegative = setting(Odometry, "slip_in_turns")
    scale: NonNegative = setting(Odometry, "scale")
    turn_scale: NonNegative = setting(Odometry, "turn_scale")
    turn_per_metre: NonNegative = setting(Odometry, "turn_per_metre")
    gyro: NonNegative = setting(Odometry, "gyro")
    acceleration_noise: NonNegative = setting(InertialOdometry, "acceleration_noise")
    acceleration_bias: NonNegative = setting(InertialOdometry, "acceleration_bias")
    gyro_noise: NonNegative = setting(InertialOdometry, "gyro_noise")
    gyro_bias: NonNegative = setting(InertialOdometry, "gyro_bias")
    bias_time: Positive = setting(InertialOdometry, "bias_time")
    spacing: Length = setting(Localiser, "spacing")
    num_particles: Samples = setting(ParticleFilter, "num_particles")
    num_beams: Beams = setting(ParticleFilter, "num_beams")
    is_start_known: bool = setting(ParticleLocaliser, "is_start_known")
    memory: Length = setting(Localiser, "memory")
    loops: bool = True
    uncertainty_weight: NonNegative = setting(explorer, "uncertainty_weight")
    most_uncertainty: Length | None = setting(Localisation, "most_uncertainty")
    closing_rate: Rate = setting(Localisation, "closing_rate")
    reach: Length = setting(LoopCloser, "reach")
    least_share: Share = setting(LoopCloser, "least_share")
    tolerance: Positive = setting(LoopCloser, "tolerance")

    def odometry_of(self, model: str) -> Literal["wheels", "imu"]:
        """Return which odometry a robot has.

        Args:
            model: setting `robot.model`.
        """
        if self.odometry is not None:
            return self.odometry
        return "imu" if model == "quadrotor" else "wheels"
