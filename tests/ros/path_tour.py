"""Measure how a simulated robot is driven through `FollowPath`, as nav2 would.

    PYTHONPATH=TYPES LD_LIBRARY_PATH=TYPES/lib python tests/ros/path_tour.py FOLDER [SECONDS]

with TYPES made by `interfaces.py`. Plans a path on the robot's own map to one place after the
other, and once a second again, as nav2's behaviour tree does. Prints the figures of docs/robot.md.
"""

import json
import math
import os
import signal
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
from controller_program import ACTIVATE, CONFIGURE, PATIENCE, Client, command
from follower import planned_path
from geometry_msgs.msg import Twist
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile
from scipy.ndimage import distance_transform_edt

ROOM = 0.5
"""Least distance of a goal from what is not known to be free [m]."""


class Tour:
    """Drives to random places of the known map."""

    def __init__(self, client: Client) -> None:
        self.client, self.map, self.commands = client, None, []
        self.random = np.random.default_rng(0)
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        client.node.create_subscription(OccupancyGrid, "/map", self.take_map, kept)
        client.node.create_subscription(Twist, "/cmd_vel", self.take_command, 50)

    def take_map(self, message) -> None:
        info = message.info
        grid = np.array(message.data, np.int16).reshape(info.height, info.width)
        self.map = grid, info.resolution, np.array([info.origin.position.x, info.origin.position.y])

    def take_command(self, _) -> None:
        self.commands.append(time.monotonic())

    def choose(self):
        grid, resolution, origin = self.map
        room = distance_transform_edt((grid >= 0) & (grid < 30)) * resolution
        rows, columns = np.nonzero(room > ROOM)
        centres = (np.stack([columns, rows], axis=-1) + 0.5) * resolution + origin
        far = centres[np.hypot(*(centres - self.client.odometry[-1][:2]).T) > 2.0]
        return far[self.random.integers(len(far))]

    def drive(self) -> tuple[int, int, int] | None:
        """Drive to a place; return how it ended, its code, and how often the path was renewed.

        None where no way there is known.
        """
        client, place, yaw = self.client, self.choose(), self.random.uniform(-math.pi, math.pi)
        number, handle = 0, None
        while True:
            path = planned_path(*self.map, client.odometry[-1], place)
            if path is None and handle is None:
                return None
            is_near = math.dist(client.odometry[-1][:2], place) <= 0.5
            if path is not None and (handle is None or not is_near):
                handle, number = client.send(client.goal(path, yaw)), number + 1
                future = handle.get_result_async()
            ends = time.monotonic() + 1.0
            while time.monotonic() < ends:
                if future.done():
                    found = future.result()
                    return found.status, found.result.error_code, number
                time.sleep(0.02)


def main(folder: Path, seconds: float) -> dict:
    robot = ("office", "--delay", "0.04", "--time-limit", "5000", "--no-animation")
    running = [command("robot", *robot, "--out", str(folder / "robot"))]
    served = ("--no-animation", "--set", "node.latency=0.04", "--set", "node.max_age=0.6")
    try:
        client = Client()
        tour = Tour(client)
        client.wait("the robot is there", lambda: client.odometry and tour.map)
        server = command("controller", *served, "--out", str(folder / "server"))
        running.append(server)
        client.transition(CONFIGURE)
        client.transition(ACTIVATE)
        began, ends, renewed = time.monotonic(), [], 0
        while time.monotonic() - began < seconds:
            found = tour.drive()
            if found is not None:
                ends.append(found[:2])
                renewed += found[2]
        client.wait("a state", lambda: client.states)
        state, gaps = client.states[-1], np.diff(tour.commands)
        driven = np.hypot(*np.diff(np.array([each[:2] for each in client.odometry]), axis=0).T)
        server.send_signal(signal.SIGINT)
        server.communicate(timeout=PATIENCE)
    finally:
        for each in running:
            if each.poll() is None:
                each.kill()
    return {
        "goals": len(ends),
        "ends": Counter(map(str, ends)),
        "paths": renewed,
        "metres": float(driven.sum()),
        "seconds": time.monotonic() - began,
        "rate": float(1.0 / np.median(gaps)),
        "gap_p99_ms": float(1e3 * np.percentile(gaps, 99)),
        "contacts": client.robot["contacts"],
        **{name: state[name] for name in ("commands", "late", "replaced", "compiled")},
        **{name: state[f"scan_to_command_ms_{name}"] for name in ("p50", "p99")},
    }


if __name__ == "__main__":
    wanted = float(sys.argv[2]) if len(sys.argv) > 2 else 180.0
    print(json.dumps(main(Path(sys.argv[1]), wanted), indent=1), flush=True)
    os._exit(0)
