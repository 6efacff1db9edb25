"""The ROS 2 packages of the machine: those of a robot's installation, or wheels."""

import importlib
from types import SimpleNamespace
from typing import Any

MESSAGES = {
    "builtin_interfaces": ("Duration", "Time"),
    "geometry_msgs": (
        "Point",
        "PoseStamped",
        "PoseWithCovarianceStamped",
        "TransformStamped",
        "Twist",
        "TwistStamped",
    ),
    "nav_msgs": ("OccupancyGrid", "Odometry", "Path"),
    "rcl_interfaces": ("SetParametersResult",),
    "sensor_msgs": ("BatteryState", "LaserScan"),
    "std_msgs": ("String",),
}
"""Packages of messages that every mode needs, and their messages."""
FURTHER = {"tf2_msgs": ("TFMessage",), "visualization_msgs": ("Marker", "MarkerArray")}
"""Packages without which a node runs, but without transforms or markers."""


def import_ros() -> Any:
    """Import rclpy and the messages, and return them by name; those that are missing are None.

    Without rclpy or a package of `MESSAGES` it raises a `ValueError`.
    """
    found: dict[str, Any] = {}
    try:
        found["rclpy"] = importlib.import_module("rclpy")
        for package, names in MESSAGES.items():
            found |= _messages(package, names)
    except ImportError as error:
        # A broken installation says more in its own words than a name.
        raise ValueError(
            f"ROS 2 cannot be imported ({error}); accepted: a terminal in which the setup file of "
            "ROS was sourced, with a Python of its version, or pip install '.[ros]' in a clone of "
            "jaxplore"
        ) from None
    for package, names in FURTHER.items():
        try:
            found |= _messages(package, names)
        except ImportError:
            found |= dict.fromkeys(names)
    try:
        found["Trigger"] = importlib.import_module("std_srvs.srv").Trigger
    except ImportError:
        found["Trigger"] = None
    return SimpleNamespace(**found)


def _messages(package: str, names: tuple[str, ...]) -> dict[str, Any]:
    module = importlib.import_module(f"{package}.msg")
    return {name: getattr(module, name) for name in names}
