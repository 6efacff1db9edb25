"""Conversions of maps, paths and drawn rollouts between ROS 2 messages and jaxplore, without ROS.

As in `jaxplore.ros.messages`.
"""

import array
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxplore import _checks
from jaxplore._types import Vector
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.ros import messages

MOST_CELLS = 64_000_000
"""Greatest number of cells of a map, as of a map that is read from a file."""
MOST_POSES = 100_000
"""Greatest number of poses of a path."""
UNKNOWN = -1
"""Value of an unknown cell of a `nav_msgs/OccupancyGrid`."""


def grid_of(message: Any, offset: np.ndarray | None = None) -> OccupancyGrid:
    """Convert a `nav_msgs/OccupancyGrid`: -1 is a probability of 1/2, and v is v / 100.

    The value 50 becomes the float above 1/2, so that `fill_grid` tells it from -1. The origin of
    the grid is made relative to the position `offset` (2,) [m]: far from the origin, single
    precision has centimetres only.
    """
    values, resolution = cells_of(message)
    # A table is exact, and avoids an array of doubles of the size of the map.
    table = np.append(np.arange(101) / 100.0, 0.5).astype(np.float32)
    table[50] = np.nextafter(table[50], np.float32(1.0))
    # Negative indices count from the end: -1 is the entry of unknown cells.
    probability = table[values]
    origin = messages.pose_of(message.info.origin)
    if offset is not None:
        origin = origin - np.append(offset, 0.0)
    return OccupancyGrid(probability, resolution, origin)


def cells_of(message: Any) -> tuple[np.ndarray, float]:
    """Return the values (H, W) of a `nav_msgs/OccupancyGrid`, and the side of a cell [m]."""
    info = message.info
    rows, columns = int(info.height), int(info.width)
    if not (rows > 0 and columns > 0 and rows * columns <= MOST_CELLS):
        raise ValueError(
            f"map has {rows} rows and {columns} columns; accepted: 1 to {MOST_CELLS} cells"
        )
    values = np.asarray(message.data, np.int16)
    if values.shape != (rows * columns,):
        raise ValueError(
            f"data has shape {values.shape}; accepted: ({rows * columns},), {rows} rows of "
            f"{columns} cells"
        )
    if values.min() < UNKNOWN or values.max() > 100:
        raise ValueError(f"data spans {values.min()} to {values.max()}; accepted: -1, or 0 to 100")
    resolution = _checks.number("resolution", float(info.resolution), above=0.0)
    # The field is in single precision: 0.05 comes as 0.05000000074505806.
    return values.reshape(rows, columns), round(resolution, 7)


def fill_grid(
    message: Any,
    probability: np.ndarray,
    resolution: float,
    origin: Vector,
    seconds: float,
    frame: str,
) -> None:
    """Fill a `nav_msgs/OccupancyGrid`; a probability of exactly 1/2 is unknown.

    The origin is the pose (x, y, yaw) in `frame` [m, m, rad] of the outer corner of cell (0, 0).
    Row 0 of the probabilities (H, W) is there. The resolution is the side of a cell [m].
    """
    messages.fill_header(message.header, seconds, frame)
    messages.fill_time(message.info.map_load_time, seconds)
    message.info.resolution = float(resolution)
    message.info.height, message.info.width = map(int, probability.shape)
    messages.fill_pose(message.info.origin, np.asarray(origin, np.float64))
    values = np.where(probability == 0.5, UNKNOWN, np.round(100.0 * probability))
    message.data = array.array("b", values.astype(np.int8).tobytes())


def path_of(message: Any) -> tuple[str, np.ndarray]:
    """Return the frame and the poses (N, 3) of a `nav_msgs/Path` [m, m, rad]."""
    poses = list(message.poses)
    if len(poses) > MOST_POSES:
        raise ValueError(f"path has {len(poses)} poses; accepted: at most {MOST_POSES}")
    places = [messages.pose_of(each.pose) for each in poses]
    return messages.text_of(message.header.frame_id), np.array(places).reshape(-1, 3)


def fill_path(
    message: Any, make_pose: Callable[[], Any], poses: np.ndarray, seconds: float, frame: str
) -> None:
    """Fill a `nav_msgs/Path` with poses (N, 3) [m, m, rad]; `make_pose` makes a `PoseStamped`."""
    messages.fill_header(message.header, seconds, frame)
    message.poses = [make_pose() for _ in poses]
    for each, pose in zip(message.poses, poses, strict=True):
        messages.fill_header(each.header, seconds, frame)
        messages.fill_pose(each.pose, pose)


LINE_STRIP, ADD = 4, 0
"""Values of `visualization_msgs/Marker`."""
LINE_WIDTH, LIFETIME = 0.015, 0.5
"""Width of the lines of rollouts [m], and time after which they vanish [s]."""


def fill_rollouts(
    message: Any,
    make_marker: Callable[[], Any],
    make_point: Callable[[], Any],
    lines: np.ndarray,
    colours: np.ndarray,
    seconds: float,
    frame: str,
) -> None:
    """Fill a `visualization_msgs/MarkerArray` with lines (N, T, 2) of rollouts [m].

    `colours` (N, 4) are red, green, blue and opacity of each, from 0 to 1. `make_marker` and
    `make_point` are the classes `Marker` and `Point` of ROS.
    """
    message.markers = [make_marker() for _ in lines]
    for index, (each, line, colour) in enumerate(zip(message.markers, lines, colours, strict=True)):
        messages.fill_header(each.header, seconds, frame)
        each.ns, each.id, each.type, each.action = "rollouts", index, LINE_STRIP, ADD
        messages.fill_pose(each.pose, (0.0, 0.0, 0.0))
        each.scale.x = LINE_WIDTH
        each.color.r, each.color.g, each.color.b, each.color.a = map(float, colour)
        messages.fill_time(each.lifetime, LIFETIME)
        each.points = [make_point() for _ in line]
        for point, (x, y) in zip(each.points, line.tolist(), strict=True):
            point.x, point.y, point.z = x, y, 0.0
