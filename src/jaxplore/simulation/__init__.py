"""Scenarios, the closed loop that runs them, and environments made of them."""

from jaxplore.robot.localisation import Localisation as Localisation
from jaxplore.simulation.batch import record_runs as record_runs
from jaxplore.simulation.chunks import ChunkedRun as ChunkedRun
from jaxplore.simulation.disturbances import Disturbance as Disturbance
from jaxplore.simulation.disturbances import Place as Place
from jaxplore.simulation.environment.action_modes import ActionMode as ActionMode
from jaxplore.simulation.environment.action_modes import ControlMode as ControlMode
from jaxplore.simulation.environment.action_modes import WaypointMode as WaypointMode
from jaxplore.simulation.environment.environment import Environment as Environment
from jaxplore.simulation.environment.environment import EnvironmentState as EnvironmentState
from jaxplore.simulation.environment.environment import StepResult as StepResult
from jaxplore.simulation.experiment import Experiment as Experiment
from jaxplore.simulation.exploration.moving_discs import MovingDiscs as MovingDiscs
from jaxplore.simulation.exploration.part_truth import PartTruth as PartTruth
from jaxplore.simulation.exploration.scenario import ExplorationScenario as ExplorationScenario
from jaxplore.simulation.fleet.radio import Radio as Radio
from jaxplore.simulation.fleet.scenario import Fleet as Fleet
from jaxplore.simulation.fleet.starts import near_starts as near_starts
from jaxplore.simulation.following.scenario import PathScenario as PathScenario
from jaxplore.simulation.following.traffic import Traffic as Traffic
from jaxplore.simulation.run import Run as Run
from jaxplore.simulation.run import simulate as simulate
from jaxplore.simulation.scenario import AgentView as AgentView
from jaxplore.simulation.scenario import Scenario as Scenario
from jaxplore.simulation.state import Moment as Moment
from jaxplore.simulation.volume.scenario import VolumeScenario as VolumeScenario
