"""Valid logs of laser scanners of each kind, and a bag of ROS 1."""

import gzip
from pathlib import Path

import numpy as np

KINDS = ("flaser.log", "robotlaser.log", "rawlaser.log", "scans.gfs", "packed.log.gz")
"""Names of the logs."""


def write_logs(base: Path) -> None:
    """Write three scans of each kind; needs rosbags for the bag."""
    files: dict[str, list[str]] = {name: [] for name in KINDS}
    for step in range(3):
        pose = f"{0.5 * step} 0.1 0.05"
        ranges = "181 " + " ".join(f"{2.0 + 0.01 * beam + step:.2f}" for beam in range(181))
        lidar = f"0 -1.570796 3.141593 0.017453 50.0 0.01 0 {ranges} 0"
        times = f"{step}.5 host {step}.5"
        files["flaser.log"].append(f"FLASER {ranges} {pose} {pose} {times}")
        robot = f"{pose} {pose} 0.1 0 0.3 0.3 1000"
        files["robotlaser.log"].append(f"ROBOTLASER1 {lidar} {robot} {times}")
        files["rawlaser.log"] += [f"ODOM {pose} 0 0 0 {times}", f"RAWLASER1 {lidar} {times}"]
        files["scans.gfs"].append(f"LASER_READING {ranges} {pose} {step}.5")
    files["packed.log.gz"] = files["flaser.log"]
    for name, lines in files.items():
        data = ("PARAM robot_frontlaser_offset 0.1\n" + "\n".join(lines) + "\n").encode()
        (base / name).write_bytes(gzip.compress(data, mtime=0) if "gz" in name else data)
    _write_ros1(base / "drive.bag")


def _write_ros1(path: Path) -> None:
    """Write a bag with two scans and an odometry, packed by bz2."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    of = store.types
    vector, turn = of["geometry_msgs/msg/Vector3"], of["geometry_msgs/msg/Quaternion"]
    still = of["geometry_msgs/msg/Twist"](vector(0.0, 0.0, 0.0), vector(0.0, 0.0, 0.0))
    place = of["geometry_msgs/msg/Pose"](
        of["geometry_msgs/msg/Point"](1.0, 1.0, 0.0), turn(0.0, 0.0, 0.0, 1.0)
    )
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.BZ2)
    with writer:
        for topic, name in (
            ("/scan", "sensor_msgs/msg/LaserScan"),
            ("/odom", "nav_msgs/msg/Odometry"),
        ):
            added = writer.add_connection(topic, name, typestore=store)
            for step in range(2):
                stamp = of["builtin_interfaces/msg/Time"](1000 + step, 0)
                header = of["std_msgs/msg/Header"](step, stamp, "odom")
                if topic == "/scan":
                    rows = np.full(90, 2.0, np.float32)
                    numbers = (-1.5, 1.5, 3.0 / 89.0, 0.0, 0.1, 0.1, 5.0)
                    message = of[name](header, *numbers, rows, rows[:0])
                else:
                    pose = of["geometry_msgs/msg/PoseWithCovariance"](place, np.zeros(36))
                    speed = of["geometry_msgs/msg/TwistWithCovariance"](still, np.zeros(36))
                    message = of[name](header, "base_link", pose, speed)
                data = store.serialize_ros1(message, name)
                writer.write(added, (1000 + step) * 10**9, data)
