"""Publishes velocity commands in the type that the robot listens to."""

import threading
from typing import Any

from jaxplore.onboard.options import Command
from jaxplore.ros import messages
from jaxplore.ros.link import Link
from jaxplore.settings.node import NodeSettings

COMMAND_TYPES = {
    "twist": "geometry_msgs/msg/Twist",
    "twist_stamped": "geometry_msgs/msg/TwistStamped",
}
"""Types of commands in ROS, by their names in settings."""


class CommandPublisher:
    """Publishes velocity commands as `Twist` or `TwistStamped`.

    With `command_type: auto` the type is that of the subscriptions to the topic, also of a robot
    that comes late. If there are both or none, the type stays; at the start it is `Twist`.
    """

    def __init__(self, link: Link, settings: NodeSettings) -> None:
        self._link, self._settings = link, settings
        self._lock = threading.Lock()
        self._type = ""
        self._publisher: Any = None
        self._use(self._find_type() or "twist")

    @property
    def type(self) -> str:
        """Type of the commands, `twist` or `twist_stamped`."""
        return self._type

    def _find_type(self) -> str:
        """Return the type to use by what is heard now; empty if that says nothing."""
        if self._settings.command_type != "auto":
            return self._settings.command_type
        heard = self._link.other_types(self._settings.command_topic, is_published=False)
        names = [name for name, each in COMMAND_TYPES.items() if each in heard]
        return self._type if self._type in names else "".join(names[:1])

    def match(self) -> None:
        """Take the type that the robot listens to, and warn of those who listen to another."""
        topic, found = self._settings.command_topic, self._find_type()
        if found and found != self._type:
            self._use(found)
            self._link.info(f"commands on {self._link.topic(topic)} are {COMMAND_TYPES[found]}")
        heard = self._link.other_types(topic, is_published=False)
        used = COMMAND_TYPES[self._type]
        for kind, node in heard.items():
            if kind != used:
                self._link.warn(
                    "type of commands",
                    f"{messages.text_of(node)} listens to {messages.text_of(kind)} on "
                    f"{self._link.topic(topic)} and does not hear this node, which publishes "
                    f"{used}; accepted: {used}, or the setting node.command_type",
                )

    def publish(self, command: Command) -> None:
        """Publish a command, now."""
        link, ros = self._link, self._link.ros
        # Another thread may take another type.
        with self._lock:
            if self._type == "twist":
                message = ros.Twist()
                messages.fill_twist(message, command.twist)
            else:
                message = ros.TwistStamped()
                frame = link.frame(self._settings.robot_frame)
                messages.fill_header(message.header, link.now(), frame)
                messages.fill_twist(message.twist, command.twist)
            self._publisher.publish(message)

    def _use(self, name: str) -> None:
        kind = self._link.ros.Twist if name == "twist" else self._link.ros.TwistStamped
        with self._lock:
            # ROS allows one type of a topic in a process, so the former one goes first.
            if self._publisher is not None:
                self._link.node.destroy_publisher(self._publisher)
            self._publisher = self._link.publisher(kind, self._settings.command_topic)
            self._type = name
