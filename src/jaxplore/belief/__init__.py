"""The robot's belief: its map, the fields derived from it, and the obstacles that it tracks."""

from jaxplore.belief.belief import Belief as Belief
from jaxplore.belief.belief import StrategicBelief as StrategicBelief
from jaxplore.belief.car import CarMotion as CarMotion
from jaxplore.belief.certainty import CertaintyField as CertaintyField
from jaxplore.belief.guidance import GuidanceField as GuidanceField
from jaxplore.belief.obstacles import Obstacles as Obstacles
from jaxplore.belief.part import Observation as Observation
from jaxplore.belief.part import Part as Part
from jaxplore.belief.perception import Perception as Perception
from jaxplore.belief.tracks import ObstacleTracker as ObstacleTracker
from jaxplore.belief.tracks import Tracks as Tracks
from jaxplore.belief.volume import VolumePerception as VolumePerception
from jaxplore.belief.volume_belief import VolumeBelief as VolumeBelief
from jaxplore.belief.volume_strategic import VolumeStrategicBelief as VolumeStrategicBelief
from jaxplore.belief.zones import Zones as Zones
from jaxplore.belief.zones import entropy_proxy as entropy_proxy
from jaxplore.belief.zones import unknown_fraction as unknown_fraction
from jaxplore.belief.zones import visible as visible
