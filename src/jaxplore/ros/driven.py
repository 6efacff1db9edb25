"""Collect the commands and velocities of a drive, from a bag or from ROS, to identify motors."""

import os
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from jaxplore.onboard.identification import MOST_SAMPLES, Drive
from jaxplore.onboard.motors import AXES
from jaxplore.ros import messages
from jaxplore.ros.bag import bag_topics, choose_topic, read_bag
from jaxplore.ros.command_publisher import COMMAND_TYPES
from jaxplore.ros.link import Link

COMMANDS = ("Twist", "TwistStamped")
"""Kinds of messages that command a velocity, the preferred one first."""
CLOCK_TOLERANCE = 1.0
"""Difference of a stamp from its arrival beyond which the arrival counts [s]."""
POLL_SECONDS = 0.2
"""Time between two looks at whether to go on [s]."""


class Driven:
    """Commands and velocities as they come; malformed ones are left out and counted."""

    def __init__(self) -> None:
        self._rows: tuple[list[np.ndarray], list[np.ndarray]] = ([], [])
        self.num_malformed = 0

    def __len__(self) -> int:
        return len(self._rows[0])

    def add(self, message: Any, received: float, *, is_command: bool) -> None:
        """Add a command or an odometry that was received at a time [s].

        A stamp says when it was sent or measured, unless it is no time of the receiver's clock.
        """
        try:
            inner = message.twist if hasattr(message, "twist") else message
            twist = messages.twist_of(inner.twist if hasattr(inner, "twist") else inner)
            header = getattr(message, "header", None)
            stamp = received if header is None else messages.time_of(header.stamp)
        except (ValueError, TypeError, OverflowError, AttributeError):
            self.num_malformed += 1
            return
        at = stamp if abs(stamp - received) <= CLOCK_TOLERANCE else received
        rows = self._rows[0 if is_command else 1]
        # What comes late, or twice, says nothing new. Both may come for hours.
        if len(rows) < MOST_SAMPLES and (not rows or at > rows[-1][0]):
            rows.append(np.concatenate([[at], twist]))

    def drive(self) -> Drive:
        """Return what came; a `ValueError` without a command or without a velocity."""
        tables = []
        for name, rows in zip(("command", "odometry"), self._rows, strict=True):
            if not rows:
                raise ValueError(f"there is no {name} with {', '.join(AXES)}; accepted: a drive")
            tables.append(np.stack(rows))
        start = min(table[0, 0] for table in tables)
        commands, velocities = tables
        if not velocities[:, 1:].any():
            raise ValueError("the velocities of the odometry are all 0; accepted: measured ones")
        return Drive(
            commands[:, 0] - start, commands[:, 1:], velocities[:, 0] - start, velocities[:, 1:]
        )


def driven_topics(
    path: str | os.PathLike[str], command: str | None, pose: str | None
) -> tuple[str, str]:
    """Return the topics of the commands and of the odometry in a bag.

    Without a name each must be the only topic of its kind.
    """
    topics = bag_topics(path)
    kinds = [kind for kind in COMMANDS if any(each.kind == kind for each in topics.values())]
    kind = kinds[0] if kinds else COMMANDS[0]
    if command is not None and command in topics and topics[command].kind in COMMANDS:
        kind = str(topics[command].kind)
    return choose_topic(topics, kind, command), choose_topic(topics, "Odometry", pose)


def read_driven(path: str | os.PathLike[str], command: str, pose: str) -> Driven:
    """Read the commands and velocities of a bag."""
    found = Driven()
    for each in read_bag(path, [command, pose]):
        found.add(each.message, each.time, is_command=each.topic == command)
    return found


def listen(
    link: Link,
    command: str,
    pose: str,
    seconds: float,
    is_stopped: threading.Event,
    on_progress: Callable[[float, str], None],
) -> Driven:
    """Listen to the commands and the odometry of a robot that somebody else drives, for a time [s].

    The type of the commands is that of who publishes them. `on_progress` gets the share of the
    time, and a text.
    """
    found, ros = Driven(), link.ros
    link.wait_for(None)
    published = link.other_types(command, is_published=True)
    is_stamped = COMMAND_TYPES["twist_stamped"] in published
    kind = ros.TwistStamped if is_stamped else ros.Twist
    link.subscribe(kind, command, lambda message: found.add(message, link.now(), is_command=True))
    link.subscribe(
        ros.Odometry, pose, lambda message: found.add(message, link.now(), is_command=False)
    )
    began = time.monotonic()
    while (passed := time.monotonic() - began) < seconds and not is_stopped.is_set():
        on_progress(passed / seconds, f"{passed:.0f} s, {len(found)} commands")
        is_stopped.wait(POLL_SECONDS)
    return found
