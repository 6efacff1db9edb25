"""Feed a recorded drive to a pilot: what would it have commanded."""

import contextlib
import math
import os
from collections.abc import Callable
from typing import Any, NamedTuple

from jaxplore.onboard.drive_clock import Instant
from jaxplore.onboard.options import Command
from jaxplore.onboard.pilot import Pilot
from jaxplore.parts.battery.robot import Battery
from jaxplore.ros import messages
from jaxplore.ros.bag import BagMessage, bag_topics, choose_topic, read_bag
from jaxplore.ros.clouds import scan_of_cloud
from jaxplore.ros.further_lidars import FurtherLidars
from jaxplore.ros.messages import Mount
from jaxplore.ros.transforms import Transforms
from jaxplore.sensing.cloud_view import CloudView
from jaxplore.sensing.no_echo import NoEcho

POSES = ("Odometry", "PoseWithCovarianceStamped", "TFMessage")
"""Kinds of messages that have the pose of the robot, the preferred one first."""
STATIC = "tf_static"
"""Last name of a topic whose transforms hold for all times."""
ROBOT_FRAMES = ("base_link", "base_footprint")
"""Names of the frame of a robot (REP 105), the preferred one first."""
WORLD_FRAME = "map"
"""Name of the frame that is fixed in the world; without it the root of the robot's frame is."""
MOST_FRAMES = 1000
"""Greatest number of frames of a bag."""
GAP_SECONDS = 5.0
"""Longest time between two messages that is replayed [s]; beyond it the robot has long come to
rest."""


class Replayed(NamedTuple):
    """What came of a replay.

    `times` are those of the commands since the first message, without what was skipped [s].
    `num_malformed` messages were left out, the first one for `reason`. `skipped` is the recorded
    time that was left out, because it had no messages [s]. `news` is what was found about beams
    that met nothing. `reason` and `news` are empty where there is nothing to tell.
    """

    times: list[float]
    commands: list[Command]
    num_messages: int
    num_malformed: int
    reason: str
    skipped: float
    news: str


def replay_topics(
    path: str | os.PathLike[str], scan: str | None, pose: str | None, *, is_cloud: bool = False
) -> tuple[str, str]:
    """Return the topics of the scan, or of the cloud, and of the pose in a bag.

    Without a name the scan is the only topic of its kind, and the pose is the only odometry, or
    else the only pose, or else the transforms.
    """
    topics = bag_topics(path)
    scan_topic = choose_topic(topics, "PointCloud2" if is_cloud else "LaserScan", scan)
    if pose is not None:
        found = topics.get(pose)
        kind = POSES[0] if found is None or found.kind not in POSES else str(found.kind)
        return scan_topic, choose_topic(topics, kind, pose)
    moving = {
        name: each
        for name, each in topics.items()
        if each.kind in POSES and each.number and not name.endswith(STATIC)
    }
    held = {each.kind for each in moving.values()}
    best = next((each for each in POSES if each in held), None)
    if best is None:
        names = ", ".join(map(repr, sorted(topics)))
        raise ValueError(
            f"bag has no pose: its topics are {names}; accepted: a bag with one of kind "
            f"{', '.join(POSES)}"
        )
    return scan_topic, choose_topic(moving, best)


def replay(
    path: str | os.PathLike[str],
    pilot: Pilot,
    scan: str,
    pose: str,
    *,
    mount: Mount | None = None,
    no_echo: NoEcho | None = None,
    view: CloudView | None = None,
    further: FurtherLidars | None = None,
    on_progress: Callable[[float], None] = lambda _: None,
) -> Replayed:
    """Feed a bag to a pilot, in the order and at the times of its messages.

    A gap in the bag is a gap in the data: the pilot brakes in it. Of a gap that is longer than
    `GAP_SECONDS` the rest is left out, for the pilot as well. The pilot's option `is_obeyed` is
    false, because the recorded robot did not obey.

    Where the topic of the pose has transforms, the pose follows from a chain of those of all
    topics, such as `map -> odom -> base_link`. `no_echo` says which readings met nothing; when
    absent, the rule `auto` does. With a `view` the scans are made of clouds, which that topic has.
    The scans are completed by those of `further` lidars. `on_progress` gets the recorded time since
    the first message [s].

    Raises:
        ValueError: a bag that cannot be read; transforms without a frame of a robot; a robot with a
            battery, and no single topic of its charge.
    """
    no_echo = NoEcho() if no_echo is None else no_echo
    mount = Mount() if mount is None else mount

    def read_scan(message: Any) -> messages.LaserScan:
        if view is not None:
            return scan_of_cloud(message, pilot.sensor, mount, view)
        return messages.laser_scan_of(message, pilot.sensor, mount, no_echo)

    chain = _Chain.of(path) if bag_topics(path)[pose].kind == "TFMessage" else None
    topics = [scan, pose] if chain is None else [scan, *chain.topics]
    # The charge decides when the robot returns, so the drive of one with a battery tells it.
    part, battery = pilot.task.perception.part(Battery), None
    if further is not None:
        for topic in further.topics:
            topics.append(choose_topic(bag_topics(path), "LaserScan", topic))
    if part is not None:
        battery = choose_topic(bag_topics(path), "BatteryState")
        topics.append(battery)
    began: float | None = None
    due, now, skipped, number, malformed, reason = 0.0, 0.0, 0.0, 0, 0, ""
    times: list[float] = []
    commands: list[Command] = []
    for each in read_bag(path, topics):
        if began is None:
            began = due = now = each.time
        # The times of a bag from elsewhere may jump by years.
        skipped += max(each.time - skipped - now - GAP_SECONDS, 0.0)
        now = each.time - skipped
        while due <= now:
            commands.append(pilot.command(due))
            times.append(due - began)
            pilot.update_belief(due)
            pilot.log.frames.add_when_due(due - began, pilot.make_frame)
            due += pilot.period
        on_progress(each.time - began)
        number += 1
        received = Instant(each.time - skipped)
        try:
            if part is not None and each.topic == battery:
                energy = messages.battery_share_of(each.message) * float(part.capacity)
                pilot.add_look(part.name, energy, received)
            elif further is not None and each.topic in further.topics:
                further.read(each.topic, each.message, received, skipped)
            elif each.topic == scan:
                seen = read_scan(each.message)
                seen = seen._replace(time=seen.time - skipped, received=received)
                seen = seen if further is None else further.complete(seen)
                pilot.add_scan(seen.time, seen.scan, seen.points, received, seen.sweep)
            else:
                place = messages.odometry_of(each.message) if chain is None else chain.feed(each)
                if place is not None:
                    place = place._replace(time=place.time - skipped, received=received)
                    if further is not None:
                        further.add_pose(place)
                    pilot.add_odometry(place.time, place.pose, place.twist, received)
        except (ValueError, TypeError, OverflowError, AttributeError) as error:
            malformed += 1
            reason = reason or " ".join(str(error).split())
    return Replayed(times, commands, number, malformed, reason, skipped, no_echo.news)


class _Chain:
    """The transforms of a bag, and the pose of the robot that follows from them."""

    def __init__(self, world: str, robot: str, topics: list[str]) -> None:
        self.topics = topics
        self._world, self._robot = world, robot
        self._transforms = Transforms()
        self._latest = -math.inf

    @classmethod
    def of(cls, path: str | os.PathLike[str]) -> "_Chain":
        """Find the frames of the robot and of the world among the transforms of a bag."""
        topics = [name for name, each in bag_topics(path).items() if each.kind == "TFMessage"]
        parents: dict[str, str] = {}
        static: list[Any] = []
        for each in read_bag(path, topics):
            for one in each.message.transforms:
                name, parent = (
                    str(frame).removeprefix("/")
                    for frame in (one.child_frame_id, one.header.frame_id)
                )
                if name in parents or len(parents) < MOST_FRAMES:
                    parents[name] = parent
                if each.topic.endswith(STATIC) and len(static) < MOST_FRAMES:
                    static.append(one)
        robot = next(
            (name for wanted in ROBOT_FRAMES for name in parents if name.split("/")[-1] == wanted),
            None,
        )
        if robot is None:
            names = ", ".join(map(messages.text_of, sorted(parents)[:8])) or "none"
            raise ValueError(
                f"bag has no pose: no transform places {' or '.join(ROBOT_FRAMES)}, only {names}; "
                "accepted: transforms of the frame of a robot"
            )
        above = [robot]
        while above[-1] in parents and parents[above[-1]] not in above:
            above.append(parents[above[-1]])
        named = [name for name in above[1:] if name.split("/")[-1] == WORLD_FRAME]
        found = cls(named[0] if named else above[-1], robot, topics)
        # Those that hold for all times may be recorded late.
        for one in static:
            found._add(one, is_static=True)
        return found

    def feed(self, given: BagMessage) -> messages.Odometry | None:
        """Take transforms, and return the pose that follows from them, if there is a new one."""
        for one in given.message.transforms:
            self._add(one, is_static=given.topic.endswith(STATIC))
        place = self._transforms.pose(self._world, self._robot)
        if place is None or place.time == self._latest:
            return None
        self._latest = place.time
        return place

    def _add(self, one: Any, *, is_static: bool) -> None:
        # A camera's transform that is wrong does not take the robot's away.
        with contextlib.suppress(ValueError):
            self._transforms.add(one, is_static=is_static)
