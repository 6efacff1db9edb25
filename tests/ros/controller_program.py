"""An action client drives a simulated robot through `FollowPath`; prints what was seen as JSON.

Run by test_controller.py in a process of its own. The robot and the controller server are processes
as well; this one plays nav2's lifecycle manager, behaviour tree, costmap and speed filter.
"""

import array
import json
import math
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import rclpy
from bond.msg import Status
from geometry_msgs.msg import PoseStamped
from lifecycle_msgs.srv import ChangeState, GetState
from nav2_msgs.action import FollowPath
from nav2_msgs.msg import SpeedLimit
from nav_msgs.msg import OccupancyGrid, Odometry
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.action import ActionClient
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_msgs.msg import String

PATIENCE = 300.0
"""Longest time that anything may take on a busy machine [s]."""
SERVER = "/controller_server"
CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = 1, 2, 3, 4


class Client:
    """Plays nav2."""

    def __init__(self) -> None:
        rclpy.init()
        self.node = rclpy.create_node("nav2")
        self.odometry, self.states, self.bonds, self.feedback = [], [], [], []
        self.robot, self.seen_costmap = {}, None
        node = self.node
        node.create_subscription(Odometry, "/odom", self._odometry, 5)
        node.create_subscription(String, f"{SERVER}/state", self._state, 50)
        node.create_subscription(String, "/jaxplore_robot/state", self._robot, 5)
        node.create_subscription(Status, "/bond", self.bonds.append, 50)
        self.limits = node.create_publisher(SpeedLimit, "/speed_limit", 5)
        self.costmaps = node.create_publisher(OccupancyGrid, "/local_costmap/costmap", 5)
        self.action = ActionClient(node, FollowPath, "/follow_path")
        self.change = node.create_client(ChangeState, f"{SERVER}/change_state")
        self.told = node.create_client(GetState, f"{SERVER}/get_state")
        self.parameters = node.create_client(SetParameters, f"{SERVER}/set_parameters")
        self.values = node.create_client(GetParameters, f"{SERVER}/get_parameters")
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        threading.Thread(target=executor.spin, daemon=True).start()

    def _odometry(self, message) -> None:
        turn, place = message.pose.pose.orientation, message.pose.pose.position
        yaw = 2.0 * math.atan2(turn.z, turn.w)
        twist = message.twist.twist
        self.odometry.append((place.x, place.y, yaw, twist.linear.x, twist.angular.z))

    def _state(self, message) -> None:
        self.states.append(json.loads(message.data))

    def _robot(self, message) -> None:
        self.robot = json.loads(message.data)

    def wait(self, what, is_so):
        began = time.monotonic()
        while not is_so():
            if time.monotonic() - began > PATIENCE:
                raise TimeoutError(f"{what}: {self.states[-1:]}, {self.odometry[-1:]}")
            time.sleep(0.02)

    def call(self, client, request):
        self.wait(f"{client.srv_name} is there", client.service_is_ready)
        future = client.call_async(request)
        self.wait(client.srv_name, future.done)
        return future.result()

    def transition(self, number) -> bool:
        request = ChangeState.Request()
        request.transition.id = number
        return self.call(self.change, request).success

    def send(self, goal):
        """Send a goal; return its handle, or None if it was rejected."""
        self.wait("the action is there", self.action.server_is_ready)
        future = self.action.send_goal_async(goal, feedback_callback=self._feedback)
        self.wait("an answer", future.done)
        return future.result() if future.result().accepted else None

    def _feedback(self, message) -> None:
        self.feedback.append((message.feedback.distance_to_goal, message.feedback.speed))

    def end(self, handle) -> dict:
        """Return how a goal ended, and how fast the robot was then."""
        future = handle.get_result_async()
        self.wait("a result", future.done)
        found = future.result()
        speed = abs(self.odometry[-1][3]), abs(self.odometry[-1][4])
        result = found.result
        return {
            "status": found.status,
            "code": result.error_code,
            "text": result.error_msg,
            "speed": speed,
            "pose": self.odometry[-1][:3],
        }

    def line(
        self, length, *, turn=0.0, yaw=0.0, frame="odom", number=20, **names
    ) -> FollowPath.Goal:
        """Return a goal along a line from the robot, whose end has a heading; both from its own."""
        x, y, heading = self.odometry[-1][:3]
        along = np.linspace(0.0, length, number)
        ahead = heading + turn
        points = np.stack([x + along * math.cos(ahead), y + along * math.sin(ahead)], axis=-1)
        return self.goal(points, ahead + yaw, frame=frame, **names)

    def goal(self, points, yaw, *, frame="odom", **names):
        goal = FollowPath.Goal(**names)
        goal.path.header.frame_id = frame
        for point in points:
            pose = PoseStamped()
            pose.pose.position.x, pose.pose.position.y = map(float, point)
            pose.pose.orientation.z, pose.pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
            goal.path.poses.append(pose)
        return goal

    def set(self, **values) -> list[str]:
        """Set parameters; return the reasons against it."""
        given = [
            Parameter(name.replace("__", "."), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
        done = self.call(self.parameters, SetParameters.Request(parameters=given))
        return [each.reason for each in done.results if not each.successful]

    def limit(self, value, *, percentage=False) -> None:
        self.limits.publish(SpeedLimit(speed_limit=float(value), percentage=percentage))

    def publish_wall(self, distance) -> None:
        """Publish a costmap of 4 m, with a wall ahead of where the robot is now; forever."""
        x, y, yaw = self.odometry[-1][:3]
        cells = np.zeros((80, 80), np.int8)
        centres = (np.arange(80) + 0.5) * 0.05 - 2.0
        across = centres[None] * math.cos(yaw) + centres[:, None] * math.sin(yaw)
        if distance is not None:
            cells[np.abs(across - distance) < 0.05] = 100
        message = OccupancyGrid()
        message.header.frame_id = "odom"
        message.info.resolution, message.info.width, message.info.height = 0.05, 80, 80
        message.info.origin.position.x, message.info.origin.position.y = x - 2.0, y - 2.0
        message.info.origin.orientation.w = 1.0
        message.data = array.array("b", cells.tobytes())
        self.seen_costmap = message
        threading.Thread(target=self._repeat, args=(message,), daemon=True).start()

    def _repeat(self, message) -> None:
        while self.seen_costmap is message:
            message.header.stamp = self.node.get_clock().now().to_msg()
            self.costmaps.publish(message)
            time.sleep(0.2)


def command(name: str, *arguments: str) -> subprocess.Popen:
    line = [sys.executable, "-m", "jaxplore", name, *arguments]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)


SERVED = (
    "--no-animation",
    *("--set", "node.contouring.num_samples=128", "--set", "node.map_size=20"),
    *("--set", "lidar.num_beams=60", "--set", "rates.control=20", "--set", "rates.sensing=10"),
    *("--set", "node.max_age=2", "--set", "node.max_frozen=5", "--set", "node.latency=0.1"),
    *("--set", "node.server.costmap_max_age=4", "--set", "node.server.failure_tolerance=4"),
)


def by_scans(client: Client, seen: dict) -> None:
    """Everything of the action, with the lidar's scans as obstacles."""
    seen["unconfigured"] = client.call(client.told, GetState.Request()).current_state.label
    seen["configured"] = client.transition(CONFIGURE)
    seen["inactive"] = client.send(client.line(1.0)) is None
    seen["activated"] = client.transition(ACTIVATE)
    client.wait("a sign of life", lambda: client.bonds)
    seen["bond"] = [client.bonds[-1].id, client.bonds[-1].active]
    home = client.odometry[-1][:2]
    first = client.send(client.line(1.5, yaw=1.2))
    seen["reached"] = client.end(first)
    there = seen["reached"]["pose"][:2]
    seen["feedback"] = client.feedback[:]
    seen["commands"] = client.node.count_publishers("/cmd_vel")
    # A goal that replaces another one does not stop the robot.
    heading = client.odometry[-1][2]
    slow = client.send(client.line(2.0, turn=-heading))
    client.wait("it drives", lambda: client.odometry[-1][3] > 0.25)
    newer = client.line(1.5, turn=-heading + 0.2)
    number = len(client.odometry)
    fast = client.send(newer)
    seen["replaced"] = client.end(slow)
    seen["slowest"] = min(each[3] for each in client.odometry[number:])
    client.wait("it drives on", lambda: client.odometry[-1][3] > 0.25)
    cancelling = fast.cancel_goal_async()
    client.wait("an answer", cancelling.done)
    seen["cancelled"] = client.end(fast)
    # Two at once: one of them drives.
    both = [client.send(client.line(0.6, turn=math.pi)) for _ in range(2)]
    seen["both"] = [client.end(each) for each in both]
    refused = {
        "empty": client.goal([], 0.0),
        "frame": client.line(1.0, frame="moon"),
        "nan": client.goal([(math.nan, 0.0), (1.0, 0.0)], 0.0),
        "controller": client.line(1.0, controller_id="DWB"),
        "goal_checker": client.line(1.0, goal_checker_id="sloppy"),
    }
    seen["refused"] = {name: client.end(client.send(goal)) for name, goal in refused.items()}
    # A goal behind a wall: 40 m ahead is outside of the office.
    seen["set"] = client.set(
        progress_checker__movement_time_allowance=3.0,
        progress_checker__required_movement_radius=1.0,
    )
    seen["unset"] = client.set(general_goal_checker__xy_goal_tolerance=-1.0)
    number = len(client.odometry)
    client.limit(50.0, percentage=True)
    time.sleep(0.5)
    wall = client.send(client.line(40.0, number=400))
    seen["wall"] = client.end(wall)
    seen["fastest"] = max(each[3] for each in client.odometry[number:])
    client.limit(0.0)
    client.set(progress_checker__movement_time_allowance=60.0)
    # Back to where it came from: the costmap below shows no wall of the office.
    way = np.linspace(client.odometry[-1][:2], there, 30)
    back = client.goal(way, math.atan2(home[1] - there[1], home[0] - there[0]))
    seen["back"] = client.end(client.send(back))
    driven = client.send(client.line(1.0))
    client.wait("it drives", lambda: client.odometry[-1][3] > 0.1)
    seen["deactivated"] = client.transition(DEACTIVATE)
    seen["stopped"] = client.end(driven)
    client.wait("the bond is broken", lambda: not client.bonds[-1].active)
    seen["cleaned"] = client.transition(CLEANUP)


def by_costmap(client: Client, seen: dict) -> None:
    """A wall that only the costmap shows, and none at all."""
    client.transition(CONFIGURE)
    client.transition(ACTIVATE)
    client.set(progress_checker__movement_time_allowance=10.0)
    seen["no_costmap"] = client.end(client.send(client.line(1.0)))
    start = client.odometry[-1]
    client.publish_wall(0.7)
    seen["virtual_wall"] = client.end(client.send(client.line(1.2)))
    end = client.odometry[-1]
    seen["driven"] = math.dist(start[:2], end[:2])
    client.publish_wall(None)
    seen["open"] = client.end(client.send(client.line(0.5)))
    client.seen_costmap = None


def main(folder: Path) -> dict:
    office = ["--set", "office.width=26", "--set", "office.height=18", "--beams", "60"]
    out = ("--no-animation", "--time-limit", "3000", "--out", str(folder / "robot"))
    running = [command("robot", "office", *office, *out)]
    seen = {}
    try:
        client = Client()
        client.wait("the robot is there", lambda: client.odometry)
        for name, drive, more in (
            ("scan", by_scans, ()),
            ("costmap", by_costmap, ("--set", "node.server.obstacles=costmap")),
        ):
            served = command("controller", *SERVED, *more, "--out", str(folder / name))
            running.append(served)
            drive(client, seen)
            client.wait("the node tells its state", lambda: client.states)
            seen[name] = client.states[-1] | client.robot
            served.send_signal(signal.SIGINT)
            text, _ = served.communicate(timeout=PATIENCE)
            seen[f"{name}_code"], seen[f"{name}_text"] = served.returncode, text[-3000:]
        seen["robot"] = client.robot
    except TimeoutError:
        print(json.dumps(seen))
        raise
    finally:
        for each in running:
            if each.poll() is None:
                each.kill()
                print((each.communicate()[0] or "")[-3000:])
    return seen


if __name__ == "__main__":
    print("SEEN " + json.dumps(main(Path(sys.argv[1]))), flush=True)
    # Threads of ROS need not be waited for.
    os._exit(0)
