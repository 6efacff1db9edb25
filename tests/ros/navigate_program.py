"""Goals are chosen for a stub of nav2's `NavigateToPose`; prints what was seen as JSON.

Run by test_navigate.py in a process of its own. The stub rejects, aborts and cancels goals as it is
told, and else puts a robot there, whose map grows by what it sees from there.
"""

import array
import json
import os
import threading
import time

import numpy as np
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav2_msgs.action import NavigateToPose
from nav_msgs.msg import OccupancyGrid
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.executors import MultiThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile

from jaxplore.ros import goal
from jaxplore.ros.link import connect
from jaxplore.settings.node import NodeSettings
from jaxplore.tasks.exploration.pilot import build_goal_chooser, make_node_settings

PATIENCE = 900.0
"""Longest time that anything may take on a busy machine [s]."""
CELL, SEEN = 0.1, 3.0
"""Side of a cell, and how far the robot sees [m]."""
SCRIPT = ("reject", "abort", "succeed", "cancel", "slow")
"""What happens to the first goals; each one after them succeeds."""


class Stub:
    """A robot of nav2 that is at its goals at once."""

    def __init__(self, wait_for_server) -> None:
        self.node = rclpy.create_node("bt_navigator")
        self.world = np.zeros((60, 140), np.int8)
        self.world[[0, -1]], self.world[:, [0, -1]] = 100, 100
        self.world[:40, 70] = 100
        self.known = np.zeros(self.world.shape, bool)
        self.place, self.asked, self.events = np.array([1.5, 1.5]), [], []
        self.is_hanging, self.script = False, list(SCRIPT)
        self.look()
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.map = self.node.create_publisher(OccupancyGrid, "/map", kept)
        self.pose = self.node.create_publisher(PoseWithCovarianceStamped, "/pose", 5)
        threading.Thread(target=self.publish, daemon=True).start()
        # There is a map, and nav2 is not active yet.
        wait_for_server()
        self.server = ActionServer(
            self.node,
            NavigateToPose,
            "/navigate_to_pose",
            self.drive,
            goal_callback=self.answer,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        executor = MultiThreadedExecutor(4)
        executor.add_node(self.node)
        threading.Thread(target=executor.spin, daemon=True).start()

    def look(self) -> None:
        rows, columns = np.mgrid[: self.world.shape[0], : self.world.shape[1]]
        away = np.hypot((columns + 0.5) * CELL - self.place[0], (rows + 0.5) * CELL - self.place[1])
        # Nobody sees through the wall.
        is_here = ((columns < 70) == (self.place[0] < 7.0)) | (rows >= 40)
        self.known |= (away < SEEN) & is_here

    def publish(self) -> None:
        while True:
            stamp = self.node.get_clock().now().to_msg()
            message = OccupancyGrid()
            message.header.frame_id, message.header.stamp = "map", stamp
            message.info.resolution = CELL
            message.info.height, message.info.width = self.world.shape
            message.info.origin.orientation.w = 1.0
            values = np.where(self.known, self.world, -1).astype(np.int8)
            message.data = array.array("b", values.tobytes())
            self.map.publish(message)
            pose = PoseWithCovarianceStamped()
            pose.header.frame_id, pose.header.stamp = "map", stamp
            pose.pose.pose.position.x, pose.pose.pose.position.y = map(float, self.place)
            pose.pose.pose.orientation.w = 1.0
            self.pose.publish(pose)
            time.sleep(0.1)

    def answer(self, request) -> GoalResponse:
        place = request.pose.pose.position
        assert request.pose.header.frame_id == "map"
        what = self.script.pop(0) if self.script else "succeed"
        self.asked.append((what, place.x, place.y))
        return GoalResponse.REJECT if what == "reject" else GoalResponse.ACCEPT

    def drive(self, handle):
        what, x, y = self.asked[-1]
        result = NavigateToPose.Result()
        if what == "slow":
            # Its node gives up, because its patience ends, and sends another one.
            self.events.append("hangs")
            while not handle.is_cancel_requested and len(self.asked) == len(SCRIPT):
                time.sleep(0.02)
            self.events.append("replaced")
            handle.abort()
        elif what == "abort":
            result.error_code, result.error_msg = 9003, "no way there"
            handle.abort()
        elif what == "cancel":
            began = time.monotonic()
            request = self.node.create_client(
                NavigateToPose.Impl.CancelGoalService, "/navigate_to_pose/_action/cancel_goal"
            )
            request.call_async(NavigateToPose.Impl.CancelGoalService.Request())
            while not handle.is_cancel_requested and time.monotonic() - began < PATIENCE:
                time.sleep(0.02)
            handle.canceled()
        else:
            self.place = np.array([x, y])
            self.look()
            time.sleep(0.3)
            handle.succeed()
        return result


def main() -> dict:
    entries = {
        "node": {"mode": "goal", "pose_type": "pose", "pose_topic": "pose", "goal_by": "action"},
        "lidar": {"max_range": SEEN, "num_beams": 60},
        "resolution": CELL,
        "robot": {"max_speed": 1.0},
    }
    settings, node = make_node_settings(entries)
    assert isinstance(node, NodeSettings)
    chooser = build_goal_chooser(settings)
    chooser._least, goal.CHOICE_SECONDS = 5.0, 0.1
    with connect("jaxplore") as link:
        chosen = goal.GoalNode(link, chooser, node, settings.resolution)
        told, is_stopped = [], threading.Event()
        link.subscribe(
            link.ros.String, "~/state", lambda each: told.append(json.loads(each.data)), depth=50
        )
        reasons: list[str] = []
        thread = threading.Thread(target=lambda: reasons.append(chosen.run(is_stopped)))
        thread.start()
        began = time.monotonic()

        def is_waiting() -> None:
            missing = "no action server /navigate_to_pose"
            while time.monotonic() - began < PATIENCE:
                if any(each["reason"] == missing for each in told):
                    return
                time.sleep(0.05)

        stub = Stub(is_waiting)
        thread.join(PATIENCE)
        seen = {
            "asked": stub.asked,
            "events": stub.events,
            "outcomes": dict(chosen.outcomes),
            "goals": chosen.num_goals,
            "dropped": chooser.num_dropped,
            "reasons": reasons,
            "waited": [each["reason"] for each in told if each["mode"] == "waiting"],
            "known": float(stub.known.mean()),
            "seconds": time.monotonic() - began,
        }
        if thread.is_alive():
            is_stopped.set()
            thread.join()
    return seen


if __name__ == "__main__":
    print("SEEN " + json.dumps(main()), flush=True)
    # Threads of ROS need not be waited for.
    os._exit(0)
