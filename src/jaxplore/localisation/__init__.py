"""Where the robot is: odometry with errors, matching of scans, particle filters."""

from jaxplore.localisation.likelihood_field import LikelihoodField as LikelihoodField
from jaxplore.localisation.odometry import Odometry as Odometry
from jaxplore.localisation.odometry import OdometryBias as OdometryBias
from jaxplore.localisation.particles import ParticleFilter as ParticleFilter
from jaxplore.localisation.particles import Particles as Particles
from jaxplore.localisation.particles import PoseEstimate as PoseEstimate
