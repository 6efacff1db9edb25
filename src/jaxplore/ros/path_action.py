"""nav2's controller server over ROS 2: the action `FollowPath` and what belongs to it.

The rules stand in `jaxplore.onboard.path_server`. What arrives is noted in the thread of the link
and obeyed in the loop of the `ControlNode`, between two commands.
"""

import math
import threading
import time
import uuid
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from jaxplore.dynamics._bounds import bound_of_speed
from jaxplore.onboard.costmap import Costmap
from jaxplore.onboard.drive_clock import Instant
from jaxplore.onboard.following import Following
from jaxplore.onboard.localisation import compose, difference
from jaxplore.onboard.options import Command
from jaxplore.onboard.path_server import (
    CHANGEABLE,
    Ending,
    PathRequest,
    PathServer,
    ServerOptions,
    Status,
    check_option,
)
from jaxplore.onboard.pilot import Pilot
from jaxplore.ros import map_messages, messages
from jaxplore.ros.link import Link
from jaxplore.settings.defaults import arguments
from jaxplore.settings.node import NodeSettings

BOND_SECONDS, BOND_TIMEOUT = 0.25, 4.0
"""Time between two signs of life to nav2's lifecycle manager, and after which one is missed [s]."""


def check_nav2(ros: Any) -> None:
    """Raise a `ValueError` unless the packages of `import_ros` have the actions of nav2."""
    if ros.FollowPath is None:
        raise ValueError(
            "nav2_msgs is not installed, which has the actions of nav2; accepted: a terminal in "
            "which ROS was sourced with it, as after apt install ros-$ROS_DISTRO-nav2-msgs"
        )


class PathAction:
    """Serves `FollowPath` with the pilot of a `ControlNode`, on a managed link.

    `place_of` returns the pose (3,) of a frame in that of the robot's pose, or None. It raises a
    `ValueError` as of `check_nav2`.
    """

    def __init__(
        self,
        link: Link,
        pilot: Pilot,
        settings: NodeSettings,
        place_of: Callable[[str], np.ndarray | None],
    ) -> None:
        ros, given = link.ros, settings.server
        check_nav2(ros)
        assert isinstance(pilot.task, Following)
        self._link, self._pilot, self._settings = link, pilot, given
        self._place_of = place_of
        options = ServerOptions(**arguments(given, ServerOptions))
        robot = pilot.robot
        self.server = PathServer(pilot.task, options, float(robot.deceleration or math.inf))
        self._max_speed = float(bound_of_speed(getattr(robot, "physical", robot)) or math.inf)
        self._lock = threading.Lock()
        self._waiting: list[Callable[[float], list[tuple[object, Ending]] | None]] = []
        self._is_active = False
        self._costmap: tuple[Costmap, Instant] | None = None
        self._end_bond: Callable[[], object] | None = None
        names = vars(options)
        self.parameters = {self._parameter(name): float(names[name]) for name in CHANGEABLE}
        """ROS parameters with nav2's names, and their values."""
        if given.obstacles != "scan":
            link.subscribe(ros.OccupancyGrid, given.costmap_topic, self._take_map, depth=1)
        if ros.SpeedLimit is not None:
            link.subscribe(ros.SpeedLimit, given.speed_limit_topic, self._take_limit)
        self._instance = str(uuid.uuid4())
        self._bond = None if ros.Status is None else link.publisher(ros.Status, "bond")
        link.manage(self._change_state)
        action = ros.rclpy.action
        self._action = action.ActionServer(
            link.node,
            ros.FollowPath,
            given.action,
            execute_callback=self._execute,
            goal_callback=self._answer,
            handle_accepted_callback=self._accept,
            cancel_callback=self._cancel,
        )

    def _parameter(self, name: str) -> str:
        owner = CHANGEABLE[name]
        return f"{getattr(self.server.options, owner)}.{name}" if owner else name

    def change(self, parameters: dict[str, object]) -> None:
        """Change ROS parameters of this; what is wrong is a `ValueError`, and nothing changes."""
        names = {self._parameter(name): name for name in CHANGEABLE}
        values = {
            names[each]: check_option(names[each], value) for each, value in parameters.items()
        }
        self._note(lambda _: self.server.set_options(**values))

    @property
    def has_scans(self) -> bool:
        """Whether obstacles are those of the lidar's scans."""
        return self._settings.obstacles != "costmap"

    # In the thread of the link.

    def _note(self, event: Callable[[float], list[tuple[object, Ending]] | None]) -> None:
        with self._lock:
            self._waiting.append(event)

    def _change_state(self, name: str) -> None:
        self._link.info(f"lifecycle: {name}")
        if name == "activate":
            self._is_active = True
            if self._bond is not None:
                self._end_bond = self._link.repeat(BOND_SECONDS, partial(self._sign, is_alive=True))
        elif self._is_active:
            self._is_active = False
            self._note(lambda now: self.server.stop(now, f"the server was told to {name}"))
            if self._end_bond is not None:
                self._end_bond()
                self._sign(is_alive=False)

    def _sign(self, *, is_alive: bool) -> None:
        """Publish a sign of life, a `bond/msg/Status`."""
        message = self._link.ros.Status()
        messages.fill_time(message.header.stamp, self._link.now())
        message.id, message.instance_id = str(self._link.node.get_name()), self._instance
        message.active = is_alive
        message.heartbeat_timeout, message.heartbeat_period = BOND_TIMEOUT, BOND_SECONDS
        assert self._bond is not None
        self._bond.publish(message)

    def _answer(self, _: Any) -> Any:
        responses = self._link.ros.rclpy.action.GoalResponse
        return responses.ACCEPT if self._is_active else responses.REJECT

    def _accept(self, handle: Any) -> None:
        goal, problem = handle.request, ""
        frame = messages.text_of(goal.path.header.frame_id)
        poses = np.zeros((0, 3))
        try:
            _, poses = map_messages.path_of(goal.path)
        except (ValueError, TypeError, OverflowError) as error:
            problem = " ".join(str(error).split())
        request = PathRequest(
            frame,
            poses,
            goal.controller_id,
            goal.goal_checker_id,
            getattr(goal, "progress_checker_id", ""),
            problem,
        )
        handle.ended = self._link.ros.rclpy.task.Future()
        place = self._place_of(goal.path.header.frame_id)
        self._note(lambda now: self.server.begin(now, handle, request, place))
        handle.execute()

    async def _execute(self, handle: Any) -> Any:
        """Wait for the end of a goal, and return its result."""
        ending = await handle.ended
        result = self._link.ros.FollowPath.Result()
        result.error_code = int(ending.code)
        # Early releases of Jazzy have no text.
        if hasattr(result, "error_msg"):
            result.error_msg = ending.message
        finish = {
            Status.SUCCEEDED: handle.succeed,
            Status.ABORTED: handle.abort,
            Status.CANCELED: handle.canceled,
        }[ending.status]
        finish()
        return result

    def _cancel(self, handle: Any) -> Any:
        self._note(lambda now: self.server.cancel(now, handle))
        return self._link.ros.rclpy.action.CancelResponse.ACCEPT

    def _take_limit(self, message: Any) -> None:
        limit, is_percentage = float(message.speed_limit), bool(message.percentage)
        # What is wrong is told here, and a limit comes into force in the loop.
        limited = partial(
            self.server.limit_speed, limit, self._max_speed, is_percentage=is_percentage
        )
        limited()

    def _take_map(self, message: Any) -> None:
        received, frame = self._link.instant(), messages.text_of(message.header.frame_id)
        values, cell_size = map_messages.cells_of(message)
        corner = messages.pose_of(message.info.origin)
        stamp = messages.time_of(message.header.stamp)
        self._costmap = Costmap.of_cells(values, cell_size, corner, stamp, frame), received

    def problem(self) -> str:
        """Return why the costmap lets the robot stand; empty if it does not."""
        if self._settings.obstacles == "scan":
            return ""
        if self._costmap is None:
            return f"no costmap on {self._link.topic(self._settings.costmap_topic)} yet"
        costmap, received = self._costmap
        assert received.steady is not None
        age = time.monotonic() - received.steady
        if age > self._settings.costmap_max_age:
            return f"the costmap is {age:.1f} s old"
        if self._place_of(costmap.frame) is None:
            return f"no transform from the frame {costmap.frame!r} of the costmap is known"
        return ""

    def see(
        self, scan: messages.LaserScan | None, pose: messages.Odometry | None
    ) -> messages.LaserScan | None:
        """Return what the robot sees with the costmap; None if that must not be used.

        Args:
            scan: what the lidar has measured; None for the costmap alone.
            pose: newest pose.
        """
        if self._settings.obstacles == "scan":
            return scan
        if pose is None or self._costmap is None or self.problem():
            return None
        costmap, sensor = self._costmap[0], self._pilot.sensor
        place, options = self._place_of(costmap.frame), self._pilot.options
        assert place is not None
        here = difference(place, pose.pose)
        if scan is None:
            points = costmap.points(here, sensor.max_range)
            seen = costmap.scan(sensor, here)
            return messages.LaserScan(pose.time, costmap.frame, seen, points, pose.received)
        lidar = compose(here, np.array([options.lidar_x, options.lidar_y, 0.0]))
        points = np.concatenate([scan.points, costmap.points(here, sensor.max_range)])
        return scan._replace(scan=costmap.scan(sensor, lidar, scan.scan), points=points)

    # In the loop.

    @property
    def is_commanding(self) -> bool:
        """Whether commands are those of a goal; others may drive the robot meanwhile."""
        return self.server.is_commanding

    def obey(self, now: float) -> None:
        """Obey what has arrived since the last command."""
        with self._lock:
            events, self._waiting = self._waiting, []
        for event in events:
            self._finish(event(now) or [])

    def settle(self, now: float, command: Command) -> None:
        """Tell clients after a command how their goals go, or how they ended."""
        pilot = self._pilot
        pose, server = pilot.pose, self.server
        judged = now, pose, pilot.motion, command, pilot.stop_code, self.problem()
        self._finish(server.update(*judged))
        handle = server.goal
        if handle is None or pose is None:
            return
        feedback = self._link.ros.FollowPath.Feedback()
        feedback.distance_to_goal = server.distance_to_goal(pose)
        feedback.speed = float(math.hypot(*command.twist[:2]))
        handle.publish_feedback(feedback)

    def _finish(self, endings: list[tuple[object, Ending]]) -> None:
        for handle, ending in endings:
            reason = f": {ending.message}" if ending.message else ""
            self._link.info(f"goal {ending.status}, {ending.code.name}{reason}")
            handle.ended.set_result(ending)  # type: ignore[attr-defined]
            self._link.wake()

    def close(self, now: float) -> None:
        """End the goals that are left, when the node ends."""
        self._is_active = False
        self.server.stop(now, "the server ends")
        self._finish(self.server.end_now())
