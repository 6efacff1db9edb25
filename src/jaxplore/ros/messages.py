"""Conversions between ROS 2 messages and jaxplore, without ROS.

The functions read and fill plain objects with the fields of the messages, whatever made them:
rclpy, `rosbags`, CycloneDDS or a test. A malformed message gives a `ValueError` of one line.
Angles and frames are those of REP 103 and REP 105.
"""

import array
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxplore import _checks
from jaxplore.onboard.drive_clock import Instant
from jaxplore.sensing.beams import Beams, Scan
from jaxplore.sensing.lidar import Lidar
from jaxplore.sensing.lidar_errors import NEAR_FLOOR, floor_distance
from jaxplore.sensing.no_echo import NoEcho
from jaxplore.sensing.sweep import Sweep

MOST_READINGS = 100_000
"""Greatest number of readings of a scan."""
MOST_LETTERS = 120
"""Longest text of a message that is repeated."""


class Odometry(NamedTuple):
    """Pose and velocity of a robot.

    Args:
        time: time of the measurement [s].
        frame: name of the frame in which the pose is.
        pose: (3,) pose (x, y, yaw) [m, m, rad].
        twist: (3,) velocity (vx, vy, omega) in the frame of the robot [m/s, m/s, rad/s]; None where
            the message has none.
        received: when it arrived; None where nobody has noted it.
    """

    time: float
    frame: str
    pose: np.ndarray
    twist: np.ndarray | None
    received: Instant | None = None


MOST_SHARE = 1.05
"""Greatest share of a battery's capacity that is taken for a full one."""
LONGEST_SWEEP = 1.0
"""Longest time of a scan that is believed [s]."""


class LaserScan(NamedTuple):
    """A scan of a lidar.

    `time` is that of the first reading [s]. `points` (N, 2) are all valid returns in the frame of
    the robot [m], also of readings that no beam of the sensor has. `received` is when it arrived;
    None where nobody has noted it. `sweep` is when its directions were measured; None where the
    driver does not tell.
    """

    time: float
    frame: str
    scan: Scan
    points: np.ndarray
    received: Instant | None = None
    sweep: Sweep | None = None


def battery_share_of(message: Any) -> float:
    """Return the share of its capacity that is left in a battery, of a `sensor_msgs/BatteryState`.

    It is `percentage`, which is a share from 0 to 1 in ROS, and where that is not measured, NaN,
    `charge` by `capacity` or else by `design_capacity` [Ah]. Another share is a `ValueError`.
    """
    share = float(message.percentage)
    if math.isnan(share):
        wholes = (float(message.capacity), float(message.design_capacity))
        whole = next((each for each in wholes if each > 0.0), math.nan)
        share = float(message.charge) / whole
    # Measured by the voltage it may be a little above 1.
    if not 0.0 <= share <= MOST_SHARE:
        raise ValueError(
            f"percentage of a battery is {share:g}; accepted: a share from 0 to 1, or NaN beside "
            "charge and capacity"
        )
    return min(share, 1.0)


class Mount(NamedTuple):
    """Pose of a lidar on a robot: x ahead of its centre, y to the left [m], and yaw [rad].

    An inverted lidar hangs upside down, so that its angles grow clockwise.
    """

    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    is_inverted: bool = False


def text_of(value: object) -> str:
    """Return a text of a message in printable characters, cut to a length that fits a line."""
    text = "".join(letter if letter.isprintable() else "?" for letter in str(value))
    return text if len(text) <= MOST_LETTERS else f"{text[:MOST_LETTERS]}..."


def time_of(stamp: Any) -> float:
    """Convert a `builtin_interfaces/Time`, which must not be negative, to seconds."""
    seconds, nanoseconds = int(stamp.sec), int(stamp.nanosec)
    if seconds < 0 or not 0 <= nanoseconds < 1_000_000_000:
        raise ValueError(
            f"stamp is {seconds} s and {nanoseconds} ns; accepted: at least 0 s, and 0 to "
            "999999999 ns"
        )
    return seconds + 1e-9 * nanoseconds


def fill_time(stamp: Any, seconds: float) -> None:
    """Fill a `builtin_interfaces/Time` with seconds."""
    whole = math.floor(seconds)
    nanoseconds = round((seconds - whole) * 1e9)
    stamp.sec, stamp.nanosec = whole + nanoseconds // 1_000_000_000, nanoseconds % 1_000_000_000


def yaw_of(quaternion: Any) -> float:
    """Return the yaw of a `geometry_msgs/Quaternion` [rad], in [-pi, pi].

    A norm that is not within 0.1 of 1 raises a `ValueError`.
    """
    x, y, z, w = (float(getattr(quaternion, name)) for name in "xyzw")
    norm = math.sqrt(x * x + y * y + z * z + w * w)
    # NaN fails the comparison.
    if not abs(norm - 1.0) <= 0.1:
        raise ValueError(f"orientation is ({x}, {y}, {z}, {w}); accepted: a unit quaternion")
    # Not scaled to norm 1: only the ratio matters.
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def fill_pose(pose: Any, place: Sequence[float] | np.ndarray) -> None:
    """Fill a `geometry_msgs/Pose` with (x, y, yaw) [m, m, rad]."""
    x, y, yaw = map(float, place)
    pose.position.x, pose.position.y, pose.position.z = x, y, 0.0
    pose.orientation.x = pose.orientation.y = 0.0
    pose.orientation.z, pose.orientation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)


def pose_of(pose: Any) -> np.ndarray:
    """Return the pose (x, y, yaw) of a `geometry_msgs/Pose` [m, m, rad]."""
    x, y = float(pose.position.x), float(pose.position.y)
    if not (math.isfinite(x) and math.isfinite(y)):
        raise ValueError(f"position is ({x}, {y}); accepted: finite numbers")
    return np.array([x, y, yaw_of(pose.orientation)])


def odometry_of(message: Any) -> Odometry:
    """Convert a `nav_msgs/Odometry`, a `PoseWithCovarianceStamped` or a `PoseStamped`."""
    inner = message.pose
    pose = pose_of(inner.pose if hasattr(inner, "pose") else inner)
    twist = twist_of(message.twist.twist) if hasattr(message, "twist") else None
    header = message.header
    return Odometry(time_of(header.stamp), text_of(header.frame_id), pose, twist)


def fill_odometry(message: Any, odometry: Odometry, child_frame: str) -> None:
    """Fill a `nav_msgs/Odometry`; `child_frame` is the robot's frame."""
    fill_header(message.header, odometry.time, odometry.frame)
    message.child_frame_id = child_frame
    fill_pose(message.pose.pose, odometry.pose)
    if odometry.twist is not None:
        fill_twist(message.twist.twist, odometry.twist)


def fill_header(header: Any, seconds: float, frame: str) -> None:
    """Fill a `std_msgs/Header` with a time [s] and the name of a frame."""
    fill_time(header.stamp, seconds)
    header.frame_id = frame


def twist_of(message: Any) -> np.ndarray:
    """Return (vx, vy, omega) of a `geometry_msgs/Twist` [m/s, m/s, rad/s]."""
    given = (message.linear.x, message.linear.y, message.angular.z)
    twist = np.array([float(each) for each in given])
    if not np.isfinite(twist).all():
        raise ValueError(f"twist is {tuple(twist.tolist())}; accepted: finite numbers")
    return twist


def fill_twist(message: Any, twist: Sequence[float] | np.ndarray) -> None:
    """Fill a `geometry_msgs/Twist` with (vx, vy, omega) [m/s, m/s, rad/s]."""
    vx, vy, omega = map(float, twist)
    message.linear.x, message.linear.y, message.linear.z = vx, vy, 0.0
    message.angular.x, message.angular.y, message.angular.z = 0.0, 0.0, omega


def laser_scan_of(
    message: Any, sensor: Beams, mount: Mount | None = None, no_echo: NoEcho | None = None
) -> LaserScan:
    """Convert a `sensor_msgs/LaserScan`.

    The angle of reading k is `angle_min + k angle_increment`; `angle_max`, which drivers round
    differently, is not read, nor are the intensities. `Scan.from_ranges` says what readings mean.
    The lidar's position on the robot, at its centre without a mount, moves the points. The beams of
    the scan start at the lidar, and `Perception.observe` needs the pose of the lidar.

    `no_echo` says which readings met nothing; when absent, `auto` does for this scan alone.
    """
    mount = Mount() if mount is None else mount
    ranges = np.asarray(message.ranges, np.float64)
    if ranges.ndim != 1 or not 0 < ranges.size <= MOST_READINGS:
        raise ValueError(
            f"ranges has shape {ranges.shape}; accepted: (R,) with 1 <= R <= {MOST_READINGS}"
        )
    first = _checks.number("angle_min", float(message.angle_min))
    step = _checks.number("angle_increment", float(message.angle_increment))
    if mount.is_inverted:
        first, step = -first, -step
    least = max(0.0, _checks.number("range_min", float(message.range_min)))
    # Some drivers leave the field at 0.
    most = float(message.range_max) or math.inf
    ranges = (NoEcho() if no_echo is None else no_echo).with_infinite(ranges, most)
    if isinstance(sensor, Lidar) and sensor.errors is not None:
        tilt = sensor.errors
        angles = first + mount.yaw + step * np.arange(ranges.size)
        tilted = float(sensor.height), float(tilt.pitch), float(tilt.roll)
        # A tilted lidar sees the floor there, and what a reading beyond it means is not known.
        is_floor = ranges >= NEAR_FLOOR * floor_distance(angles, *tilted)
        ranges = np.where(is_floor, np.nan, ranges)
    # What is left at the greatest range is a return.
    beyond = math.nextafter(most, math.inf)
    scan = Scan.from_ranges(
        ranges, first + mount.yaw, step, sensor, range_min=least, range_max=beyond
    )
    # NaN fails every comparison.
    is_return = (ranges > 0.0) & (ranges >= least) & (ranges <= most) & np.isfinite(ranges)
    angles = (first + mount.yaw + step * np.arange(ranges.size))[is_return]
    directions = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    points = np.array([mount.x, mount.y]) + ranges[is_return, None] * directions
    header = message.header
    # The time between two readings. Many drivers leave it at 0.
    pause = float(message.time_increment)
    is_told = 0.0 < pause * ranges.size <= LONGEST_SWEEP
    sweep = Sweep(first + mount.yaw, step / pause) if is_told else None
    frame = text_of(header.frame_id)
    return LaserScan(time_of(header.stamp), frame, scan, points, sweep=sweep)


def fill_laser_scan(
    message: Any,
    scan: Scan,
    sensor: Beams,
    seconds: float,
    frame: str,
    *,
    period: float,
    pause: float = 0.0,
) -> None:
    """Fill a `sensor_msgs/LaserScan` with a scan at a time in seconds.

    Beams that met nothing are infinite, and those without a measurement NaN (REP 117). `period` is
    the time between two scans [s]. `pause` is that between two readings [s]; 0 for readings of one
    time.
    """
    fill_header(message.header, seconds, frame)
    angles = sensor.beam_angles.astype(np.float64)
    message.angle_min, message.angle_max = float(angles[0]), float(angles[-1])
    message.angle_increment = float(sensor.beam_spacing)
    message.time_increment, message.scan_time = float(pause), float(period)
    message.range_min, message.range_max = 0.0, float(sensor.max_range)
    given = np.asarray(scan.ranges)
    # A range of 0 is no measurement; another one without a return met nothing.
    ranges = np.where(np.asarray(scan.is_return), given, np.where(given > 0.0, np.inf, np.nan))
    message.ranges = array.array("f", ranges.astype(np.float32).tobytes())


def fill_transform(
    message: Any, seconds: float, parent: str, child: str, place: Sequence[float] | np.ndarray
) -> None:
    """Fill a `geometry_msgs/TransformStamped` with the pose (x, y, yaw) [m, m, rad] of a child."""
    fill_header(message.header, seconds, parent)
    message.child_frame_id = child
    x, y, yaw = map(float, place)
    transform = message.transform
    transform.translation.x, transform.translation.y, transform.translation.z = x, y, 0.0
    transform.rotation.x = transform.rotation.y = 0.0
    transform.rotation.z, transform.rotation.w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
