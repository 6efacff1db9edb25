"""Where the robot is: odometry with errors, matching of scans, closed loops, particle filters."""

from jaxplore.localisation.closing import LoopCloser as LoopCloser
from jaxplore.localisation.estimator import PoseEstimator as PoseEstimator
from jaxplore.localisation.estimator import PoseState as PoseState
from jaxplore.localisation.estimator import WayPoints as WayPoints
from jaxplore.localisation.likelihood_field import LikelihoodField as LikelihoodField
from jaxplore.localisation.localiser import Localiser as Localiser
from jaxplore.localisation.localiser import LocaliserState as LocaliserState
from jaxplore.localisation.log_mapping import LogMap as LogMap
from jaxplore.localisation.log_mapping import map_log as map_log
from jaxplore.localisation.odometry import Odometry as Odometry
from jaxplore.localisation.odometry import OdometryBias as OdometryBias
from jaxplore.localisation.particle_localiser import ParticleLocaliser as ParticleLocaliser
from jaxplore.localisation.particle_localiser import ParticleState as ParticleState
from jaxplore.localisation.particle_localiser import StoredPoses as StoredPoses
from jaxplore.localisation.particles import ParticleFilter as ParticleFilter
from jaxplore.localisation.particles import Particles as Particles
from jaxplore.localisation.particles import PoseEstimate as PoseEstimate
from jaxplore.localisation.pose_graph import Graph as Graph
from jaxplore.localisation.pose_graph import Optimum as Optimum
from jaxplore.localisation.pose_graph import optimised as optimised
from jaxplore.localisation.scan_matching import ScanMatch as ScanMatch
from jaxplore.localisation.scan_matching import ScanMatcher as ScanMatcher
from jaxplore.localisation.surface import EndPoints as EndPoints
from jaxplore.localisation.surface import SurfaceMap as SurfaceMap
