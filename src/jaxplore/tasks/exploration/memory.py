"""The memory of an exploration run, estimated: see `jaxplore.tasks.memory`."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from jaxplore._files import read_yaml
from jaxplore.belief.perception_checks import safe_stride
from jaxplore.maps.files.ros import map_size
from jaxplore.maps.padding import choose_padded_shape
from jaxplore.maps.world import three_zones, world_shape
from jaxplore.settings.architectures import QUADROTOR
from jaxplore.settings.node import NodeSettings
from jaxplore.settings.robot import CameraSettings, LidarSettings
from jaxplore.simulation.chunks import MAX_FRAMES, MOST_FRAME_BYTES
from jaxplore.tasks.exploration.settings import OFFICE, ZONES, Settings
from jaxplore.tasks.exploration.world import ENOUGH, is_ros_map
from jaxplore.tasks.memory import Part, estimate_programs, estimate_record, estimate_rollouts

_MEMBERS = 4
"""Members of a portfolio whose members are not named."""


class MapSize(NamedTuple):
    """Rows and columns of the map of a run, and the side of a cell [m].

    `pixels` is the number of pixels of its image; 0 without one.
    """

    rows: float
    columns: float
    resolution: float
    pixels: float = 0.0


def estimate_exploration(
    settings: Settings, _: float = math.inf, node: NodeSettings | None = None
) -> tuple[Part, ...]:
    """Estimate the memory of a run, part by part.

    `node` holds the settings of a drive, whose robot makes a map of its own; None for a simulation.
    """
    parts = _exploration(settings, node)
    number = 1 if settings.fleet is None else settings.fleet.robots
    # Each robot has all of it, and a map of what it has heard of each other one.
    return (
        estimate_programs(),
        *(part._replace(size=number * part.size) for part in parts),
        *_fleet_maps(settings, number),
    )


def _fleet_maps(settings: Settings, number: int) -> Iterator[Part]:
    """Yield what the robots of a fleet have heard of one another."""
    if number > 1:
        size = _map_size(settings)
        cells = _pad(size.rows) * _pad(size.columns)
        yield Part("maps that robots have heard", "fleet.robots", 12.0 * number**2 * cells)


def _exploration(settings: Settings, node: NodeSettings | None) -> Iterator[Part]:
    size = _map_size(settings) if node is None else _node_map_size(settings, node)
    # Sides in floating point: the numbers of an absurd map may have hundreds of digits.
    rows, columns = (_pad(side) for side in (size.rows, size.columns))
    cells = rows * columns
    yield Part("map", _of_map(settings, node), 130.0 * cells + 16.0 * size.pixels)

    fields, lidar = settings.fields, settings.lidar
    sensors: list[LidarSettings | CameraSettings] = (
        [lidar] if settings.camera is None else [settings.camera, lidar]
    )
    reach = sensors[0].max_range / size.resolution
    radius = min(settings.robot.radius, 0.5 * settings.robot.width)
    stride = safe_stride(fields.node_spacing, size.resolution, radius)
    nodes = cells / stride**2
    margins = (rows + 2.0 * reach) * (columns + 2.0 * reach)
    yield Part(
        "fields",
        f"{size.rows:.6g} x {size.columns:.6g} cells, resolution, fields.num_directions, "
        "fields.node_spacing, lidar.max_range",
        18.0 * nodes * fields.num_directions + 40.0 * margins,
    )
    rays = sum(each.num_beams * each.max_range / size.resolution for each in sensors)
    yield Part(
        "beams",
        "lidar.num_beams, lidar.max_range, fields.num_directions, resolution",
        60.0 * (rays + fields.num_directions * reach),
    )
    yield from _controllers(settings, node, size.resolution)
    if node is not None:
        yield _frames(math.inf, cells, nodes)
        return
    steps = (settings.time_limit + settings.hover_time) * settings.rates.control
    yield estimate_record("time_limit, rates.control", steps)
    yield _frames(steps, cells, nodes)


def _frames(steps: float, cells: float, nodes: float) -> Part:
    kept = min(min(MAX_FRAMES, steps + 2.0) * (cells + 4.0 * nodes), MOST_FRAME_BYTES)
    # They are stacked when they are saved.
    return Part("frames", "the cells of the map", 2.0 * kept)


def _controllers(
    settings: Settings, node: NodeSettings | None, resolution: float
) -> Iterator[Part]:
    robot = settings.robot
    if node is not None and node.mode in ("follow", "controller"):
        given = node.contouring
        yield estimate_rollouts("node.contouring", robot, given, progress=1)
    elif settings.architecture == "portfolio":
        chosen = settings.portfolio
        named = chosen.members if chosen.weights is None else chosen.weights
        members = _MEMBERS if named is None else len(named)
        yield estimate_rollouts("portfolio", robot, chosen, members=members)
    elif settings.architecture in QUADROTOR:
        flight = settings.informative
        yield estimate_rollouts("informative", robot, flight)
        nodes = (2.0 * flight.field_extent / flight.field_spacing + 1.0) ** 2
        near = (2.0 * flight.local_extent / resolution + 1.0) ** 2
        far, close = (
            (2.0 * (extent + reach) / resolution) ** 2
            for extent, reach in (
                (flight.field_extent, flight.field_range),
                (flight.local_extent, flight.local_range),
            )
        )
        directions = flight.field_beams + flight.field_headings
        yield Part(
            "local fields",
            "informative.field_extent, .field_range, .field_spacing, .field_headings, "
            ".local_extent, .local_range, resolution",
            20.0 * (nodes * directions + near * flight.local_beams) + 40.0 * (far + close),
        )
    else:
        yield estimate_rollouts("controller", robot, settings.controller)


def _map_size(settings: Settings) -> MapSize:
    if is_ros_map(settings):
        has_heights = settings.terrain.height_map is not None
        return _ros_map_size(settings.map, settings.resolution, float(has_heights))
    if settings.world is None and settings.map == OFFICE:
        office, side = settings.office, settings.resolution
        return MapSize(office.height / side, office.width / side, side)
    if settings.world is not None:
        shape, resolution = world_shape(settings.world)
    elif settings.map == ZONES:
        zones = three_zones()
        shape, resolution = zones.shape, zones.resolution
    else:
        shape, resolution = world_shape(read_yaml(Path(settings.map)))
    return MapSize(*shape, resolution)


def _ros_map_size(path: str, wanted: float, num_heights: float) -> MapSize:
    """Return the size of a ROS map at a resolution [m], with images of heights beside it."""
    rows, columns, resolution = map_size(path)
    # Finer maps are resampled.
    share = resolution / wanted if resolution < wanted * ENOUGH else 1.0
    pixels = (1.0 + num_heights) * rows * columns
    return MapSize(rows * share, columns * share, resolution / share, pixels)


def _node_map_size(settings: Settings, node: NodeSettings) -> MapSize:
    if node.map is not None:
        return _ros_map_size(node.map, settings.resolution, 0.0)
    cells = node.map_size / settings.resolution
    return MapSize(cells, cells, settings.resolution)


def _of_map(settings: Settings, node: NodeSettings | None) -> str:
    if node is not None:
        return f"node.map{'_size' if node.map is None else ''}, resolution"
    if is_ros_map(settings):
        return "the image, resolution"
    is_office = settings.world is None and settings.map == OFFICE
    return "office.width, office.height, resolution" if is_office else "size and resolution"


def _pad(side: float) -> float:
    whole = math.ceil(max(side, 1.0))
    return float(choose_padded_shape((whole, whole))[0])
