"""Two robots and the nodes that drive them in one graph, each pair under a namespace of its own.

Run by test_namespaces.py in a process of its own. The messages are real; robots and pilots keep
what arrives and compute nothing. Prints what each has heard as JSON.
"""

import json
import os
import time
from types import SimpleNamespace

import numpy as np

from jaxplore import Lidar, OccupancyGrid, Softmax
from jaxplore.maps.datum import ORIGIN
from jaxplore.onboard.options import Command, Mode
from jaxplore.onboard.simulated_robot import RobotMeasurement
from jaxplore.ros import control, robot
from jaxplore.ros.link import Link, connect
from jaxplore.ros.messages import odometry_of
from jaxplore.sensing.beams import Scan
from jaxplore.settings.node import NodeSettings

PATIENCE = 60.0
"""Longest time that messages may take on a busy machine [s]."""
NAMES = ("robot1", "fleet/robot2")
TRUE_POSE = np.array([1.0, 2.0, 0.5])
LIDAR = Lidar(num_beams=4, max_range=50.0)


class Pilot:
    """Keeps the ranges, the positions and the frames that a node gives it."""

    def __init__(self) -> None:
        self.sensor, self.controller = LIDAR, Softmax(0.3)
        self.task = SimpleNamespace(perception=SimpleNamespace(resolution=0.1, part=lambda _: None))
        self.ranges, self.positions = set(), set()
        self.correction, self.pose = np.zeros(3), np.zeros(3)
        self.has_map_frame, self.finds_itself = True, False
        self.session, self.lost = None, ""

    def make_frame(self):
        return SimpleNamespace()

    def add_odometry(self, _, pose, twist, received) -> None:
        self.positions.add(float(pose[0]))

    def add_scan(self, _, scan, points, received, sweep=None) -> None:
        self.ranges |= {float(each) for each in np.asarray(scan.ranges)}


def simulated():
    scenario = SimpleNamespace(sensors=(LIDAR,), steps_per_scan=1, datum=ORIGIN, truths=())
    grid = OccupancyGrid(np.full((2, 3), 0.5), 0.1)
    state = SimpleNamespace(belief=SimpleNamespace(grid=grid))
    robot = {"mount": np.zeros(3), "is_turning": False}
    return SimpleNamespace(scenario=scenario, period=0.1, state=state, **robot)


def measured(number: int) -> RobotMeasurement:
    """Return what robot 1 or 2 measures: all ranges 1 m or 2 m, and 10 m or 20 m along x."""
    ranges = np.full(4, number, np.float32)
    scan = Scan(ranges, np.ones(4, bool))
    pose = np.array([10.0 * number, 0.0, 0.0])
    # The odometry has drifted.
    return RobotMeasurement(pose, np.zeros(3), scan, TRUE_POSE)


def main() -> dict:
    seen = {}
    with connect("watcher") as watcher:
        ros = watcher.ros
        stamped, corrections = [], []
        topic = "/fleet/robot2/jaxplore/correction"
        watcher.subscribe(ros.TransformStamped, topic, corrections.append)
        watcher.subscribe(ros.TwistStamped, "/fleet/robot2/cmd_vel", stamped.append)
        maps, poses = [], []
        watcher.subscribe(ros.OccupancyGrid, "/robot1/map", maps.append, is_kept=True)
        watcher.subscribe(ros.PoseWithCovarianceStamped, "/robot1/pose", poses.append)
        robots, drivers = [], []
        for name, kind in zip(NAMES, ("twist", "twist_stamped"), strict=True):
            link = Link(robot.NODE, ros, name)
            robots.append(robot.RobotNode(link, simulated(), command_type=kind, has_map=True))
            settings = NodeSettings(namespace=name, pose="internal")
            link = Link(control.NODE, ros, settings.namespace)
            drivers.append(control.ControlNode(link, Pilot(), settings))
        for each in (*robots, *drivers):
            each.check_alone()
        order = watcher.publisher(ros.String, "/robot1/jaxplore/command")
        began = time.monotonic()
        frames, commands, orders = [set(), set()], [set(), set()], [set(), set()]
        # All publish until all have heard of all that is for them, and then some more.
        ends = began + PATIENCE
        while time.monotonic() < ends:
            message = ros.String()
            message.data = "pause"
            order.publish(message)
            for index, (each, driver) in enumerate(zip(robots, drivers, strict=True)):
                each._publish(measured(index + 1), each.link.now())
                each._publish_map(each.link.now())
                twist = np.array([0.1 * (index + 1), 0.0, 0.0])
                driver._commands.publish(Command(twist, Mode.DRIVING, "", None))
                tree = driver._frame_name, driver._pose_frame
                driver._publisher.publish_transform(each.link.now(), *tree)
            time.sleep(0.1)
            for index, (each, driver) in enumerate(zip(robots, drivers, strict=True)):
                orders[index] |= set(driver._orders)
                driver._orders.clear()
                frames[index] |= {scan.frame for scan in driver._scans}
                frames[index] |= {pose.frame for pose in driver._poses}
                driver._take_messages()
                commands[index] |= {round(float(twist[0]), 6) for twist in each._commands}
            heard = [*frames, *commands, orders[0], stamped, corrections, maps, poses]
            if all(heard) and all(d.pilot.ranges and d.pilot.positions for d in drivers):
                ends = min(ends, time.monotonic() + 1.0)
        seen["frames"] = [sorted(each) for each in frames]
        seen["commands"] = [sorted(each) for each in commands]
        seen["orders"] = [sorted(each) for each in orders]
        seen["ranges"] = [sorted(each.pilot.ranges) for each in drivers]
        seen["positions"] = [sorted(each.pilot.positions) for each in drivers]
        seen["stamped"] = sorted({each.header.frame_id for each in stamped})
        seen["tree"] = [corrections[-1].header.frame_id, corrections[-1].child_frame_id]
        seen["place"] = odometry_of(poses[-1]).pose.tolist()
        seen["map"] = [maps[-1].header.frame_id, poses[-1].header.frame_id]
        seen["types"] = [driver._commands.type for driver in drivers]
        seen["topics"] = [name for name, _ in watcher.node.get_topic_names_and_types()]
        seen["services"] = [name for name, _ in watcher.node.get_service_names_and_types()]
        # A second node of one namespace is refused, beside the one of the other.
        settings = NodeSettings(namespace="/robot1")
        second = control.ControlNode(Link(control.NODE, ros, settings.namespace), Pilot(), settings)
        try:
            second.check_alone()
        except ValueError as error:
            seen["second"] = str(error)
    return seen


if __name__ == "__main__":
    print("SEEN " + json.dumps(main()), flush=True)
    # Threads of ROS need not be waited for.
    os._exit(0)
