"""Dynamics models of robots, and their integrators."""

from jaxplore.dynamics.ackermann import Ackermann as Ackermann
from jaxplore.dynamics.augmented import Augmented as Augmented
from jaxplore.dynamics.base import ContinuousDynamics as ContinuousDynamics
from jaxplore.dynamics.base import Dynamics as Dynamics
from jaxplore.dynamics.base import State as State
from jaxplore.dynamics.differential_drive import DifferentialDrive as DifferentialDrive
from jaxplore.dynamics.formation import Formation as Formation
from jaxplore.dynamics.goal import Goal as Goal
from jaxplore.dynamics.integrators import RK4 as RK4
from jaxplore.dynamics.integrators import Euler as Euler
from jaxplore.dynamics.integrators import Integrator as Integrator
from jaxplore.dynamics.kinematic_bicycle import KinematicBicycle as KinematicBicycle
from jaxplore.dynamics.omnidirectional import Omnidirectional as Omnidirectional
from jaxplore.dynamics.path_parameter import PathParameter as PathParameter
from jaxplore.dynamics.pendulum import Pendulum as Pendulum
from jaxplore.dynamics.point_mass import PointMass as PointMass
from jaxplore.dynamics.quadrotor import Quadrotor as Quadrotor
from jaxplore.dynamics.uncertain import UncertainRobot as UncertainRobot
from jaxplore.dynamics.unicycle import Unicycle as Unicycle
