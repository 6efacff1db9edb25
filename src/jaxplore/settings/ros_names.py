"""Names of ROS 2 in settings: namespaces and topics.

ROS accepts letters of ASCII, digits and underscores, with a slash between the parts of a name; no
part is empty or begins with a digit. Source: the ROS 2 design article "Topic and Service name
mapping to DDS".
"""

import re
from typing import Annotated

from pydantic import AfterValidator
from pydantic_core import PydanticCustomError

from jaxplore._text import short_repr

MOST_CHARACTERS = 120
"""Greatest length of a name. ROS takes 247 for a topic with its namespace."""
_PARTS = r"[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*"
_NAMESPACE = re.compile(rf"/?{_PARTS}", re.ASCII)
_TOPIC = re.compile(rf"(/|~/)?{_PARTS}", re.ASCII)
_RULE = (
    f"letters, digits and _, at most {MOST_CHARACTERS} characters, with / between parts that begin "
    "with no digit"
)
NAMESPACE_RULE = f"a namespace such as robot1: {_RULE}"
"""Accepted namespaces, for messages."""
NODE_RULE = (
    f"a name such as controller_server: letters, digits and _, at most {MOST_CHARACTERS} "
    "characters, and no digit first"
)
"""Accepted names of nodes, for messages."""
TOPIC_RULE = f"a topic such as scan or /scan: {_RULE}"
"""Accepted topics, for messages."""


def check_namespace(name: str, value: str) -> str:
    """Return a namespace without its leading slash."""
    if len(value) > MOST_CHARACTERS or not _NAMESPACE.fullmatch(value):
        raise ValueError(f"{name} is {short_repr(value)}; accepted: {NAMESPACE_RULE}")
    return value.removeprefix("/")


def _namespace(value: str) -> str:
    try:
        return check_namespace("namespace", value)
    except ValueError:
        raise PydanticCustomError("ros_name", NAMESPACE_RULE) from None


def check_topic(name: str, value: str) -> str:
    """Return a topic."""
    if len(value) > MOST_CHARACTERS or not _TOPIC.fullmatch(value):
        raise ValueError(f"{name} is {short_repr(value)}; accepted: {TOPIC_RULE}")
    return value


def _topic(value: str) -> str:
    try:
        return check_topic("topic", value)
    except ValueError:
        raise PydanticCustomError("ros_name", TOPIC_RULE) from None


def _node(value: str) -> str:
    if "/" in value or len(value) > MOST_CHARACTERS or not _NAMESPACE.fullmatch(value):
        raise PydanticCustomError("ros_name", NODE_RULE)
    return value


NodeName = Annotated[str, AfterValidator(_node)]
"""Name of a node."""
Namespace = Annotated[str, AfterValidator(_namespace)]
"""A namespace, without its leading slash."""
Topic = Annotated[str, AfterValidator(_topic)]
"""A topic: relative to the namespace, absolute with a slash, of the node with `~/`."""
