"""A robot over ROS 2: the node and a simulated robot in two processes, at wall-clock time."""

import importlib
import importlib.util
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.setting import available_maps
from benchmarks.tables import Rows
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.ros.link import import_ros
from jaxplore.simulation.run import Run

SITES = {"nav2_depot": "nav2_depot/depot.yaml", "levine_lobby": "levine_lobby/levinelobby.yaml"}
"""Maps of the drives, where they are."""
PATIENCE = 120.0
"""Longest time that any process may take to begin [s]."""
DELAY = 0.04
"""Time between a command and its effect on the simulated robot [s]."""
COMMAND = [sys.executable, "-m", "jaxplore"]


class Sizes(NamedTuple):
    """Files of maps by name, options of the node, longest drive [s], duration of the drive along a
    path whose memory is measured [min], and options of the robot of the drives."""

    maps: Mapping[str, str] = available_maps(SITES)
    options: tuple[str, ...] = ()
    drive_seconds: float = 300.0
    minutes: float = 2.0
    robot: tuple[str, ...] = ()


FULL = Sizes()
# The programs of `tests/ros/field_program.py`, which the suite compiles anyway.
SMALL_NODE = (
    *("--set", "controller.num_samples=100", "--set", "node.map_size=30"),
    *("--set", "lidar.num_beams=90", "--set", "rates.control=20", "--set", "rates.sensing=10"),
    *("--set", "node.max_age=2", "--set", "node.max_frozen=5"),
)
SMALL_ROBOT = ("--set", "office.width=26", "--set", "office.height=18", "--beams", "90")
SMOKE = Sizes({"office": "office"}, SMALL_NODE, 1.0, 0.0, SMALL_ROBOT)
TITLES = {
    "drives": "The node with a simulated robot in another process: 1000 rollouts of 40 steps",
    "memory": "Memory of the node while it follows paths",
}


def measure(sizes: Sizes) -> dict[str, Rows]:
    """Return the drives of the node, and its memory; nothing without ROS."""
    if importlib.util.find_spec("rclpy") is None:
        return {"drives": [], "memory": []}
    drives = [_drive(world, name, sizes) for name, world in sizes.maps.items()]
    return {"drives": drives, "memory": _memory(sizes) if sizes.minutes > 0.0 else []}


def _drive(world: str, name: str, sizes: Sizes) -> dict[str, Any]:
    """Explore a map until the node is done."""
    with _field() as (place, watcher, start):
        given = "--delay", str(DELAY), "--time-limit", "600", *sizes.robot
        robot = start("robot", world, *given)
        watcher.wait(lambda: watcher.robot)
        node = start("node", "--set", "node.latency=0.06", *sizes.options)
        watcher.moved_at = None
        began = time.monotonic()
        watcher.wait(lambda: watcher.moved_at is not None)
        first = (watcher.moved_at or began) - began
        deadline = time.monotonic() + sizes.drive_seconds
        while node.poll() is None and robot.poll() is None and time.monotonic() < deadline:
            time.sleep(0.1)
        told = watcher.node
        for each in (robot, node):
            each.send_signal(signal.SIGINT)
            each.wait()
        truth: Any = Run.load(place / "robot").metrics
    return {
        "map": name,
        "coverage": truth.coverage,
        "95 % after s": truth.time_to["95"],
        "contacts": truth.collisions,
        "scan to command p50 ms": told["scan_to_command_ms_p50"],
        "p99 ms": told["scan_to_command_ms_p99"],
        "late %": 100.0 * told["late"] / told["commands"],
        "start to first command s": first,
        "compiled": told["compiled"],
    }


def _memory(sizes: Sizes) -> Rows:
    """Drive around in a hall, and return the memory of the node over time."""
    # Half circles in the middle of an empty hall, one after the other.
    angles = np.linspace(0.0, np.pi, 60)
    half = 2.0 * np.stack([np.sin(angles), 1.0 - np.cos(angles)], axis=-1)
    halves = itertools.cycle((half, np.array([0.0, 4.0]) - half))
    rows = []
    with _field() as (place, watcher, start):
        world = place / "hall.yaml"
        _hall().to_ros(world)
        here = map(str, START)
        # Without a target the robot does not end when the hall is explored.
        endless = ["--set", "target=never", "--time-limit", "100000", "--start", *here]
        start("robot", str(world), "--delay", str(DELAY), *endless)
        watcher.wait(lambda: watcher.robot)
        options = ["--mode", "follow", "--set", "node.latency=0.06", "--set", "node.map_size=20"]
        node = start("node", *options, *sizes.options)
        watcher.wait(lambda: watcher.node)
        began = time.monotonic()
        due = 0.0
        while time.monotonic() - began < 60.0 * sizes.minutes:
            if watcher.node["reason"] in ("no path yet", "at the end of the path"):
                watcher.follow(next(halves))
            time.sleep(1.0)
            if time.monotonic() - began >= due:
                due += 60.0 * sizes.minutes / 6.0
                pages = int(Path(f"/proc/{node.pid}/statm").read_text().split()[1])
                size = pages * os.sysconf("SC_PAGE_SIZE") / 2**20
                rows.append(
                    {
                        "minute": (time.monotonic() - began) / 60.0,
                        "node's memory MiB": size,
                        "commands": watcher.node["commands"],
                        "metres": watcher.metres,
                        "compiled": watcher.node["compiled"],
                    }
                )
    return rows


START = (6.0, 4.0, 0.0)
"""Pose of the robot in the hall [m, m, rad]."""


def _hall() -> OccupancyGrid:
    """Return an empty hall of 12 x 12 m."""
    cells = np.zeros((240, 240), np.float32)
    cells[[0, -1]] = cells[:, [0, -1]] = 1.0
    return OccupancyGrid(cells, 0.05)


class _Watcher:
    """Hears what the robot and the node publish."""

    def __init__(self) -> None:
        self._ros = ros = import_ros()
        importlib.import_module("rclpy.executors")
        self.robot: dict[str, Any] = {}
        self.node: dict[str, Any] = {}
        self.moved_at: float | None = None
        self.metres = 0.0
        self._place: np.ndarray | None = None
        ros.rclpy.init()
        self._own = ros.rclpy.create_node("benchmark")
        for kind, topic, take in (
            (ros.String, "/jaxplore_robot/state", self._take_robot),
            (ros.String, "/jaxplore/state", self._take_node),
            (ros.Twist, "/cmd_vel", self._take_command),
            (ros.Odometry, "/odom", self._take_pose),
        ):
            self._own.create_subscription(kind, topic, take, 5)
        self._paths = self._own.create_publisher(ros.Path, "/plan", 5)
        self._executor = ros.rclpy.executors.SingleThreadedExecutor()
        self._executor.add_node(self._own)
        threading.Thread(target=self._executor.spin, daemon=True).start()

    def _take_robot(self, message: Any) -> None:
        self.robot = json.loads(message.data)

    def _take_node(self, message: Any) -> None:
        self.node = json.loads(message.data)

    def _take_command(self, message: Any) -> None:
        if self.moved_at is None and (message.linear.x or message.angular.z):
            self.moved_at = time.monotonic()

    def _take_pose(self, message: Any) -> None:
        here = np.array([message.pose.pose.position.x, message.pose.pose.position.y])
        if self._place is not None:
            self.metres += float(np.hypot(*(here - self._place)))
        self._place = here

    def follow(self, points: np.ndarray) -> None:
        """Publish a path relative to the robot's start."""
        message = self._ros.Path()
        message.header.frame_id = "odom"
        for x, y in (points + np.array(START[:2])).tolist():
            pose = self._ros.PoseStamped()
            pose.header.frame_id = "odom"
            pose.pose.position.x, pose.pose.position.y = x, y
            pose.pose.orientation.w = 1.0
            message.poses.append(pose)
        self._paths.publish(message)

    def wait(self, is_so: Callable[[], Any]) -> None:
        """Wait until something is so."""
        began = time.monotonic()
        while not is_so():
            if time.monotonic() - began > PATIENCE:
                raise TimeoutError(f"robot {self.robot}, node {self.node}")
            time.sleep(0.02)

    def close(self) -> None:
        """Leave the network."""
        self._executor.shutdown()
        self._own.destroy_node()
        self._ros.rclpy.shutdown()


@contextmanager
def _field() -> Iterator[tuple[Path, _Watcher, Callable[..., subprocess.Popen[bytes]]]]:
    """Yield a folder, a watcher, and a function that starts a command of jaxplore in it."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    started: list[subprocess.Popen[bytes]] = []
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)

        def start(name: str, *arguments: str) -> subprocess.Popen[bytes]:
            line = [*COMMAND, name, *arguments, "--no-animation", "--out", str(place / name)]
            with (place / f"{name}.log").open("wb") as log:
                started.append(subprocess.Popen(line, stdout=log, stderr=subprocess.STDOUT))
            return started[-1]

        watcher = _Watcher()
        try:
            yield place, watcher, start
        finally:
            for each in started:
                each.kill()
                each.wait()
            watcher.close()
