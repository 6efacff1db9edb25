"""A simulated robot as a ROS 2 node, at wall-clock time."""

import json
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxplore.onboard.localisation import compose, inverse
from jaxplore.onboard.simulated_robot import RobotMeasurement, SimulatedRobot
from jaxplore.parts.battery.truth import TrueBattery
from jaxplore.ros import map_messages, messages
from jaxplore.ros.command_publisher import COMMAND_TYPES
from jaxplore.ros.link import Link

NODE = "jaxplore_robot"
"""Name of the node."""
SCAN_TOPIC, ODOMETRY_TOPIC, COMMAND_TOPIC = "scan", "odom", "cmd_vel"
MAP_TOPIC, POSE_TOPIC = "map", "pose"
BATTERY_TOPIC = "battery_state"
"""Topics, relative to the namespace of the node; map and pose are those of `slam_toolbox`."""
MAP_FRAME, WORLD_FRAME, ROBOT_FRAME, LIDAR_FRAME = "map", "odom", "base_link", "base_scan"
"""Frames: of the map, in which the true pose is, of the odometry, of the robot and of its lidar."""
MAP_SECONDS, STATE_SECONDS = 1.0, 0.5
"""Time between two messages of the map, and of the state [s]."""
MOST_LATE = 0.2
"""Delay beyond which the simulation does not catch up with the clock [s]."""


class RobotNode:
    """Publishes what a simulated robot measures, and obeys velocity commands.

    As a real robot's base it publishes the transforms from the odometry's frame to the robot's and
    on to the lidar's, where `tf2_msgs` is installed. With a map it also does what a SLAM node does:
    the map is in a frame of its own, in which it publishes the pose, and whose transform to the
    odometry's takes the drift away. `command_type` is one of `COMMAND_TYPES`.
    """

    def __init__(
        self, link: Link, robot: SimulatedRobot, *, command_type: str, has_map: bool
    ) -> None:
        self.link, self.robot = link, robot
        ros = link.ros
        self._sensor = robot.scenario.sensors[0]
        self._scan_period = float(robot.scenario.steps_per_scan) * robot.period
        self._commands: list[np.ndarray] = []
        self._lock = threading.Lock()
        self._scan = link.publisher(ros.LaserScan, SCAN_TOPIC)
        self._odometry = link.publisher(ros.Odometry, ODOMETRY_TOPIC)
        self._map = link.publisher(ros.OccupancyGrid, MAP_TOPIC, is_kept=True) if has_map else None
        self._pose = link.publisher(ros.PoseWithCovarianceStamped, POSE_TOPIC) if has_map else None
        self._state = link.publisher(ros.String, "~/state")
        truths = robot.scenario.truths
        self._battery = next((each for each in truths if isinstance(each, TrueBattery)), None)
        self._charge: Any = None
        if self._battery is not None:
            self._charge = link.publisher(ros.BatteryState, BATTERY_TOPIC)
        self._transforms: Any = None
        if ros.TFMessage is not None:
            self._transforms = link.publisher(ros.TFMessage, "/tf")
            mounts = link.publisher(ros.TFMessage, "/tf_static", is_kept=True)
            mount = np.asarray(robot.mount, np.float64)
            mounts.publish(self._transform(link.now(), (ROBOT_FRAME, LIDAR_FRAME, mount)))
        self._command_type = command_type
        if command_type == "twist":
            link.subscribe(ros.Twist, COMMAND_TOPIC, self._take)
        else:
            link.subscribe(
                ros.TwistStamped, COMMAND_TOPIC, lambda message: self._take(message.twist)
            )
        self.num_late = 0

    def _take(self, message: Any) -> None:
        twist = messages.twist_of(message)
        with self._lock:
            self._commands.append(twist)

    def _transform(self, now: float, *frames: tuple[str, str, np.ndarray]) -> Any:
        """Make a message of transforms, each a parent, a child and the child's pose."""
        ros, name = self.link.ros, self.link.frame
        message = ros.TFMessage()
        message.transforms = [ros.TransformStamped() for _ in frames]
        for each, (parent, child, pose) in zip(message.transforms, frames, strict=True):
            messages.fill_transform(each, now, name(parent), name(child), pose)
        return message

    def check_alone(self) -> None:
        """Wait until other nodes are found; raise a `ValueError` if one of them publishes scans."""
        self.link.wait_for(None)
        others = self.link.other_publishers(SCAN_TOPIC)
        if others:
            raise ValueError(
                f"{self.link.topic(SCAN_TOPIC)} has another publisher, "
                f"{messages.text_of(others[0])}; accepted: one robot, another --namespace, or "
                "another ROS_DOMAIN_ID"
            )

    def run(
        self,
        is_stopped: threading.Event,
        time_limit: float,
        on_progress: Callable[[float, str], None],
    ) -> bool:
        """Simulate at wall-clock time; return whether the run was stopped before its end.

        It ends when the task of the scenario is finished, or at the limit of simulated time [s].
        `on_progress` gets the share of that limit, and a text.
        """
        robot, began = self.robot, time.monotonic()
        next_map = next_state = 0.0
        while robot.time < time_limit and not robot.is_finished:
            if is_stopped.is_set():
                return True
            ahead = began + robot.time - time.monotonic()
            if ahead > 0.0:
                time.sleep(ahead)
            elif ahead < -MOST_LATE:
                # A process that was suspended does not race through what it missed.
                began, self.num_late = began - ahead, self.num_late + 1
            with self._lock:
                commands, self._commands = self._commands, []
            for each in commands[-1:]:
                robot.set_velocity(each)
            robot.frames.add_when_due(robot.time, robot.make_frame)
            now = self.link.now()
            self._publish(robot.step(), now)
            if robot.time >= next_state:
                next_state = robot.time + STATE_SECONDS
                self._publish_state()
                self._publish_battery(now)
                self._warn_of_types()
                on_progress(
                    robot.time / time_limit,
                    f"{robot.time:.0f} s  coverage {robot.coverage:6.1%}  "
                    f"contacts {robot.num_contacts}",
                )
            if self._map is not None and robot.time >= next_map:
                next_map = robot.time + MAP_SECONDS
                self._publish_map(now)
        self._publish_state()
        return False

    def _publish(self, measured: RobotMeasurement, now: float) -> None:
        ros = self.link.ros
        odometry = ros.Odometry()
        frame = self.link.frame
        pose = messages.Odometry(now, frame(WORLD_FRAME), measured.pose, measured.twist)
        messages.fill_odometry(odometry, pose, frame(ROBOT_FRAME))
        self._odometry.publish(odometry)
        if self._pose is not None:
            place = ros.PoseWithCovarianceStamped()
            messages.fill_header(place.header, now, frame(MAP_FRAME))
            messages.fill_pose(place.pose.pose, measured.true_pose)
            self._pose.publish(place)
        if self._transforms is not None:
            frames = [(WORLD_FRAME, ROBOT_FRAME, measured.pose)]
            if self._map is not None:
                drift = compose(measured.true_pose, inverse(measured.pose))
                frames.append((MAP_FRAME, WORLD_FRAME, drift))
            self._transforms.publish(self._transform(now, *frames))
        if measured.scan is not None:
            scan, period = ros.LaserScan(), self._scan_period
            pause = period / self._sensor.num_beams if self.robot.is_turning else 0.0
            taken = measured.scan, self._sensor, now - measured.scan_age, frame(LIDAR_FRAME)
            messages.fill_laser_scan(scan, *taken, period=period, pause=pause)
            self._scan.publish(scan)

    def _warn_of_types(self) -> None:
        """Warn of commands of another type, which do not arrive."""
        wanted = COMMAND_TYPES[self._command_type]
        for found, node in self.link.other_types(COMMAND_TOPIC, is_published=True).items():
            if found != wanted:
                self.link.warn(
                    "type of commands",
                    f"{messages.text_of(node)} publishes {messages.text_of(found)} on "
                    f"{self.link.topic(COMMAND_TOPIC)}, which does not arrive; accepted: {wanted}, "
                    "or another --command-type",
                )

    def _publish_state(self) -> None:
        robot = self.robot
        message = self.link.ros.String()
        message.data = json.dumps(
            {
                "time": round(robot.time, 3),
                "coverage": robot.coverage,
                "contacts": robot.num_contacts,
                "watchdog_stops": robot.watchdog_stops,
                "late": self.num_late,
                "speed": float(np.hypot(*robot.velocity[:2])),
            }
        )
        self._state.publish(message)

    def _publish_battery(self, now: float) -> None:
        """Publish the charge, if the robot has a battery."""
        if self._battery is None:
            return
        energy = self.robot.state.truths[self._battery.name].energy
        message = self.link.ros.BatteryState()
        messages.fill_header(message.header, now, self.link.frame(ROBOT_FRAME))
        message.percentage = float(energy / self._battery.battery.capacity)
        message.present = True
        self._charge.publish(message)

    def _publish_map(self, now: float) -> None:
        assert self._map is not None
        if not self._map.get_subscription_count():
            return
        grid = self.robot.state.belief.grid
        message = self.link.ros.OccupancyGrid()
        map_messages.fill_grid(
            message,
            grid.crop(grid.probability),
            grid.resolution,
            self.robot.scenario.datum.to_map(np.asarray(grid.frame.origin, np.float64)),
            now,
            self.link.frame(MAP_FRAME),
        )
        self._map.publish(message)
