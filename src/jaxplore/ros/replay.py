"""Feed a recorded drive to a pilot: what would it have commanded."""

import os
from collections.abc import Callable
from typing import NamedTuple

from jaxplore.onboard.drive_clock import Instant
from jaxplore.onboard.options import Command
from jaxplore.onboard.pilot import Pilot
from jaxplore.ros import messages
from jaxplore.ros.bag import BagMessage, bag_topics, choose_topic, read_bag
from jaxplore.ros.messages import Mount
from jaxplore.sensing.no_echo import NoEcho

POSES = ("Odometry", "PoseWithCovarianceStamped")
"""Kinds of messages that have the pose of the robot, the preferred one first."""
GAP_SECONDS = 5.0
"""Longest time between two messages that is replayed [s]; beyond it the robot has long come to
rest."""


class Replayed(NamedTuple):
    """What came of a replay.

    Args:
        times: time of each command since the first message, without what was skipped [s].
        commands: the commands.
        num_messages: number of messages that were fed.
        num_malformed: number of messages that were left out, and the first reason.
        reason: why the first of them was left out; empty without any.
        skipped: recorded time that was left out, because it had no messages [s].
        news: what was found about beams that met nothing; empty without any.
    """

    times: list[float]
    commands: list[Command]
    num_messages: int
    num_malformed: int
    reason: str
    skipped: float
    news: str


def replay_topics(
    path: str | os.PathLike[str], scan: str | None, pose: str | None
) -> tuple[str, str]:
    """Return the topics of the scan and of the pose in a bag.

    Args:
        path: the bag.
        scan: name of the topic of the scan; the only one of that kind when absent.
        pose: name of the topic of the pose; the only odometry when absent, or else the only pose.

    Raises:
        ValueError: a bag that cannot be read, without such topics, or with several.
    """
    topics = bag_topics(path)
    scan_topic = choose_topic(topics, "LaserScan", scan)
    if pose is not None:
        found = topics.get(pose)
        kind = POSES[0] if found is None or found.kind not in POSES else str(found.kind)
        return scan_topic, choose_topic(topics, kind, pose)
    kinds = {each.kind for each in topics.values()}
    kind = next((each for each in POSES if each in kinds), POSES[0])
    return scan_topic, choose_topic(topics, kind)


def replay(
    path: str | os.PathLike[str],
    pilot: Pilot,
    scan: str,
    pose: str,
    *,
    mount: Mount | None = None,
    no_echo: NoEcho | None = None,
    on_progress: Callable[[float], None] = lambda _: None,
) -> Replayed:
    """Feed a bag to a pilot, in the order and at the times of its messages.

    A gap in the bag is a gap in the data: the pilot brakes in it. Of a gap that is longer than
    `GAP_SECONDS` the rest is left out, for the pilot as well.

    Args:
        path: the bag.
        pilot: the pilot; its option `is_obeyed` is false, because the recorded robot did not obey.
        scan: topic of the scan.
        pose: topic of the pose.
        mount: pose of the lidar on the robot.
        no_echo: which readings met nothing; by the rule `auto` when absent.
        on_progress: called with the recorded time since the first message [s].

    Raises:
        ValueError: a bag that cannot be read.
    """
    no_echo = NoEcho() if no_echo is None else no_echo
    began: float | None = None
    due, now, skipped, number, malformed, reason = 0.0, 0.0, 0.0, 0, 0, ""
    times: list[float] = []
    commands: list[Command] = []
    for each in read_bag(path, [scan, pose]):
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
        try:
            _feed(pilot, each.topic == scan, each, skipped, mount, no_echo)
        except (ValueError, TypeError, OverflowError, AttributeError) as error:
            malformed += 1
            reason = reason or " ".join(str(error).split())
    return Replayed(times, commands, number, malformed, reason, skipped, no_echo.news)


def _feed(
    pilot: Pilot,
    is_scan: bool,
    given: BagMessage,
    skipped: float,
    mount: Mount | None,
    no_echo: NoEcho,
) -> None:
    """Give a message to the pilot, with its stamp and the time at which it was recorded."""
    received = Instant(given.time - skipped)
    if is_scan:
        scan = messages.laser_scan_of(given.message, pilot.sensor, mount, no_echo)
        pilot.add_scan(scan.time - skipped, scan.scan, scan.points, received, scan.sweep)
    else:
        place = messages.odometry_of(given.message)
        pilot.add_odometry(place.time - skipped, place.pose, place.twist, received)
