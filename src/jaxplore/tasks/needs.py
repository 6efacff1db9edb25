"""Estimate the memory of a run from its settings, before anything is allocated or compiled.

The estimate is a sum of parts. With H x W cells of the map in arrays (see `choose_padded_shape`), N
nodes of the information field, D directions, B beams of R cells, K rollouts of T steps of nu
controls, S control periods and F frames, in bytes:

    programs    0.65e9                                Python, JAX and the compiled loop
    map         130 H W + 16 pixels of the image      the maps of the world and of the robot
    fields      18 N D + 40 (H + 2 R) (W + 2 R)       information by direction, and its margins
    beams       60 B R + 60 D R                       cells that the beams cross
    controller  8 K T nu + 200 K (1 + M)              of each member, among M obstacles or outcomes
    bank        128 K                                 stored numbers, of each member
    local       20 (N_f D_f + N_l D_l) + 40 (W_f + W_l)    fields around a quadrotor: nodes,
                                                      directions, cells with margins
    volume      60 D H W + 60 d h w                   the voxels of the world, and those of the map
                                                      in its window
    views       64 A N + 24 R                         fields of A headings at N nodes, R rays
    heard       12 M^2 H W                            maps of M robots that M robots have heard
    record      300 S                                 every step, in the file that it is read from
    frames      2 min(F (H W + 4 N), 1e9)             maps for the animation

A fleet needs all parts but the programs once per robot. The factors were measured, see
`docs/limits.md`: a run takes between half and twice the estimate.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from jaxplore._files import read_yaml
from jaxplore.belief.perception_checks import safe_stride
from jaxplore.belief.rolling_map import BLOCK
from jaxplore.belief.volume import COARSE
from jaxplore.belief.volume_lattice import NODE
from jaxplore.maps.files.ros import map_size
from jaxplore.maps.padding import choose_padded_shape
from jaxplore.maps.world import three_zones, world_shape
from jaxplore.settings.controllers import (
    ContouringNumbers,
    ControllerSettings,
    InformativeSettings,
    PortfolioSettings,
)
from jaxplore.settings.node import NodeSettings
from jaxplore.settings.robot import CameraSettings, LidarSettings, RobotSettings
from jaxplore.settings.sections import RunSettings
from jaxplore.simulation.chunks import MAX_FRAMES, MOST_FRAME_BYTES
from jaxplore.tasks.exploration.settings import OFFICE, QUADROTOR, ZONES, Settings
from jaxplore.tasks.exploration.world import ENOUGH, is_ros_map
from jaxplore.tasks.path.settings import PathSettings
from jaxplore.tasks.volume.build import volume_size
from jaxplore.tasks.volume.settings import VolumeSettings

PROGRAMS = 0.65e9
"""Memory of a process with a compiled loop [bytes]."""
_PROGRAMS = "programs"
_CONTROLS = {
    "differential_drive": 2,
    "unicycle": 2,
    "ackermann": 2,
    "bicycle": 2,
    "omnidirectional": 3,
    "quadrotor": 4,
}
"""Number of controls by the model of the robot."""
_MOST_CONTROLS = 6
"""Number of controls of a model of the user's own."""
_BANK = 128.0
"""Memory of a bank of noise by the samples: 16 numbers for each, and a copy."""
_READING = 0.5
"""Share of the memory that reading a file may take."""
_MEMBERS = 4
"""Members of a portfolio whose members are not named."""


class Part(NamedTuple):
    """A part of a run, named in words: its memory [bytes], and the settings with which it grows."""

    name: str
    settings: str
    size: float


class MapSize(NamedTuple):
    """Rows and columns of the map of a run, and the side of a cell [m].

    `pixels` is the number of pixels of its image; 0 without one.
    """

    rows: float
    columns: float
    resolution: float
    pixels: float = 0.0


def needs(
    settings: RunSettings, node: NodeSettings | None = None, *, limit: float = math.inf
) -> tuple[Part, ...]:
    """Return what a run needs, part by part.

    `node` holds the settings of a drive, whose robot makes a map of its own; None for a simulation.
    `limit` is the greatest memory [bytes], half of which reading a file may take.

    Raises:
        ValueError: a map, a world or a volume that cannot be read, or not within the memory.
    """
    if isinstance(settings, Settings):
        parts = _exploration(settings, node)
        number = 1 if settings.fleet is None else settings.fleet.robots
        # Each robot has all of it, and a map of what it has heard of each other one.
        return (
            _programs(),
            *(part._replace(size=number * part.size) for part in parts),
            *_fleet_maps(settings, number),
        )
    if isinstance(settings, VolumeSettings):
        return (_programs(), *_volume(settings, limit))
    assert isinstance(settings, PathSettings)
    return (_programs(), *_path_following(settings))


def check_needs(
    parts: tuple[Part, ...], limit: float, *, num_runs: int = 1, batch: int = 1
) -> None:
    """Check that `num_runs` processes, with `batch` runs each, need at most `limit` bytes.

    Raises:
        ValueError: they need more; one line that names the greatest part and its settings.
    """
    # The runs of a batch share their program.
    sizes = {
        part: num_runs * part.size * (1 if part.name == _PROGRAMS else batch) for part in parts
    }
    total = sum(sizes.values())
    if total <= limit:
        return
    greatest = max(parts, key=lambda part: sizes[part])
    who = "the run needs" if num_runs * batch == 1 else f"{num_runs * batch} runs at a time need"
    raise ValueError(
        f"{who} about {in_gigabytes(total)}, {in_gigabytes(sizes[greatest])} of it for the "
        f"{greatest.name} ({greatest.settings}); the limit is {in_gigabytes(limit)} "
        "(--memory-limit)"
    )


def in_gigabytes(size: float) -> str:
    """Return a memory [bytes] in words, such as `8.2 GB`."""
    return f"{size / 1e9:.3g} GB"


def _programs() -> Part:
    return Part(_PROGRAMS, "every run", PROGRAMS)


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
    yield _record("time_limit, rates.control", steps)
    yield _frames(steps, cells, nodes)


def _frames(steps: float, cells: float, nodes: float) -> Part:
    kept = min(min(MAX_FRAMES, steps + 2.0) * (cells + 4.0 * nodes), MOST_FRAME_BYTES)
    # They are stacked when they are saved.
    return Part("frames", "the cells of the map", 2.0 * kept)


def _controllers(
    settings: Settings, node: NodeSettings | None, resolution: float
) -> Iterator[Part]:
    robot = settings.robot
    if node is not None and node.mode == "follow":
        given = node.contouring
        yield _rollouts("node.contouring", robot, given, progress=1)
    elif settings.architecture == "portfolio":
        chosen = settings.portfolio
        named = chosen.members if chosen.weights is None else chosen.weights
        members = _MEMBERS if named is None else len(named)
        yield _rollouts("portfolio", robot, chosen, members=members)
    elif settings.architecture in QUADROTOR:
        flight = settings.informative
        yield _rollouts("informative", robot, flight)
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
        yield _rollouts("controller", robot, settings.controller)


def _path_following(settings: PathSettings) -> Iterator[Part]:
    given, obstacles = settings.controller, settings.obstacles
    corners = len(obstacles.discs) + sum(map(len, obstacles.polygons))
    outcomes = 1 if given.risk_level is None else given.num_outcomes
    number = obstacles.number + corners
    yield _rollouts("controller", settings.robot, given, progress=1, hindrances=number * outcomes)
    yield _record("time_limit, control_rate", settings.time_limit * settings.control_rate)


def _volume(settings: VolumeSettings, limit: float) -> Iterator[Part]:
    # What a reader finds is held by this process too.
    (depth, height, width), side = volume_size(settings, _READING * limit)
    voxels = float(depth) * height * width
    # Of those outside a window the true world is held, and what is stored of the map.
    share = 1.0
    for extent, size in zip(
        reversed(settings.fields.window or ()), (depth, height, width), strict=False
    ):
        share *= min(1.0, (extent / side + NODE * BLOCK * max(1.0, COARSE / side)) / size)
    yield Part(
        "voxels",
        f"{depth} x {height} x {width} voxels: generated.size, the file, resolution, fields.window",
        60.0 * voxels * (1.0 + share),
    )
    spacing = NODE * max(side, COARSE) / side
    camera, lidar = settings.camera, settings.lidar
    rays = (0 if camera is None else camera.columns * camera.rows) + (
        0 if lidar is None else lidar.columns * lidar.rings
    )
    yield Part(
        "views",
        "fields.num_sectors, camera.columns, camera.rows, resolution",
        64.0 * settings.fields.num_sectors * share * voxels / spacing**3 + 24.0 * rays,
    )
    given = settings.controller
    yield Part(
        "controller",
        "controller.num_samples, controller.horizon",
        8.0 * given.num_samples * given.horizon * _CONTROLS["quadrotor"]
        + 200.0 * given.num_samples,
    )
    yield _record("time_limit, rates.control", settings.time_limit * settings.rates.control)


def _rollouts(
    section: str,
    robot: RobotSettings,
    given: ControllerSettings | PortfolioSettings | InformativeSettings | ContouringNumbers,
    *,
    members: int = 1,
    progress: int = 0,
    hindrances: int = 0,
) -> Part:
    samples, controls = given.num_samples, _CONTROLS.get(robot.model, _MOST_CONTROLS) + progress
    # The scan over time keeps one step of the states, and all steps of the controls.
    each = 8.0 * samples * given.horizon * controls + 200.0 * samples * (1.0 + hindrances)
    if given.noise == "bank":
        each += _BANK * samples
    names = f"{section}.num_samples, {section}.horizon"
    return Part("controller", names if not hindrances else f"{names}, obstacles", members * each)


def _record(names: str, steps: float) -> Part:
    # What is recorded stands in a file. Metrics and figures hold some of its columns at a time.
    return Part("record", names, 300.0 * steps)


def _map_size(settings: Settings) -> MapSize:
    if is_ros_map(settings):
        rows, columns, resolution = map_size(settings.map)
        wanted = settings.resolution
        # Finer maps are resampled.
        share = resolution / wanted if resolution < wanted * ENOUGH else 1.0
        height_map = 0.0 if settings.terrain.height_map is None else rows * columns
        pixels = rows * columns + height_map
        return MapSize(rows * share, columns * share, resolution / share, pixels)
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


def _node_map_size(settings: Settings, node: NodeSettings) -> MapSize:
    cells = node.map_size / settings.resolution
    return MapSize(cells, cells, settings.resolution)


def _of_map(settings: Settings, node: NodeSettings | None) -> str:
    if node is not None:
        return "node.map_size, resolution"
    if is_ros_map(settings):
        return "the image, resolution"
    is_office = settings.world is None and settings.map == OFFICE
    return "office.width, office.height, resolution" if is_office else "size and resolution"


def _pad(side: float) -> float:
    whole = math.ceil(max(side, 1.0))
    return float(choose_padded_shape((whole, whole))[0])
