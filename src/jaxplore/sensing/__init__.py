"""Sensors: simulated scans, and map updates from scans."""

from jaxplore.sensing.base import Sensor as Sensor
from jaxplore.sensing.base import Sighting as Sighting
from jaxplore.sensing.beams import Scan as Scan
from jaxplore.sensing.camera import Camera as Camera
from jaxplore.sensing.detector import Detections as Detections
from jaxplore.sensing.detector import Detector as Detector
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel as InverseSensorModel
from jaxplore.sensing.laser_log import LaserLog as LaserLog
from jaxplore.sensing.laser_log import read_laser_log as read_laser_log
from jaxplore.sensing.lidar import Lidar as Lidar
from jaxplore.sensing.lidar_errors import LidarErrors as LidarErrors
from jaxplore.sensing.mount import LidarMount as LidarMount
from jaxplore.sensing.volume import DepthCamera as DepthCamera
from jaxplore.sensing.volume import RingLidar as RingLidar
from jaxplore.sensing.volume import VolumeScan as VolumeScan
from jaxplore.sensing.volume import VolumeSensor as VolumeSensor
