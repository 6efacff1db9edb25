"""Sampling-based control and informative exploration on JAX.

The names that README, examples and guides use are flat in `jaxplore`: `jaxplore.MPPI`. Every
public name is in the package of its subject: `jaxplore.costs.CorridorCost`.

A package is imported when one of its names is first used, so that `import jaxplore` costs nothing.
"""

import importlib
from typing import TYPE_CHECKING, Any

from jaxplore._version import __version__ as __version__

# Python reads the table, type checkers and editors read the imports: a test compares them.
if TYPE_CHECKING:
    from jaxplore import belief as belief
    from jaxplore import compilation_cache as compilation_cache
    from jaxplore import control as control
    from jaxplore import costs as costs
    from jaxplore import dynamics as dynamics
    from jaxplore import geometry as geometry
    from jaxplore import information as information
    from jaxplore import localisation as localisation
    from jaxplore import maps as maps
    from jaxplore import parameters as parameters
    from jaxplore import parts as parts
    from jaxplore import planning as planning
    from jaxplore import recorder as recorder
    from jaxplore import report as report
    from jaxplore import sensing as sensing
    from jaxplore import simulation as simulation
    from jaxplore import study as study
    from jaxplore.belief import Perception as Perception
    from jaxplore.belief import VolumePerception as VolumePerception
    from jaxplore.compilation_cache import enable_compilation_cache as enable_compilation_cache
    from jaxplore.control import MPPI as MPPI
    from jaxplore.control import AugmentedProposal as AugmentedProposal
    from jaxplore.control import BiasedProposal as BiasedProposal
    from jaxplore.control import ColouredNoise as ColouredNoise
    from jaxplore.control import ConditionalValueAtRisk as ConditionalValueAtRisk
    from jaxplore.control import Elite as Elite
    from jaxplore.control import FeedbackMPPI as FeedbackMPPI
    from jaxplore.control import GaussianProposal as GaussianProposal
    from jaxplore.control import HaltonNoise as HaltonNoise
    from jaxplore.control import InjectedProposal as InjectedProposal
    from jaxplore.control import Knots as Knots
    from jaxplore.control import LatencyCompensation as LatencyCompensation
    from jaxplore.control import MotionGuard as MotionGuard
    from jaxplore.control import RBFKernel as RBFKernel
    from jaxplore.control import Smooth as Smooth
    from jaxplore.control import Softmax as Softmax
    from jaxplore.control import StateNoise as StateNoise
    from jaxplore.costs import ComfortCost as ComfortCost
    from jaxplore.costs import ContouringCost as ContouringCost
    from jaxplore.costs import ControlCost as ControlCost
    from jaxplore.costs import ControlRateCost as ControlRateCost
    from jaxplore.costs import Cost as Cost
    from jaxplore.costs import DiscObstacleCost as DiscObstacleCost
    from jaxplore.costs import GoalCost as GoalCost
    from jaxplore.costs import GuidanceCost as GuidanceCost
    from jaxplore.costs import InformationCost as InformationCost
    from jaxplore.costs import LagCost as LagCost
    from jaxplore.costs import MovingObstacleCost as MovingObstacleCost
    from jaxplore.costs import ObstacleCost as ObstacleCost
    from jaxplore.costs import StateCost as StateCost
    from jaxplore.costs import WaypointCost as WaypointCost
    from jaxplore.dynamics import RK4 as RK4
    from jaxplore.dynamics import Ackermann as Ackermann
    from jaxplore.dynamics import Augmented as Augmented
    from jaxplore.dynamics import ContinuousDynamics as ContinuousDynamics
    from jaxplore.dynamics import DifferentialDrive as DifferentialDrive
    from jaxplore.dynamics import Dynamics as Dynamics
    from jaxplore.dynamics import Euler as Euler
    from jaxplore.dynamics import Integrator as Integrator
    from jaxplore.dynamics import KinematicBicycle as KinematicBicycle
    from jaxplore.dynamics import Omnidirectional as Omnidirectional
    from jaxplore.dynamics import PathParameter as PathParameter
    from jaxplore.dynamics import Pendulum as Pendulum
    from jaxplore.dynamics import PointMass as PointMass
    from jaxplore.dynamics import Quadrotor as Quadrotor
    from jaxplore.dynamics import State as State
    from jaxplore.dynamics import Unicycle as Unicycle
    from jaxplore.geometry import Path as Path
    from jaxplore.geometry import Rectangle as Rectangle
    from jaxplore.geometry import path_through as path_through
    from jaxplore.geometry import race_track as race_track
    from jaxplore.geometry import sin_cos as sin_cos
    from jaxplore.information import FieldSensor as FieldSensor
    from jaxplore.information import PoseInformation as PoseInformation
    from jaxplore.information import TrajectoryInformation as TrajectoryInformation
    from jaxplore.maps import MovingObstacle as MovingObstacle
    from jaxplore.maps import OccupancyGrid as OccupancyGrid
    from jaxplore.maps import Shapes as Shapes
    from jaxplore.maps import TerrainMap as TerrainMap
    from jaxplore.maps import VoxelGrid as VoxelGrid
    from jaxplore.maps import World as World
    from jaxplore.maps import generate_map as generate_map
    from jaxplore.maps import generate_volume as generate_volume
    from jaxplore.maps import office as office
    from jaxplore.maps import start_pose as start_pose
    from jaxplore.maps import three_zones as three_zones
    from jaxplore.parameters import find_parameter as find_parameter
    from jaxplore.parameters import get_parameters as get_parameters
    from jaxplore.parameters import set_parameters as set_parameters
    from jaxplore.parts import Faults as Faults
    from jaxplore.parts import MovingObstacles as MovingObstacles
    from jaxplore.parts import Variation as Variation
    from jaxplore.planning import FieldNumbers as FieldNumbers
    from jaxplore.planning import Flight as Flight
    from jaxplore.planning import Mission as Mission
    from jaxplore.planning import Portfolio as Portfolio
    from jaxplore.planning import augmented_mppi as augmented_mppi
    from jaxplore.planning import explorer as explorer
    from jaxplore.planning import ground_portfolio as ground_portfolio
    from jaxplore.planning import informative_mppi as informative_mppi
    from jaxplore.planning import mpcc as mpcc
    from jaxplore.planning import volume_explorer as volume_explorer
    from jaxplore.report import Metrics as Metrics
    from jaxplore.report import Recording as Recording
    from jaxplore.sensing import Camera as Camera
    from jaxplore.sensing import DepthCamera as DepthCamera
    from jaxplore.sensing import InverseSensorModel as InverseSensorModel
    from jaxplore.sensing import Lidar as Lidar
    from jaxplore.sensing import RingLidar as RingLidar
    from jaxplore.sensing import Sensor as Sensor
    from jaxplore.simulation import ExplorationScenario as ExplorationScenario
    from jaxplore.simulation import Fleet as Fleet
    from jaxplore.simulation import PathScenario as PathScenario
    from jaxplore.simulation import Radio as Radio
    from jaxplore.simulation import Run as Run
    from jaxplore.simulation import Scenario as Scenario
    from jaxplore.simulation import Traffic as Traffic
    from jaxplore.simulation import VolumeScenario as VolumeScenario
    from jaxplore.simulation import simulate as simulate
    from jaxplore.study import compare as compare

_PACKAGES = {
    "belief": ["Perception", "VolumePerception"],
    "compilation_cache": ["enable_compilation_cache"],
    "control": [
        "MPPI",
        "AugmentedProposal",
        "BiasedProposal",
        "ColouredNoise",
        "ConditionalValueAtRisk",
        "Elite",
        "FeedbackMPPI",
        "GaussianProposal",
        "HaltonNoise",
        "InjectedProposal",
        "Knots",
        "LatencyCompensation",
        "MotionGuard",
        "RBFKernel",
        "Smooth",
        "Softmax",
        "StateNoise",
    ],
    "costs": [
        "ComfortCost",
        "ContouringCost",
        "ControlCost",
        "ControlRateCost",
        "Cost",
        "DiscObstacleCost",
        "GoalCost",
        "GuidanceCost",
        "InformationCost",
        "LagCost",
        "MovingObstacleCost",
        "ObstacleCost",
        "StateCost",
        "WaypointCost",
    ],
    "dynamics": [
        "RK4",
        "Ackermann",
        "Augmented",
        "ContinuousDynamics",
        "DifferentialDrive",
        "Dynamics",
        "Euler",
        "Integrator",
        "KinematicBicycle",
        "Omnidirectional",
        "PathParameter",
        "Pendulum",
        "PointMass",
        "Quadrotor",
        "State",
        "Unicycle",
    ],
    "geometry": ["Path", "Rectangle", "path_through", "race_track", "sin_cos"],
    "information": ["FieldSensor", "PoseInformation", "TrajectoryInformation"],
    "localisation": [],
    "maps": [
        "MovingObstacle",
        "OccupancyGrid",
        "Shapes",
        "TerrainMap",
        "VoxelGrid",
        "World",
        "generate_map",
        "generate_volume",
        "office",
        "start_pose",
        "three_zones",
    ],
    "parameters": ["find_parameter", "get_parameters", "set_parameters"],
    "parts": ["Faults", "MovingObstacles", "Variation"],
    "planning": [
        "FieldNumbers",
        "Flight",
        "Mission",
        "Portfolio",
        "augmented_mppi",
        "explorer",
        "ground_portfolio",
        "informative_mppi",
        "mpcc",
        "volume_explorer",
    ],
    "recorder": [],
    "report": ["Metrics", "Recording"],
    "sensing": ["Camera", "DepthCamera", "InverseSensorModel", "Lidar", "RingLidar", "Sensor"],
    "simulation": [
        "ExplorationScenario",
        "Fleet",
        "PathScenario",
        "Radio",
        "Run",
        "Scenario",
        "Traffic",
        "VolumeScenario",
        "simulate",
    ],
    "study": ["compare"],
}
"""The packages that are imported when they are used, and the names of each that are flat."""

_PACKAGE_OF = {name: package for package, names in _PACKAGES.items() for name in names}

__all__ = list(_PACKAGE_OF)


def __getattr__(name: str) -> Any:
    """Import a package, or the package of a flat name, when it is first used."""
    if name in _PACKAGES:
        return importlib.import_module(f"jaxplore.{name}")
    if name in _PACKAGE_OF:
        value = getattr(importlib.import_module(f"jaxplore.{_PACKAGE_OF[name]}"), name)
        globals()[name] = value  # found at once from now on
        return value
    raise AttributeError(f"module 'jaxplore' has no attribute {name!r}")


def __dir__() -> list[str]:
    """List what there is, imported or not."""
    return sorted({*globals(), *_PACKAGES, *_PACKAGE_OF})
