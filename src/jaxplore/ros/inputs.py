"""What a node hears: poses of one frame, scans of one lidar, and for how long nothing."""

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from jaxplore.onboard.drive_clock import Instant
from jaxplore.ros import messages
from jaxplore.ros.clouds import scan_of_cloud
from jaxplore.ros.further_lidars import FurtherLidars
from jaxplore.ros.link import Link
from jaxplore.ros.messages import Mount
from jaxplore.ros.transforms import Transforms
from jaxplore.sensing.beams import Beams
from jaxplore.sensing.no_echo import NoEcho
from jaxplore.settings.node import NodeSettings, cloud_view

GONE_SECONDS = 10.0
"""Silence after which a robot is gone [s]."""
REPORT_SECONDS = 60.0
"""Time between two reports of that [s]."""
TRANSFORMS_KEPT = 100
"""Number of messages of `/tf` that wait; many nodes publish there, and tf2 lets as many wait."""
CHAIN_SECONDS = 3.0
"""Time after the first transform in which a chain may be incomplete without a warning [s]."""


class Silence:
    """Tells that topics are silent, and when to give up.

    Topics have their full names. One that has never been heard counts from the start. Times are
    real ones: with a simulator that is paused nothing comes either. `give_up_after` is the silence
    after which the node ends [s]; it waits for ever when absent.
    """

    def __init__(self, link: Link, topics: Sequence[str], give_up_after: float | None) -> None:
        self._link, self._give_up_after = link, give_up_after
        now = time.monotonic()
        self._heard = dict.fromkeys(topics, now)
        self._never = set(topics)

    def hear(self, topic: str) -> None:
        """Note that a message of a topic has come."""
        self._heard[topic] = time.monotonic()
        self._never.discard(topic)

    @property
    def is_long(self) -> bool:
        """Whether a robot that is so silent is gone."""
        return self._longest >= GONE_SECONDS

    @property
    def _longest(self) -> float:
        return time.monotonic() - min(self._heard.values(), default=math.inf)

    def check(self) -> str:
        """Report a long silence once a minute; return why the node gives up, or an empty text."""
        if not self.is_long:
            return ""
        now = time.monotonic()
        silent = [
            f"nothing {'has come' if topic in self._never else 'comes'} on {topic} for "
            f"{now - heard:.0f} s"
            for topic, heard in self._heard.items()
            if now - heard >= GONE_SECONDS
        ]
        text = " and ".join(silent)
        if self._give_up_after is not None and self._longest >= self._give_up_after:
            return f"{text}: the robot is gone"
        ends = "" if self._give_up_after is not None else "; node.give_up_after would end the node"
        self._link.warn("silence", f"{text}{ends}", every=REPORT_SECONDS)
        return ""


class _FrameCheck:
    """Checks that all messages of a topic have the frame of the first.

    Two localisations, or two lidars, on one topic would be taken for one that jumps.
    """

    def __init__(self, topic: str) -> None:
        self._topic = topic
        self._frame: str | None = None

    def __call__(self, frame: str) -> None:
        """Raise a `ValueError` if the frame is not that of the first message."""
        if self._frame is None:
            self._frame = frame
        elif frame != self._frame:
            raise ValueError(
                f"frame_id of a message of {self._topic} is {frame!r}; accepted: {self._frame!r}, "
                "that of the first message"
            )


def subscribe_pose(
    link: Link,
    settings: NodeSettings,
    take: Callable[[messages.Odometry], None],
    transforms: Transforms | None = None,
) -> None:
    """Subscribe to the pose of the robot: odometry, a localisation, or transforms.

    `take` gets each pose with its arrival. Messages that are malformed, or of another frame than
    the first, give a warning. Transforms whose package is missing raise a `ValueError`. Those that
    are heard are kept in `transforms`; without it they are heard for a pose alone.
    """
    if settings.pose_type == "tf":
        _subscribe_to_chain(link, settings, take, transforms or Transforms())
        return
    if transforms is not None and link.ros.TFMessage is not None:
        _subscribe_transforms(link, transforms, lambda: None)
    ros, topic = link.ros, link.topic(settings.pose_topic)
    check = _FrameCheck(topic)

    def take_pose(message: Any) -> None:
        received = link.instant()
        pose = messages.odometry_of(message)
        check(pose.frame)
        link.warn_of_clock(topic, pose.time, received)
        take(pose._replace(received=received))

    is_odometry = settings.pose_type == "odometry"
    link.subscribe(ros.Odometry if is_odometry else ros.PoseWithCovarianceStamped, topic, take_pose)


def _subscribe_to_chain(
    link: Link,
    settings: NodeSettings,
    take: Callable[[messages.Odometry], None],
    transforms: Transforms,
) -> None:
    """Subscribe to the transforms, and follow them from the world's frame to the robot's."""
    names = link.frame(settings.world_frame), link.frame(settings.robot_frame)
    if link.ros.TFMessage is None:
        raise ValueError(
            "node.pose_type is 'tf', and tf2_msgs is not installed; accepted: odometry or pose"
        )
    began, taken = math.inf, -1.0

    def follow() -> None:
        nonlocal began, taken
        received, now = link.instant(), time.monotonic()
        began = min(began, now)
        pose = transforms.pose(*names)
        if pose is None:
            if now - began >= CHAIN_SECONDS:
                link.warn("transforms", transforms.gap(*names))
        # A pose is news if each transform of its chain is.
        elif pose.time != taken:
            taken = pose.time
            link.warn_of_clock("/tf", pose.time, received)
            take(pose._replace(received=received))

    _subscribe_transforms(link, transforms, follow)


def _subscribe_transforms(link: Link, transforms: Transforms, follow: Callable[[], None]) -> None:
    """Subscribe to the transforms and keep them; `follow` is called after each message."""

    def hear(message: Any, *, is_static: bool) -> None:
        reason = None
        for each in message.transforms:
            try:
                transforms.add(each, is_static=is_static)
            except (ValueError, TypeError, OverflowError, AttributeError) as error:
                # That of a gripper must not hide that of the wheels.
                reason = error
        follow()
        if reason is not None:
            raise reason

    for topic, is_static in (("/tf", False), ("/tf_static", True)):
        handle = partial(hear, is_static=is_static)
        link.subscribe(link.ros.TFMessage, topic, handle, is_kept=is_static, depth=TRANSFORMS_KEPT)


def subscribe_battery(
    link: Link, settings: NodeSettings, take: Callable[[float, Instant], None]
) -> None:
    """Subscribe to the battery; `take` gets the share that is left, and when it was heard.

    Messages that are malformed give a warning.
    """

    def take_battery(message: Any) -> None:
        if message.present:
            take(messages.battery_share_of(message), link.instant())

    link.subscribe(link.ros.BatteryState, link.topic(settings.battery_topic), take_battery)


def subscribe_further(link: Link, further: FurtherLidars, hear: Callable[[str], None]) -> None:
    """Subscribe to the further lidars; `hear` gets the topic of each scan."""

    def subscribe(topic: str) -> None:
        check = _FrameCheck(topic)

        def take_scan(message: Any) -> None:
            received = link.instant()
            check(messages.text_of(message.header.frame_id))
            scan = further.read(topic, message, received)
            news = further.news(topic)
            if news:
                link.info(news)
            link.warn_of_clock(topic, scan.time, received)
            hear(topic)

        link.subscribe(link.ros.LaserScan, topic, take_scan)

    for topic in further.topics:
        subscribe(topic)


def subscribe_scan(
    link: Link,
    settings: NodeSettings,
    sensor: Beams,
    mount: Mount,
    no_echo: NoEcho,
    take: Callable[[messages.LaserScan], None],
) -> None:
    """Subscribe to the lidar; `take` gets each scan with its arrival.

    Messages that are malformed, or of another lidar, give a warning. What `no_echo` finds is
    logged. With `node.cloud` the messages are clouds.
    """
    view = cloud_view(settings)
    topic = link.topic(settings.scan_topic)
    check = _FrameCheck(topic)

    def take_scan(message: Any) -> None:
        received = link.instant()
        if view is None:
            scan = messages.laser_scan_of(message, sensor, mount, no_echo)
        else:
            scan = scan_of_cloud(message, sensor, mount, view)
        if no_echo.news:
            link.info(no_echo.news)
            no_echo.news = ""
        check(scan.frame)
        link.warn_of_clock(topic, scan.time, received)
        take(scan._replace(received=received))

    if view is None:
        link.subscribe(link.ros.LaserScan, topic, take_scan)
    else:
        # A cloud that waits is old before it is read.
        link.subscribe(link.ros.PointCloud2, topic, take_scan, depth=1)
