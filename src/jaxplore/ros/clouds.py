"""Scans of the plane from `sensor_msgs/PointCloud2`: 3-D lidars and depth cameras, without ROS.

A cloud is not trusted: its sizes are compared before anything is read, and nothing is copied but
the coordinates. Source of the layout: the definitions of `PointCloud2` and `PointField`.
"""

import math
import operator
from typing import Any

import numpy as np

from jaxplore.onboard.scan_points import NUM_POINTS
from jaxplore.ros.messages import LaserScan, Mount, text_of, time_of
from jaxplore.sensing.beam_ends import scan_of_ends
from jaxplore.sensing.beams import Beams
from jaxplore.sensing.cloud_view import CloudView

MOST_CLOUD_POINTS = 500_000
"""Greatest number of points of a cloud; a lidar with 128 rows of 2048 has 262,144."""
MOST_POINT_STEP = 1024
"""Greatest size of a point [bytes]."""
MOST_FIELDS = 64
"""Greatest number of fields of a point."""
MOST_DISTANCE = 1000.0
"""Distance beyond which a coordinate is no measurement [m]."""
NUMBERS = {7: "f4", 8: "f8"}
"""Types of coordinates that are read, by their number in `PointField`: float32 and float64."""
OPTICAL = ("_optical_frame", "_optical")
"""Ends of the names of frames whose axes are those of a camera (REP 103)."""


def cloud_points(message: Any) -> np.ndarray:
    """Return the finite points (3, N) of a `sensor_msgs/PointCloud2` in its frame [m], in float32.

    Points are in the order of rows and columns. Those beyond `MOST_DISTANCE` on an axis are left
    out, as NaN is.

    Raises:
        ValueError: sizes that contradict each other or are above the limits of this module; a
            coordinate that is missing, twice there, outside of its point, an array, or of another
            type than float32 and float64.
    """
    width, height, step, row = (
        _size(message, name) for name in ("width", "height", "point_step", "row_step")
    )
    count = width * height
    if count > MOST_CLOUD_POINTS:
        raise ValueError(
            f"width x height of a cloud is {width} x {height}; accepted: at most "
            f"{MOST_CLOUD_POINTS} points"
        )
    if not 0 < step <= MOST_POINT_STEP:
        raise ValueError(f"point_step of a cloud is {step}; accepted: 1 to {MOST_POINT_STEP} bytes")
    # Drivers of clouds of one row leave it at anything.
    row = width * step if height <= 1 else row
    if row < width * step:
        raise ValueError(
            f"row_step of a cloud is {row}; accepted: at least width x point_step, {width * step}"
        )
    held = memoryview(message.data)
    is_bytes = held.itemsize == 1 and held.ndim == 1 and held.contiguous
    if not is_bytes or held.nbytes != row * height:
        raise ValueError(
            f"data of a cloud is {held.nbytes} bytes; accepted: height x row_step, {row * height}"
        )
    order = ">" if message.is_bigendian else "<"
    read = [_coordinate(message.fields, name, step, order) for name in "xyz"]
    points = np.zeros((3, height, width), np.float32)
    # A signalling NaN is converted to one that is not, and what is too large to infinity.
    with np.errstate(invalid="ignore", over="ignore"):
        for axis, (kind, offset) in enumerate(read if count else ()):
            points[axis] = np.ndarray((height, width), kind, held, offset, (row, step))
    flat: np.ndarray = points.reshape(3, count)
    # NaN fails the comparison.
    is_near = np.logical_and.reduce(np.abs(flat) <= MOST_DISTANCE)
    return flat if is_near.all() else _chosen(flat, is_near)


def _size(message: Any, name: str) -> int:
    value = operator.index(getattr(message, name))
    if value < 0:
        raise ValueError(f"{name} of a cloud is {value}; accepted: a number >= 0")
    return value


def _coordinate(fields: Any, name: str, step: int, order: str) -> tuple[np.dtype[Any], int]:
    """Return the type of a coordinate and its offset in a point [bytes]."""
    if len(fields) > MOST_FIELDS:
        raise ValueError(f"a cloud has {len(fields)} fields; accepted: at most {MOST_FIELDS}")
    found = [each for each in fields if each.name == name]
    if len(found) != 1:
        names = text_of(", ".join(str(each.name) for each in fields)) or "none"
        raise ValueError(f"fields of a cloud are {names}; accepted: x, y and z, each once")
    (field,) = found
    kind, number, offset = map(operator.index, (field.datatype, field.count, field.offset))
    if kind not in NUMBERS or number != 1:
        raise ValueError(
            f"field {name} of a cloud is {number} of the datatype {kind}; accepted: 1 of 7 "
            "(FLOAT32) or 8 (FLOAT64)"
        )
    dtype = np.dtype(order + NUMBERS[kind])
    if not 0 <= offset <= step - dtype.itemsize:
        raise ValueError(
            f"offset of the field {name} of a cloud is {offset}; accepted: 0 to point_step less "
            f"its size, {step - dtype.itemsize}"
        )
    return dtype, offset


def scan_of_cloud(message: Any, sensor: Beams, mount: Mount, view: CloudView) -> LaserScan:
    """Convert a `sensor_msgs/PointCloud2` to a scan of the plane.

    A beam has the nearest point within the band of heights whose direction from the sensor is
    within half a beam spacing. A beam without one is free as far as rays of its direction were
    inside the band: a point of the floor at the distance d below a sensor of height h tells that up
    to

        d (h - least_height) / (h - z),

    where z is the height of the point, and one above the band likewise. That is what a planar lidar
    tells, whose rays have one height as well. All other beams have no measurement: a stereo camera
    has no points of a plain wall. `is_rest_free` takes them for free.

    The points of the scan are the nearest one in the band in each of `NUM_POINTS` directions from
    the centre of the robot.

    Raises:
        ValueError: a malformed message, see `cloud_points`.
    """
    header = message.header
    frame, time = text_of(header.frame_id), time_of(header.stamp)
    points = cloud_points(message)
    is_optical = view.axes == "optical" or (view.axes == "auto" and frame.endswith(OPTICAL))
    if is_optical:
        points = np.stack([points[2], -points[0], -points[1]])
    if view.least_range > 0.0:
        points = _chosen(points, np.square(points).sum(axis=0) >= view.least_range**2)
    roll = view.roll + (math.pi if mount.is_inverted else 0.0)
    turn = _rotation(mount.yaw, view.pitch, roll).astype(np.float32)
    # A product of matrices takes four times as long for so few rows.
    points = np.stack(
        [row[0] * points[0] + row[1] * points[1] + row[2] * points[2] for row in turn]
    )
    # Heights relative to the sensor, as the points are.
    low, high = view.least_height - view.height, view.greatest_height - view.height
    is_low, is_high = points[2] < low, points[2] > high
    is_met = ~(is_low | is_high)
    # A point outside of the band is not at the height of the sensor, which is within it.
    sides = [(side, np.float32(leaves)) for side, leaves in ((is_low, low), (is_high, high))]
    parts = [(_chosen(points, side), leaves) for side, leaves in sides]
    free = np.concatenate([part[:2] * (leaves / part[2]) for part, leaves in parts], axis=1)
    met = _chosen(points[:2], is_met)
    scan = scan_of_ends(sensor, met, free, is_rest_free=view.is_rest_free)
    place = np.array([[mount.x], [mount.y]], np.float32)
    return LaserScan(time, frame, scan, nearest_by_direction(met + place))


def _chosen(points: np.ndarray, is_chosen: np.ndarray) -> np.ndarray:
    """Return the columns of points (D, N) that are chosen (N,); faster than by the mask itself."""
    return np.asarray(points.take(np.flatnonzero(is_chosen), axis=1))


def _rotation(yaw: float, pitch: float, roll: float) -> np.ndarray:
    """Return the matrix (3, 3) that turns by a roll, then a pitch and then a yaw [rad]."""
    cos, sin = math.cos, math.sin
    about_x = np.array([[1, 0, 0], [0, cos(roll), -sin(roll)], [0, sin(roll), cos(roll)]])
    about_y = np.array([[cos(pitch), 0, sin(pitch)], [0, 1, 0], [-sin(pitch), 0, cos(pitch)]])
    about_z = np.array([[cos(yaw), -sin(yaw), 0], [sin(yaw), cos(yaw), 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def nearest_by_direction(points: np.ndarray) -> np.ndarray:
    """Return of points (2, N) the nearest one (K, 2) in each of `NUM_POINTS` directions [m].

    The check of a command looks at no others, and a cloud has too many for the loop.
    """
    x, y = points
    distance = np.sqrt(x * x + y * y)
    sector = np.floor((np.arctan2(y, x) / math.tau + 0.5) * NUM_POINTS).astype(int) % NUM_POINTS
    nearest = np.full(NUM_POINTS, np.inf, distance.dtype)
    np.minimum.at(nearest, sector, distance)
    return np.asarray(_chosen(points, distance == nearest[sector]).T, np.float64)
