"""The true world of an exploration run, from settings: a ROS map, a world file or a scenario."""

from typing import NamedTuple

from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.maps.files.ros import map_datum
from jaxplore.maps.generators.office import office, start_pose
from jaxplore.maps.ground import Ground
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.relative import relative_world
from jaxplore.maps.terrain import TerrainMap
from jaxplore.maps.world import World, is_world_file, three_zones
from jaxplore.parts.capability import Surroundings
from jaxplore.parts.registry import build_parts
from jaxplore.settings.defaults import arguments
from jaxplore.simulation.exploration.reachability import open_spot, with_closed
from jaxplore.tasks.exploration.fleet import has_others
from jaxplore.tasks.exploration.settings import OFFICE, ZONES, Settings
from jaxplore.tasks.robot import build_sensors

ENOUGH = 1.0 - 1e-6
"""Maps finer than this share of the wanted resolution are resampled. Equal ones differ by rounding
only."""


class RunWorld(NamedTuple):
    """The true world of a run, the start and the goal, and the map known in advance.

    All positions are relative to the datum, which is (0, 0) unless the map is far away. The start
    is a pose (x, y, yaw) [m, m, rad], the goal a position (x, y) or (x, y, z) [m]. Nothing is known
    in advance without a `prior`, and the rectangles `zones` [m] are unknown in any case. Terrain is
    level without a `ground`. `source` is the world of which this is made, for parts. Of a robot on
    board nobody knows before its first pose where its coordinates begin: it is not `is_placed`.
    """

    grid: OccupancyGrid
    start: tuple[float, float, float]
    prior: OccupancyGrid | None = None
    goal: tuple[float, ...] | None = None
    zones: tuple[tuple[float, ...], ...] = ()
    ground: Ground | None = None

    source: World | None = None
    datum: Datum = ORIGIN
    is_placed: bool = True


def build_world(settings: Settings, radius: float) -> RunWorld:
    """Build the world of a run. A robot of a radius [m] must fit where the start is chosen."""
    world = _find_world(settings, radius)
    if settings.returns:
        if world.goal is not None or settings.fleet is not None:
            other = "a fleet" if world.goal is None else f"the goal {list(world.goal)}"
            raise ValueError(
                f"returns is true beside {other}; accepted: one robot without a goal, which drives "
                "back to its start"
            )
        world = world._replace(goal=tuple(world.start[:2]))
    return world


def _find_world(settings: Settings, radius: float) -> RunWorld:
    """Build the world of a run with the goal of its settings."""
    if is_ros_map(settings):
        return _on_map(settings, radius)
    # Beside a `world`, the map is only a name.
    if settings.world is not None:
        return _in_world(World.from_dict(settings.world), settings)
    if settings.map == OFFICE:
        grid = office(**arguments(settings.office, office), **arguments(settings, office))
        start = start_pose(grid) if settings.start is None else settings.start
        return RunWorld(grid, start, _prior_of(grid, settings), goal=settings.goal)
    if settings.map == ZONES:
        return _in_world(three_zones(), settings)
    return _in_world(World.from_yaml(settings.map), settings)


def surroundings(settings: Settings, world: RunWorld, radius: float) -> Surroundings:
    """Return what the parts of a robot with a radius [m] are built from."""
    return Surroundings(
        world.datum,
        world.source,
        settings.robot,
        radius,
        world.grid if world.is_placed else None,
        world.ground,
        settings.seed,
        has_others(settings),
        build_sensors(settings),
        world.prior is not None,
    )


def is_ros_map(settings: Settings) -> bool:
    """Check whether a run is on a ROS map, the only kind of map that has no start of its own."""
    if settings.world is not None or settings.map in (OFFICE, ZONES):
        return False
    return not is_world_file(settings.map)


def _in_world(world: World, settings: Settings) -> RunWorld:
    given = settings.terrain
    if given.height_map is not None:
        raise ValueError(
            f"terrain.height_map is {given.height_map!r} beside a world, whose ground are its "
            "hills; accepted: a height map with a ROS map"
        )
    options = arguments(given, Ground)
    datum = Datum.near(*world.origin, name="origin")
    world = relative_world(world, datum)
    return RunWorld(
        world.truth(),
        world.start if settings.start is None else _local_pose(settings.start, datum),
        world.prior(),
        world.goal if settings.goal is None else _local(settings.goal, datum),
        world.zones,
        world.ground(**options),
        world,
        datum,
    )


def _on_map(settings: Settings, radius: float) -> RunWorld:
    """Build the world of a ROS map, with its height map if there is one.

    A start that is not given is the position with the greatest clearance, heading along x.
    """
    given, ground, datum = settings.terrain, None, map_datum(settings.map)
    reading = arguments(settings.map_file, OccupancyGrid.from_ros)
    if given.height_map is None:
        grid = OccupancyGrid.from_ros(settings.map, datum=datum, **reading)
        if grid.resolution < settings.resolution * ENOUGH:
            grid = grid.resample(settings.resolution)
    else:
        options = arguments(given, Ground)
        terrain = TerrainMap.from_ros(
            settings.map,
            given.height_map,
            elevation_scale=given.elevation_scale,
            datum=datum,
            **reading,
            **options,
        )
        if terrain.resolution < settings.resolution * ENOUGH:
            terrain = terrain.resample(settings.resolution)
        grid, ground = terrain.grid, terrain.ground
    goal = None if settings.goal is None else _local(settings.goal, datum)
    start = (0.0, 0.0, 0.0) if settings.start is None else _local_pose(settings.start, datum)
    world = RunWorld(grid, start, _prior_of(grid, settings), goal=goal, ground=ground, datum=datum)
    if settings.start is None:
        spot = _find_start(settings, world, radius)
        return world._replace(start=(*spot, 0.0))
    return world


def _find_start(settings: Settings, world: RunWorld, radius: float) -> tuple[float, float]:
    """Return the position with the greatest clearance from walls, steep ground, and what the parts
    of the robot close."""
    grid = world.grid if world.ground is None else with_closed(world.grid, world.ground)
    for part in build_parts(settings, surroundings(settings, world, radius)).parts:
        closed = part.closed_cells(part.init(world.grid)) if part.closes_cells else None
        if closed is not None:
            grid = grid.with_solid(closed)
    return open_spot(grid, radius)


def _prior_of(grid: OccupancyGrid, settings: Settings) -> OccupancyGrid | None:
    """Return a true map as the robot knows it in advance; None if it does not."""
    return grid if settings.is_map_known else None


def _local(position: tuple[float, ...], datum: Datum) -> tuple[float, ...]:
    return tuple(datum.to_local(position).tolist())


def _local_pose(pose: tuple[float, float, float], datum: Datum) -> tuple[float, float, float]:
    x, y, yaw = _local(pose, datum)
    return x, y, yaw
