"""A simulated robot as a ROS 2 node, at wall-clock time."""

import json
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxplore.onboard.simulated_robot import RobotMeasurement, SimulatedRobot
from jaxplore.ros import map_messages, messages
from jaxplore.ros.link import Link

NODE = "jaxplore_robot"
"""Name of the node."""
SCAN_TOPIC, ODOMETRY_TOPIC, COMMAND_TOPIC, MAP_TOPIC = "scan", "odom", "cmd_vel", "map"
"""Topics, relative to the namespace of the node."""
WORLD_FRAME, ROBOT_FRAME, LIDAR_FRAME = "odom", "base_link", "base_scan"
MAP_SECONDS, STATE_SECONDS = 1.0, 0.5
"""Time between two messages of the map, and of the state [s]."""
MOST_LATE = 0.2
"""Delay beyond which the simulation does not catch up with the clock [s]."""


class RobotNode:
    """Publishes what a simulated robot measures, and obeys velocity commands.

    Args:
        link: connection to ROS 2.
        robot: the robot.
        command_type: type of the commands, "twist" or "twist_stamped".
        has_map: whether the map of what the lidar has seen is published.
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
        self._state = link.publisher(ros.String, "~/state")
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

    def check_alone(self) -> None:
        """Check that no other robot is there.

        Raises:
            ValueError: the topic of the scans has another publisher.
        """
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

        It ends when the task of the scenario is finished, or at the time limit.

        Args:
            is_stopped: ends the run when it is set.
            time_limit: greatest simulated time [s].
            on_progress: called with the share of the time limit, and a text.
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
        if measured.scan is not None:
            scan = ros.LaserScan()
            messages.fill_laser_scan(
                scan, measured.scan, self._sensor, now, frame(LIDAR_FRAME), period=self._scan_period
            )
            self._scan.publish(scan)

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

    def _publish_map(self, now: float) -> None:
        assert self._map is not None
        if not self._map.get_subscription_count():
            return
        grid = self.robot.state.belief.grid
        message = self.link.ros.OccupancyGrid()
        map_messages.fill_grid(
            message,
            grid.cropped(grid.probability),
            grid.resolution,
            self.robot.scenario.datum.to_map(np.asarray(grid.frame.origin, np.float64)),
            now,
            self.link.frame(WORLD_FRAME),
        )
        self._map.publish(message)
