"""The node that drives a robot: scans and poses in, velocity commands out."""

import concurrent.futures
import dataclasses
import math
import threading
import time
from collections import deque
from collections.abc import Sequence
from functools import partial
from typing import Any

import jax
import numpy as np

from jaxplore._files import parse_json
from jaxplore.onboard.drive_clock import STANDSTILL_SECONDS, Instant
from jaxplore.onboard.following import Following
from jaxplore.onboard.log import Rows
from jaxplore.onboard.options import Command, Mode
from jaxplore.onboard.pilot import Pilot
from jaxplore.onboard.session_writer import SessionWriter
from jaxplore.onboard.watch import DriveWatch
from jaxplore.parameters import get_parameters, set_parameters
from jaxplore.parts.battery.robot import Battery
from jaxplore.ros import map_messages, messages
from jaxplore.ros.command_publisher import CommandPublisher
from jaxplore.ros.drive_publisher import DrivePublisher
from jaxplore.ros.further_lidars import FurtherLidars, further_lidars
from jaxplore.ros.inputs import (
    Silence,
    subscribe_battery,
    subscribe_further,
    subscribe_pose,
    subscribe_scan,
)
from jaxplore.ros.link import Link
from jaxplore.ros.messages import Mount
from jaxplore.ros.path_action import PathAction
from jaxplore.ros.transforms import Transforms
from jaxplore.sensing.no_echo import NoEcho
from jaxplore.settings.node import NodeSettings
from jaxplore.simulation.monitor import Monitor

MOST_WAITING = 64
"""Number of changes that wait; the oldest goes first."""
LOOKS = 8
"""Number of looks at a simulated clock in a control period of real time: its rate is not known."""
NODE = "jaxplore"
"""Name of the node."""
COMPILED = "/jax/core/compile/backend_compile_duration"
"""Event of JAX for a program that was compiled, or loaded from the cache."""
ROLLOUT_COLOUR = "rollout_colour"
"""ROS parameter that says what colours the published rollouts, see `DrivePublisher`."""
MOST_STATE = 10_000
"""Greatest length of the state of another node that is read."""
MOST_BRAKING = 5.0
"""Longest time that a node drives on after it was told to stop [s]."""
LEAST_SHARE = 0.25
"""Share of the control period that is the least time between two commands."""
INITIAL_POSE_TOPIC = "initialpose"
"""Topic of a pose that somebody tells a robot that finds itself, as RViz and AMCL have it."""
ORDERS = ("start", "explore", "pause", "return", "save", "stop")
"""Orders that the node takes."""


class Changes:
    """Keeps the commands whose mode or kind of reason is not that of the command before.

    A reason may last for one control period, and the thread that tells it may be busy for longer:
    what is only read now and then says nothing of it. Commands come from one thread, and another
    one takes the changes.
    """

    def __init__(self) -> None:
        self._waiting: deque[Command] = deque(maxlen=MOST_WAITING)
        self._last: tuple[str, str] | None = None

    def add(self, command: Command) -> None:
        """Keep a command if it is a change."""
        kind = kind_of(command)
        if kind != self._last:
            self._last = kind
            self._waiting.append(command)

    def take(self) -> list[Command]:
        """Return the changes since the last call, the oldest first."""
        return [self._waiting.popleft() for _ in range(len(self._waiting))]


def kind_of(command: Command) -> tuple[str, str]:
    """Return the mode, and what the reason begins with: the rest has numbers that change."""
    return str(command.mode), command.reason[:12]


class Pace:
    """Says when a command is due: a part of the control period [s] after the last one.

    With a simulated clock the period is simulated time, and real time while it stands still.
    """

    def __init__(self, period: float) -> None:
        self._period = period
        self._last: Instant | None = None
        self._moved: Instant | None = None

    def begin(self, now: Instant) -> None:
        """Note a command."""
        self._last = now

    def is_due(self, share: float, now: Instant) -> bool:
        """Check whether a share of the control period has passed since the last command."""
        return self._time_left(share, now) <= 0.0

    def wait_for(self, share: float, now: Instant) -> float:
        """Return how long to wait before the next look [s]."""
        left = max(0.0, self._time_left(share, now))
        return min(left, self._period / LOOKS) if now.is_simulated else left

    def _time_left(self, share: float, now: Instant) -> float:
        """Return the time until a command is due, by the clock that counts [s]."""
        last = self._last
        if self._moved is None or self._moved.clock != now.clock:
            self._moved = now
        if last is None or last.is_simulated != now.is_simulated:
            return 0.0
        assert now.steady is not None
        assert last.steady is not None
        assert self._moved.steady is not None
        if not now.is_simulated or now.steady - self._moved.steady > STANDSTILL_SECONDS:
            return share * self._period - (now.steady - last.steady)
        if now.clock < last.clock:
            return 0.0
        return share * self._period - (now.clock - last.clock)


@dataclasses.dataclass
class Latencies:
    """Times of the loop.

    `scan_ms` has the times from the arrival of a scan to the command that follows from it [ms].
    `num_late` counts commands that were due before their plan was ready. `num_compiled` counts
    programs that were compiled since the drive began; each one would delay a command by seconds.
    """

    scan_ms: Rows = dataclasses.field(default_factory=lambda: Rows(1))
    num_commands: int = 0
    num_late: int = 0
    num_compiled: int = 0

    def percentile(self, share: float) -> float | None:
        """Return a percentile of the times [ms]; None without a scan."""
        times = self.scan_ms.array
        return float(np.percentile(times, share)) if len(times) else None


class ControlNode:
    """Drives a robot over ROS 2 with a pilot that `Pilot.prepare` has compiled.

    Messages arrive in the thread of the link, which only keeps them. The loop runs in the thread of
    the caller: it wakes up for each scan and for each control period. Plans are computed in a third
    thread, maps and fields in a fourth. If a plan is not ready at the deadline, the next command of
    the last plan is sent and counted.

    In the mode `controller` a `PathAction` says which path the robot follows, the link is a managed
    one, and commands are sent while there is a goal only: others drive the robot meanwhile.

    `gave_way` says why the drive ended in favour of another node. `gave_up` says why it ended
    without the robot, see `Silence`. Both are empty otherwise.
    """

    def __init__(
        self,
        link: Link,
        pilot: Pilot,
        settings: NodeSettings,
        monitors: Sequence[Monitor] = (),
    ) -> None:
        self.link, self.pilot, self.settings = link, pilot, settings
        self.latencies = Latencies()
        self.gave_way = self.gave_up = ""
        self.watch = DriveWatch(pilot, monitors)
        ros = link.ros
        self._lock = threading.Lock()
        self._poses: list[messages.Odometry] = []
        self._scans: list[messages.LaserScan] = []
        self._shares: list[tuple[float, Instant]] = []
        self._orders: list[str] = []
        self._goals: list[np.ndarray] = []
        self._parameters: dict[str, float] = {}
        self._wake = threading.Event()
        self._worker = concurrent.futures.ThreadPoolExecutor(1, "plan")
        self._mapper = concurrent.futures.ThreadPoolExecutor(1, "map")
        self._background: concurrent.futures.Future[None] | None = None
        # The fixed frame, and that of the poses, which drifts where the robot localises itself.
        self._pose_frame = link.frame(settings.world_frame)
        self._has_map_frame = pilot.has_map_frame
        self._changes = Changes()
        self._last_mode: Mode | None = None
        self._commands = CommandPublisher(link, settings)
        self._publisher = DrivePublisher(link, pilot, settings.rollout_colour)
        self._session = None if pilot.session is None else SessionWriter(pilot, link.info)
        self._began = math.inf
        self._last_pose: messages.Odometry | None = None
        self._seen_at = -math.inf
        pose_topic = "/tf" if settings.pose_type == "tf" else link.topic(settings.pose_topic)
        self._scan_topic, self._pose_topic = link.topic(settings.scan_topic), pose_topic
        topics = (self._scan_topic, self._pose_topic)
        self._action: PathAction | None = None
        transforms: Transforms | None = None
        if settings.mode == "controller":
            self._transforms = transforms = Transforms()
            self._action = PathAction(link, pilot, settings, self._place_of)
        has_scans = self._action is None or self._action.has_scans
        margin, mount = pilot.task.perception.resolution, lidar_mount(settings)
        self._further: FurtherLidars | None = None
        if has_scans:
            self._further = further_lidars(settings, pilot.sensor, mount, margin, link.topic)
        further = () if self._further is None else self._further.topics
        heard = (*topics[not has_scans :], *further)
        self._silence = Silence(link, heard, settings.give_up_after)
        if has_scans:
            no_echo = NoEcho(settings.no_echo, margin)
            subscribe_scan(link, settings, pilot.sensor, mount, no_echo, self._take_scan)
        if self._further is not None:
            subscribe_further(link, self._further, self._silence.hear)
        subscribe_pose(link, settings, self._take_pose, transforms)
        self._battery = pilot.task.perception.part(Battery)
        if self._battery is not None:
            subscribe_battery(link, settings, self._take_battery)
        if isinstance(pilot.task, Following) and self._action is None:
            link.subscribe(ros.Path, settings.path_topic, partial(self._take_path, pilot.task))
        if pilot.finds_itself:
            link.subscribe(ros.PoseWithCovarianceStamped, INITIAL_POSE_TOPIC, self._take_told_pose)
        if settings.map is not None and settings.mode == "control":
            link.subscribe(ros.PoseStamped, settings.goal_topic, self._take_goal)
        link.subscribe(ros.String, "~/command", self._take_order)
        link.subscribe(ros.String, "~/state", self._take_state)
        for order in ORDERS:
            link.service(f"~/{order}", partial(self._order, order))
        self._declare_parameters()

    @property
    def _frame_name(self) -> str:
        frame = self.settings.map_frame
        return self.link.frame(frame) if self._has_map_frame else self._pose_frame

    def _declare_parameters(self) -> None:
        """Offer the numbers of the controller as ROS parameters that may change while it drives."""
        node = self.link.node
        for path, value in get_parameters(self.pilot.controller).items():
            if value.ndim == 0:
                node.declare_parameter(path, float(value))
        node.declare_parameter(ROLLOUT_COLOUR, self._publisher.rollout_colour)
        for name, number in self._own_parameters.items():
            node.declare_parameter(name, number)
        node.add_on_set_parameters_callback(self._take_parameters)

    @property
    def _own_parameters(self) -> dict[str, float]:
        return {} if self._action is None else self._action.parameters

    def _take_parameters(self, changed: Sequence[Any]) -> Any:
        result = self.link.ros.SetParametersResult
        values = {each.name: each.value for each in changed}
        known = {name: each for name, each in values.items() if not name.startswith("use_sim_time")}
        colour = known.pop(ROLLOUT_COLOUR, self._publisher.rollout_colour)
        own = {name: known.pop(name) for name in self._own_parameters if name in known}
        try:
            self._publisher.check_colour(colour)
            # Tried here, so that the caller gets the reason, and set in the thread of the loop.
            set_parameters(self.pilot.controller, known)
            if self._action is not None:
                self._action.change(own)
        except (ValueError, TypeError) as error:
            return result(successful=False, reason=" ".join(str(error).split()))
        with self._lock:
            self._parameters |= known
        self._publisher.rollout_colour = colour
        return result(successful=True)

    def _take_scan(self, scan: messages.LaserScan) -> None:
        self._silence.hear(self._scan_topic)
        if self._further is not None:
            scan = self._further.complete(scan)
        seen: messages.LaserScan | None = scan
        if self._action is not None:
            seen = self._action.see(scan, self._last_pose)
        if seen is None:
            return
        with self._lock:
            self._scans.append(seen)
        self._wake.set()

    def _take_pose(self, pose: messages.Odometry) -> None:
        self._silence.hear(self._pose_topic)
        self._last_pose = pose
        if self._further is not None:
            self._further.add_pose(pose)
        with self._lock:
            self._poses.append(pose)
        if self._action is None or self._action.has_scans:
            return
        # What the robot sees of a costmap changes with its pose.
        now, scenario = time.monotonic(), self.pilot.scenario
        if now - self._seen_at >= float(scenario.steps_per_scan) * self.pilot.period:
            self._seen_at = now
            seen = self._action.see(None, pose)
            if seen is not None:
                with self._lock:
                    self._scans.append(seen)
                self._wake.set()

    def _place_of(self, frame: str) -> np.ndarray | None:
        """Return the pose (3,) of a frame in that of the robot's pose; None if it is not known."""
        if frame == self._frame_name:
            return np.zeros(3)
        found = self._transforms.pose(self._frame_name, frame)
        return None if found is None else found.pose

    def _take_battery(self, share: float, received: Instant) -> None:
        with self._lock:
            self._shares.append((share, received))

    def _take_path(self, task: Following, message: Any) -> None:
        frame, poses = map_messages.path_of(message)
        if frame != self._frame_name:
            raise ValueError(
                f"frame_id of a path is {frame!r}; accepted: {self._frame_name!r}, that of the map"
            )
        task.take(poses[:, :2])

    def _take_told_pose(self, message: Any) -> None:
        told = messages.odometry_of(message)
        if told.frame != self._frame_name:
            raise ValueError(
                f"frame_id of an initial pose is {messages.text_of(told.frame)}; accepted: "
                f"{self._frame_name!r}, that of the map"
            )
        self.pilot.tell_pose(told.pose)

    def _take_goal(self, message: Any) -> None:
        goal = messages.odometry_of(message)
        if goal.frame != self._frame_name:
            raise ValueError(
                f"frame_id of a goal is {messages.text_of(goal.frame)}; accepted: "
                f"{self._frame_name!r}, that of the map"
            )
        self.pilot.task.check_return()
        with self._lock:
            self._goals.append(goal.pose[:2] - self.pilot.offset)
        self._wake.set()

    def _take_order(self, message: Any) -> None:
        if message.data not in ORDERS:
            given = messages.text_of(repr(message.data))
            raise ValueError(f"command is {given}; accepted: {', '.join(ORDERS)}")
        self._order(message.data)

    def _order(self, order: str) -> str:
        """Take an order; return what happens. One that the drive cannot obey is a `ValueError`."""
        if order == "return":
            self.pilot.task.check_return()
        if order == "save" and self._session is None:
            raise ValueError("the node has no session; accepted: save with node --session FOLDER")
        with self._lock:
            self._orders.append(order)
        self._wake.set()
        return f"{order} is noted"

    def check_alone(self) -> None:
        """Wait until other nodes are found; raise a `ValueError` if one of them sends commands."""
        if self._action is not None:
            # Beside nav2's controller server others drive: its behaviours, a joystick.
            self.link.start()
            self._commands.match()
            return
        # What publishes scans has been there for longer, so others are found at about that time.
        self.link.wait_for(self.settings.scan_topic)
        others = self.link.other_publishers(self.settings.command_topic)
        if others:
            raise ValueError(self._describe_conflict(others[0]))
        self._commands.match()

    def _describe_conflict(self, other: str) -> str:
        topic = self.link.topic(self.settings.command_topic)
        return (
            f"{topic} has another publisher, {messages.text_of(other)}; accepted: one node that "
            "commands the robot, another --namespace, or another ROS_DOMAIN_ID"
        )

    def _take_state(self, message: Any) -> None:
        """Give way to a node of this name that drove first; on a busy machine it is found late."""
        try:
            state = parse_json(message.data, MOST_STATE)
        except ValueError:
            return
        began = state.get("began") if isinstance(state, dict) else None
        # Its own messages are heard as well, and have its own time.
        if isinstance(began, float) and began < self._began:
            self.gave_way = self._describe_conflict(NODE)
            self.pilot.finish(self.gave_way)

    def _warn_of_others(self) -> None:
        """Warn of other publishers of commands that came after this one."""
        if self._action is not None:
            return
        for other in self.link.other_publishers(self.settings.command_topic):
            self.link.warn("other publisher", self._describe_conflict(other))

    def run(self, is_stopped: threading.Event) -> None:
        """Drive until the task is done or the event is set, and then stand."""
        self.watch.prepare()
        self._began = time.time()
        jax.monitoring.register_event_duration_secs_listener(self._count)
        try:
            command = self._drive(is_stopped)
        finally:
            jax.monitoring.unregister_event_duration_listener(self._count)
            # Whatever happened, the robot is told to stand.
            self._worker.shutdown(cancel_futures=True)
            self._mapper.shutdown(cancel_futures=True)
            if self._action is None or self._action.is_commanding:
                self._commands.publish(Command(np.zeros(3), Mode.DONE, self.pilot.finished, None))
            if self._action is not None:
                self._action.close(self.pilot.time)
            if self._session is not None:
                self._session.end()
        self._publish_state(command)

    def _count(self, event: str, duration_secs: float, **_: str | int) -> None:
        self.latencies.num_compiled += event == COMPILED

    def _drive(self, is_stopped: threading.Event) -> Command:
        """Send commands until the robot stands at the end; return the last one."""
        period = self.pilot.period
        pace = Pace(period)
        arrived, ends_by = None, math.inf
        while True:
            # A scan that came right after a command waits for a part of the period, not for all.
            wanted = 1.0 if arrived is None else LEAST_SHARE
            self._wake.wait(pace.wait_for(wanted, self.link.instant()))
            self._wake.clear()
            newest = self._take_messages()
            arrived = arrived if newest is None else newest
            if not pace.is_due(1.0 if arrived is None else LEAST_SHARE, self.link.instant()):
                continue
            now = time.monotonic()
            pace.begin(self.link.instant())
            if is_stopped.is_set():
                self.pilot.finish("stopped")
                ends_by = min(ends_by, now + MOST_BRAKING)
            command = self._next_command(now + self.settings.deadline * period)
            if self._action is None or self._action.is_commanding:
                self._commands.publish(command)
            if self._action is not None:
                self._action.settle(self.pilot.time, command)
            self._changes.add(command)
            if arrived is not None and command.scan_time is not None:
                self.latencies.scan_ms.add(1e3 * (time.monotonic() - arrived))
            arrived = None
            self._submit_between(command)
            is_at_rest = command.mode is Mode.DONE and not command.twist.any()
            # Without odometry nobody sees that the robot has come to rest.
            if is_at_rest or now >= ends_by:
                return command

    def _submit_between(self, command: Command) -> None:
        """Do in another thread what no command waits for; an error of it ends the drive."""
        former = self._background
        if former is not None:
            # What takes longer than a period is not done twice at a time.
            if not former.done():
                return
            former.result()
        self._background = self._mapper.submit(self._work_between_commands, command)

    def _take_messages(self) -> float | None:
        """Give the pilot what has arrived; return when the newest scan did."""
        with self._lock:
            poses, self._poses = self._poses, []
            scans, self._scans = self._scans, []
            shares, self._shares = self._shares, []
            orders, self._orders = self._orders, []
            goals, self._goals = self._goals, []
            parameters, self._parameters = self._parameters, {}
        pilot = self.pilot
        if self._action is not None:
            self._action.obey(pilot.time)
        for pose in poses:
            self._pose_frame = pose.frame or self._pose_frame
            pilot.add_odometry(pose.time, pose.pose, pose.twist, pose.received)
        # A costmap has an age of its own.
        live = {} if self._action is None else {"is_live": not self._action.has_scans}
        for scan in scans:
            pilot.add_scan(scan.time, scan.scan, scan.points, scan.received, scan.sweep, **live)
        for share, heard in shares:
            assert self._battery is not None
            pilot.add_look(Battery.name, share * float(self._battery.capacity), heard)
        if parameters:
            pilot.controller = set_parameters(pilot.controller, parameters)
        for order in orders:
            self._obey(order)
        for place in goals:
            pilot.is_started = True
            pilot.task.go_to(pilot.time, place)
        received = scans[-1].received if scans else None
        return None if received is None else received.steady

    def _obey(self, order: str) -> None:
        pilot = self.pilot
        if order == "save":
            assert self._session is not None
            self._session.ask()
            return
        pilot.is_started = order in ("start", "explore", "return")
        if order in ("start", "explore"):
            pilot.task.go_on()
        elif order == "return":
            pilot.task.turn_back(pilot.time, "told to return")
        elif order == "stop":
            pilot.finish("stopped by command")

    def _next_command(self, deadline: float) -> Command:
        """Compute a command, or take the next one of the last plan at the deadline."""
        self.latencies.num_commands += 1
        plan = self._worker.submit(self.pilot.command, self.link.instant())
        try:
            return plan.result(max(0.0, deadline - time.monotonic()))
        except concurrent.futures.TimeoutError:
            self.latencies.num_late += 1
            plan.cancel()
            return self.pilot.next_command(self.link.instant())

    def _work_between_commands(self, command: Command) -> None:
        """Do what no command waits for: fields, maps, the plan and the state."""
        now, pilot = self.link.now(), self.pilot
        pilot.update_belief(self.link.instant())
        # A transform from a frame to itself is none.
        has_frames = self._has_map_frame and self._frame_name != self._pose_frame
        if has_frames and pilot.pose is not None and not pilot.lost:
            self._publisher.publish_transform(now, self._frame_name, self._pose_frame)
        if self._session is not None:
            self._session.write_when_due()
        pilot.log.frames.add_when_due(pilot.log.num_steps * pilot.period, pilot.make_frame)
        changes = self._changes.take()
        for change in changes:
            self._publish_state(change)
        for each in changes or [command]:
            self._tell(each)
        self.watch.show(command)
        if self._publisher.publish_due(now, self._frame_name, self._state_entries(command)):
            self._warn_of_others()
            self._commands.match()
            reason = self._silence.check()
            if reason:
                self.gave_up = reason
                self.pilot.finish(reason)

    def _tell(self, command: Command) -> None:
        """Log what the pilot does, with the reason."""
        former, self._last_mode = self._last_mode, command.mode
        if self._action is not None and not self._action.is_commanding:
            # A server without a goal has nothing to tell.
            return
        if former is not command.mode:
            reason = f": {command.reason}" if command.reason else ""
            self.link.info(f"{command.mode}{reason}")
        elif command.reason and command.mode is not Mode.DONE and not self._silence.is_long:
            self.link.warn(" ".join(kind_of(command)), command.reason)

    def _publish_state(self, command: Command) -> None:
        self._publisher.publish_state(self._state_entries(command))

    def _state_entries(self, command: Command) -> dict[str, object]:
        pilot, times = self.pilot, self.latencies
        return {
            "began": self._began,
            "mode": str(command.mode),
            "reason": command.reason,
            "saved": None if pilot.session is None else pilot.session.saved_at,
            "explored_m2": round(pilot.log.num_known * pilot.belief.grid.resolution**2, 2),
            "commands": times.num_commands,
            "late": times.num_late,
            "replaced": pilot.num_replaced,
            "compiled": times.num_compiled,
            "scan_to_command_ms_p50": times.percentile(50),
            "scan_to_command_ms_p99": times.percentile(99),
            "warnings": sum(self.link.num_warnings.values()),
        }


def lidar_mount(settings: NodeSettings) -> Mount:
    """Return the place of the lidar on the robot."""
    return Mount(
        settings.lidar_x,
        settings.lidar_y,
        math.radians(settings.lidar_yaw_degrees),
        settings.is_lidar_inverted,
    )
