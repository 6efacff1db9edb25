"""Expected information of beams, scans and trajectories, and fields of it over a whole map."""

from jaxplore.information.beam import beam_information as beam_information
from jaxplore.information.beam import cauchy_schwarz_information as cauchy_schwarz_information
from jaxplore.information.beam import cell_information as cell_information
from jaxplore.information.entropy import EntropyFan as EntropyFan
from jaxplore.information.entropy import pose_table as pose_table
from jaxplore.information.field import InformationField as InformationField
from jaxplore.information.field_sensor import FieldSensor as FieldSensor
from jaxplore.information.gain import IdealSensor as IdealSensor
from jaxplore.information.gain import cell_gains as cell_gains
from jaxplore.information.gain import expected_gain as expected_gain
from jaxplore.information.gain import update_gain as update_gain
from jaxplore.information.heading_field import HeadingField as HeadingField
from jaxplore.information.local_field import LocalFieldSensor as LocalFieldSensor
from jaxplore.information.noise import GaussianNoise as GaussianNoise
from jaxplore.information.noise import RangeNoise as RangeNoise
from jaxplore.information.noise import ToeplitzNoise as ToeplitzNoise
from jaxplore.information.noise import UniformNoise as UniformNoise
from jaxplore.information.pose import PoseInformation as PoseInformation
from jaxplore.information.pose import PoseView as PoseView
from jaxplore.information.trajectory import TrajectoryInformation as TrajectoryInformation
from jaxplore.information.trajectory import path_headings as path_headings
