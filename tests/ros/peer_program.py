"""Exchange a LaserScan between rclpy and CycloneDDS, a second implementation of DDS.

Run by test_peer.py, once with "rclpy" and once with "cyclone": each publishes a scan until it has
received that of the other, and prints it as JSON.
"""

import json
import os
import struct
import sys
import time

PATIENCE = 60.0
"""Longest time to wait for the other [s]."""
SCANS = {
    "rclpy": [0.1, 1.5, float("inf"), float("nan"), 3.0000002, 1e-38],
    "cyclone": [0.3, float("inf"), 2.5, 0.0, 29.999998],
}
"""Ranges that each side publishes."""


def bits(values) -> str:
    return struct.pack(f"{len(values)}f", *values).hex()


def told(message, frame: str) -> None:
    angles = [message.angle_min, message.angle_increment, message.range_max]
    stamp = [message.header.stamp.sec, message.header.stamp.nanosec]
    seen = {"ranges": bits(message.ranges), "angles": bits(angles), "stamp": stamp, "frame": frame}
    print("SEEN " + json.dumps(seen), flush=True)


def by_rclpy() -> None:
    import rclpy
    from sensor_msgs.msg import LaserScan

    from jaxplore import Lidar
    from jaxplore.ros.messages import laser_scan_of

    rclpy.init()
    node = rclpy.create_node("peer")
    received = []
    node.create_subscription(LaserScan, "/from_cyclone", received.append, 5)
    publisher = node.create_publisher(LaserScan, "/from_rclpy", 5)
    message = LaserScan()
    fill(message)
    message.ranges = SCANS["rclpy"]
    began, seen_at = time.monotonic(), None
    while seen_at is None or time.monotonic() - seen_at < 3.0:
        publisher.publish(message)
        rclpy.spin_once(node, timeout_sec=0.1)
        if received and seen_at is None:
            seen_at = time.monotonic()
            told(received[0], received[0].header.frame_id)
            # The message of the other implementation is one for the conversions.
            scan = laser_scan_of(received[0], Lidar(num_beams=12, max_range=5.0))
            print(f"POINTS {len(scan.points)}", flush=True)
        if time.monotonic() - began > PATIENCE:
            raise TimeoutError("no message from CycloneDDS")


def fill(message) -> None:
    message.header.stamp.sec, message.header.stamp.nanosec = 1795465648, 123456789
    message.header.frame_id = "base_scan"
    message.angle_min, message.angle_max, message.angle_increment = -3.0, 2.0, 0.1
    message.time_increment, message.scan_time = 0.0, 0.1
    message.range_min, message.range_max = 0.05, 30.0


def by_cyclone() -> None:
    from dataclasses import dataclass

    from cyclonedds.core import Policy, Qos
    from cyclonedds.domain import DomainParticipant
    from cyclonedds.idl import IdlStruct
    from cyclonedds.idl.types import float32, int32, sequence, uint32
    from cyclonedds.pub import DataWriter
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic

    @dataclass
    class Time(IdlStruct, typename="builtin_interfaces::msg::dds_::Time_"):
        sec: int32
        nanosec: uint32

    @dataclass
    class Header(IdlStruct, typename="std_msgs::msg::dds_::Header_"):
        stamp: Time
        frame_id: str

    @dataclass
    class LaserScan(IdlStruct, typename="sensor_msgs::msg::dds_::LaserScan_"):
        header: Header
        angle_min: float32
        angle_max: float32
        angle_increment: float32
        time_increment: float32
        scan_time: float32
        range_min: float32
        range_max: float32
        ranges: sequence[float32]
        intensities: sequence[float32]

    participant = DomainParticipant(int(os.environ["ROS_DOMAIN_ID"]))
    quality = Qos(Policy.Reliability.Reliable(max_blocking_time=10**9))
    writer = DataWriter(participant, Topic(participant, "rt/from_cyclone", LaserScan), qos=quality)
    reader = DataReader(participant, Topic(participant, "rt/from_rclpy", LaserScan), qos=quality)
    message = LaserScan(Header(Time(0, 0), ""), *[0.0] * 7, ranges=SCANS["cyclone"], intensities=[])
    fill(message)
    began, seen_at = time.monotonic(), None
    while seen_at is None or time.monotonic() - seen_at < 3.0:
        writer.write(message)
        for found in reader.take(N=5):
            if seen_at is None:
                seen_at = time.monotonic()
                told(found, found.header.frame_id)
        time.sleep(0.1)
        if time.monotonic() - began > PATIENCE:
            raise TimeoutError("no message from rclpy")


if __name__ == "__main__":
    {"rclpy": by_rclpy, "cyclone": by_cyclone}[sys.argv[1]]()

    os._exit(0)
