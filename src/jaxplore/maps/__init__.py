"""Maps: occupancy grids, terrain, worlds, map files and generated maps."""

from jaxplore.maps.clearance import clearance_field as clearance_field
from jaxplore.maps.datum import Datum as Datum
from jaxplore.maps.field import ScalarField as ScalarField
from jaxplore.maps.files.path_file import path_datum as path_datum
from jaxplore.maps.files.path_file import read_path as read_path
from jaxplore.maps.files.ros import map_datum as map_datum
from jaxplore.maps.files.volume_file import read_volume as read_volume
from jaxplore.maps.files.volume_file import volume_datum as volume_datum
from jaxplore.maps.generators.generated import generate_map as generate_map
from jaxplore.maps.generators.office import office as office
from jaxplore.maps.generators.office import start_pose as start_pose
from jaxplore.maps.generators.people import walking_people as walking_people
from jaxplore.maps.generators.volumes import generate_volume as generate_volume
from jaxplore.maps.ground import Ground as Ground
from jaxplore.maps.ground import GroundSample as GroundSample
from jaxplore.maps.occupancy_grid import OccupancyGrid as OccupancyGrid
from jaxplore.maps.relative import relative_world as relative_world
from jaxplore.maps.terrain import TerrainMap as TerrainMap
from jaxplore.maps.terrain import TerrainSample as TerrainSample
from jaxplore.maps.union import unite_maps as unite_maps
from jaxplore.maps.voxel_grid import VoxelGrid as VoxelGrid
from jaxplore.maps.world import LabelledObject as LabelledObject
from jaxplore.maps.world import MovingObstacle as MovingObstacle
from jaxplore.maps.world import Shapes as Shapes
from jaxplore.maps.world import World as World
from jaxplore.maps.world import three_zones as three_zones
