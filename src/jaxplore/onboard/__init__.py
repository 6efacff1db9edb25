"""The loop on a real robot: from scans and odometry to checked commands, without any middleware."""

from jaxplore.onboard.following import Following as Following
from jaxplore.onboard.goals import GoalChooser as GoalChooser
from jaxplore.onboard.identification import Drive as Drive
from jaxplore.onboard.identification import Identified as Identified
from jaxplore.onboard.identification import identify_motors as identify_motors
from jaxplore.onboard.motors import Motors as Motors
from jaxplore.onboard.options import Command as Command
from jaxplore.onboard.options import Mode as Mode
from jaxplore.onboard.options import PilotOptions as PilotOptions
from jaxplore.onboard.pilot import Pilot as Pilot
from jaxplore.onboard.simulated_robot import SimulatedRobot as SimulatedRobot
from jaxplore.onboard.tasks import DriveTask as DriveTask
from jaxplore.onboard.tasks import Exploring as Exploring
