"""A simulated robot and the node that drives it, over real DDS; prints what was seen as JSON.

Run by test_field.py in a process of its own, because ROS keeps threads and state in a process.
"""

import json
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import rclpy
from follower import Follower
from geometry_msgs.msg import Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from nav_msgs.msg import Path as RosPath
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String

PATIENCE = 300.0
"""Longest time that anything may take on a busy machine [s]."""


class Watcher:
    """Keeps what the robot and the node publish."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = rclpy.create_node("watcher")
        self.robot, self.driver, self.reasons = {}, {}, []
        self.speeds, self.commands, self.plans, self.maps = [], [], [], []
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for kind, topic, take, quality in (
            (String, "/jaxplore_robot/state", self._robot, 5),
            (String, "/jaxplore/state", self._driver, 5),
            (Odometry, "/odom", self._odometry, 5),
            (Twist, "/cmd_vel", self.commands.append, 5),
            (RosPath, "/jaxplore/plan", self.plans.append, 5),
            (OccupancyGrid, "/jaxplore/belief", self.maps.append, kept),
        ):
            self.node.create_subscription(kind, topic, take, quality)
        self.orders = self.node.create_publisher(String, "/jaxplore/command", 5)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        threading.Thread(target=self.executor.spin, daemon=True).start()

    def _robot(self, message: String) -> None:
        self.robot = json.loads(message.data)

    def _driver(self, message: String) -> None:
        self.driver = json.loads(message.data)
        # A reason may last for one control period.
        self.reasons.append(self.driver["reason"])

    def _odometry(self, message: Odometry) -> None:
        self.speeds.append(abs(message.twist.twist.linear.x))

    def order(self, text: str) -> None:
        message = String()
        message.data = text
        self.orders.publish(message)

    def wait(self, what: str, is_so) -> None:
        began = time.monotonic()
        while not is_so():
            if time.monotonic() - began > PATIENCE:
                raise TimeoutError(f"{what}: robot {self.robot}, node {self.driver}")
            time.sleep(0.05)


class SimulatedTime:
    """Publishes a clock that a test may set and stop, and lets nodes use it."""

    def __init__(self, watcher: Watcher, nodes: tuple[str, ...]) -> None:
        self.node, self.time, self.rate = watcher.node, 100.0, 1.0
        self._clock = self.node.create_publisher(Clock, "/clock", 5)
        threading.Thread(target=self._publish, daemon=True).start()
        value = Parameter("use_sim_time", value=True).to_parameter_msg()
        for each in nodes:
            client = self.node.create_client(SetParameters, f"{each}/set_parameters")
            watcher.wait(f"{each} has parameters", client.service_is_ready)
            found = client.call_async(SetParameters.Request(parameters=[value]))
            watcher.wait(f"{each} takes the time", found.done)

    def _publish(self) -> None:
        last = time.monotonic()
        while True:
            time.sleep(0.01)
            now = time.monotonic()
            self.time += self.rate * (now - last)
            last, message = now, Clock()
            message.clock.sec = int(self.time)
            message.clock.nanosec = int(1e9 * (self.time % 1.0))
            self._clock.publish(message)


def command(name: str, *arguments: str) -> subprocess.Popen:
    line = [sys.executable, "-m", "jaxplore", name, *arguments]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


def main(folder: Path) -> dict:
    office = ["--set", "office.width=26", "--set", "office.height=18", "--beams", "60"]
    node = [
        "--no-animation",
        *("--set", "controller.num_samples=64", "--set", "node.map_size=30"),
        *("--set", "lidar.num_beams=60", "--set", "rates.control=20", "--set", "rates.sensing=10"),
        *("--set", "node.max_age=2", "--set", "node.max_frozen=5", "--set", "node.latency=0.1"),
    ]
    robot = command(
        "robot",
        "office",
        *office,
        "--out",
        str(folder / "robot"),
        "--time-limit",
        "600",
        "--no-animation",
    )
    seen, drivers = {}, []
    try:
        watcher = Watcher()
        watcher.wait("the robot is there", lambda: watcher.robot)
        drivers.append(command("node", *node, "--out", str(folder / "first")))
        watcher.wait("the robot drives", lambda: watcher.speeds and watcher.speeds[-1] > 0.2)
        # A second node refuses.
        second = command("node", *node, "--out", str(folder / "second"))
        text, _ = second.communicate(timeout=PATIENCE)
        seen["second"] = [second.returncode, text.strip().splitlines()[-1]]
        # Without the node the robot's own watchdog stops it.
        watcher.wait("the robot drives", lambda: watcher.speeds[-1] > 0.2)
        drivers[0].kill()
        drivers[0].wait()
        watcher.wait("the watchdog stops it", lambda: watcher.robot["watchdog_stops"] > 0)
        watcher.wait("the robot stands", lambda: max(watcher.speeds[-5:]) == 0.0)
        # Another node goes on.
        drivers.append(command("node", *node, "--out", str(folder / "drive")))
        watcher.wait("the robot drives again", lambda: watcher.speeds[-1] > 0.2)
        watcher.wait("the map is published", lambda: watcher.maps and watcher.plans)
        grown = watcher.robot["coverage"] + 0.02
        watcher.wait("the map grows", lambda: watcher.robot["coverage"] > grown)
        watcher.order("dance")
        watcher.order("pause")
        watcher.wait("it pauses", lambda: watcher.driver.get("mode") == "paused")
        watcher.wait("it stands", lambda: max(watcher.speeds[-5:]) == 0.0)
        watcher.order("start")
        watcher.wait("it drives again", lambda: watcher.speeds[-1] > 0.1)
        # Both take the time from a simulator, which begins anew, and then pauses.
        simulated, seen["clock"] = SimulatedTime(watcher, ("/jaxplore", "/jaxplore_robot")), []

        def follow(what: str, reason: str) -> None:
            def found() -> list[str]:
                return [each for each in watcher.reasons if re.match(reason, each)]

            watcher.wait(what, found)
            seen["clock"].append(found()[-1])

        follow("the time is another", "the clock jumped by ")
        watcher.wait("it drives by it", lambda: watcher.speeds[-1] > 0.1)
        simulated.time -= 30.0
        # On a busy machine the time is on its way for a part of a second.
        follow("the clock goes back", r"the clock jumped by -(2[89]|3[01])\.\d s$")
        watcher.wait("it drives on", lambda: watcher.speeds[-1] > 0.1)
        simulated.rate = 0.0
        follow("the clock stands still", "the simulated clock")
        watcher.wait("it stands", lambda: max(watcher.speeds[-5:]) == 0.0)
        simulated.rate = 1.0
        watcher.wait("it drives in the end", lambda: watcher.speeds[-1] > 0.1)
        drivers[1].send_signal(signal.SIGINT)
        text, _ = drivers[1].communicate(timeout=PATIENCE)
        seen["drive"] = [drivers[1].returncode, text]
        last = watcher.commands[-1]
        seen["last_command"] = [last.linear.x, last.linear.y, last.angular.z]
        message = watcher.maps[-1]
        seen["map"] = [message.info.height, message.info.width, sorted(set(message.data))[:2]]
        seen["compiled"] = watcher.driver["compiled"]
        seen["plan"] = len(watcher.plans[-1].poses)
        # Then the node chooses goals, and another program drives there.
        place = ["--set", "node.pose_type=pose", "--set", "node.pose_topic=pose"]
        line = ["node", "--mode", "goal", *node, *place, "--out", str(folder / "goals")]
        drivers.append(command(*line))
        follower, before = Follower(watcher.node), watcher.robot["coverage"]
        watcher.wait("two goals are reached", lambda: follower.num_reached >= 2)
        watcher.wait("the map grows", lambda: watcher.robot["coverage"] > before)
        drivers[2].send_signal(signal.SIGINT)
        text, _ = drivers[2].communicate(timeout=PATIENCE)
        follower.end()
        seen["goals"] = [drivers[2].returncode, text, len(follower.goals)]
        seen["grown"] = watcher.robot["coverage"] - before
        robot.send_signal(signal.SIGINT)
        text, _ = robot.communicate(timeout=PATIENCE)
        seen["robot"] = [robot.returncode, text[-2000:]]
        seen["state"] = watcher.robot
    finally:
        for each in (robot, *drivers):
            each.kill()
    return seen


if __name__ == "__main__":
    print("SEEN " + json.dumps(main(Path(sys.argv[1]))), flush=True)
    # Threads of ROS need not be waited for.
    import os

    os._exit(0)
