"""The connection of a process to ROS 2: a node that spins in a thread of its own."""

import collections
import importlib
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import SimpleNamespace
from typing import Any

from jaxplore._text import printable
from jaxplore.onboard.drive_clock import CLOCK_TOLERANCE, MAX_STEP, Instant

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
    "sensor_msgs": ("BatteryState", "LaserScan", "PointCloud2"),
    "std_msgs": ("String",),
}
"""Packages of messages that every mode needs, and their messages."""
FURTHER = {
    "bond.msg": ("Status",),
    "nav2_msgs.action": ("FollowPath", "NavigateToPose"),
    "nav2_msgs.msg": ("SpeedLimit",),
    "std_srvs.srv": ("Trigger",),
    "tf2_msgs.msg": ("TFMessage",),
    "visualization_msgs.msg": ("Marker", "MarkerArray"),
}
"""Modules without which a node runs, but without what they are for."""
DISCOVERY_SECONDS, MOST_DISCOVERY_SECONDS = 1.5, 10.0
"""Least and greatest time after the connection in which other nodes are found [s]."""
QUIET_SECONDS = 5.0
"""Least time between two warnings about the same thing [s]."""


def import_ros() -> Any:
    """Import rclpy and the messages, and return them by name; those that are missing are None.

    Without rclpy or a package of `MESSAGES` it raises a `ValueError`.
    """
    found: dict[str, Any] = {}
    try:
        found["rclpy"] = importlib.import_module("rclpy")
        for package, names in MESSAGES.items():
            found |= _messages(f"{package}.msg", names)
    except ImportError as error:
        # A broken installation says more in its own words than a name.
        raise ValueError(
            f"ROS 2 cannot be imported ({error}); accepted: a terminal in which the setup file of "
            "ROS was sourced, with a Python of its version, or pip install '.[ros]' in a clone of "
            "jaxplore"
        ) from None
    for module, names in FURTHER.items():
        try:
            found |= _messages(module, names)
        except ImportError:
            found |= dict.fromkeys(names)
    return SimpleNamespace(**found)


def _messages(name: str, names: tuple[str, ...]) -> dict[str, Any]:
    module = importlib.import_module(name)
    # An older distribution may lack one of them.
    return {each: getattr(module, each, None) for each in names}


class Link:
    """A ROS 2 node with its publishers, subscriptions and warnings.

    Callbacks of messages run in the thread of the link, so they must be short. `ros` are the
    packages of `import_ros`. The namespace has no leading slash; there is none when absent. A
    managed node has a lifecycle, see `manage`, and is deaf until `start`.
    """

    def __init__(
        self, name: str, ros: Any, namespace: str | None = None, *, is_managed: bool = False
    ) -> None:
        self.ros, self.namespace = ros, namespace
        make = ros.rclpy.create_node
        if is_managed:
            make = importlib.import_module("rclpy.lifecycle").LifecycleNode
        self.node = make(name, namespace=f"/{namespace or ''}")
        self._executor = ros.rclpy.executors.SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._thread = threading.Thread(target=self._spin, name="ros", daemon=True)
        self._began = time.monotonic()
        self._warned: dict[str, float] = {}
        self.num_warnings: collections.Counter[str] = collections.Counter()
        if not is_managed:
            self.start()

    def start(self) -> None:
        """Begin to call what messages and services are for."""
        self._thread.start()

    def _spin(self) -> None:
        # The executor raises when the context is shut down, which is how it ends.
        with suppress(self.ros.rclpy.executors.ExternalShutdownException):
            self._executor.spin()

    def topic(self, name: str) -> str:
        """Return the full name of a topic, `/robot1/scan` for `scan` in the namespace `robot1`."""
        return str(self.node.resolve_topic_name(name))

    def frame(self, name: str) -> str:
        """Return the name of a frame, `robot1/odom` for `odom` in the namespace `robot1`.

        All robots share one tree of transforms, so their frames have names of their own. A name
        with a leading slash is that of a frame of all robots, and is returned without the slash.
        """
        if name.startswith("/") or self.namespace is None:
            return name.removeprefix("/")
        return f"{self.namespace}/{name}"

    def now(self) -> float:
        """Return the time of the node's clock [s], simulated time if it uses that."""
        return float(self.node.get_clock().now().nanoseconds) * 1e-9

    def instant(self) -> Instant:
        """Return the present moment by the node's clock and by one that does not jump."""
        is_simulated = bool(self.node.get_clock().ros_time_is_active)
        return Instant(self.now(), time.monotonic(), is_simulated)

    def warn_of_clock(self, name: str, stamped: float, at: Instant) -> None:
        """Warn of a stamp [s] that is not believed, see `onboard.drive_clock.Stamps`."""
        ahead = stamped - at.clock
        if not -CLOCK_TOLERANCE <= ahead <= MAX_STEP:
            self.warn(
                f"clock of {name}",
                f"the stamps of {name} differ by {ahead:.1f} s from this clock; accepted: at most "
                f"{CLOCK_TOLERANCE:g} s before it and {MAX_STEP:g} s after it; others count from "
                "their arrival, unless they are later than before",
            )

    def warn(self, kind: str, message: str, *, every: float = QUIET_SECONDS) -> None:
        """Log a warning, at most one of a kind in some seconds."""
        self.num_warnings[kind] += 1
        now = time.monotonic()
        if now - self._warned.get(kind, -math.inf) >= every:
            self._warned[kind] = now
            self.node.get_logger().warning(printable(message))

    def info(self, message: str) -> None:
        """Log a message."""
        self.node.get_logger().info(printable(message))

    def subscribe(
        self,
        kind: Any,
        topic: str,
        handle: Callable[[Any], None],
        *,
        is_kept: bool = False,
        depth: int | None = None,
    ) -> None:
        """Subscribe to a topic; a message that `handle` finds malformed gives a warning.

        With `is_kept` the last message comes too that was published before. `depth` is the number
        of messages that wait. When absent it is 1 of what is kept, and 5 of the rest.
        """

        full = self.topic(topic)

        def take(message: Any) -> None:
            try:
                handle(message)
            # Whatever another node sends must not end this one.
            except (ValueError, TypeError, OverflowError, AttributeError, RecursionError) as error:
                self.warn(f"message of {full}", f"{full}: {' '.join(str(error).split())}")

        quality = self._quality(is_kept, is_input=True, depth=depth)
        self.node.create_subscription(kind, topic, take, quality)

    def publisher(self, kind: Any, topic: str, *, is_kept: bool = False) -> Any:
        """Return a publisher; with `is_kept` late subscribers get the last message."""
        return self.node.create_publisher(kind, topic, self._quality(is_kept, is_input=False))

    def other_publishers(self, topic: str) -> list[str]:
        """Return the names of the other publishers of a topic; another node may have this name."""
        found = [each.node_name for each in self.node.get_publishers_info_by_topic(topic)]
        own = self.node.get_name()
        for each in self.node.publishers:
            if each.topic_name == self.node.resolve_topic_name(topic) and own in found:
                found.remove(own)
        return found

    def other_types(self, topic: str, *, is_published: bool) -> dict[str, str]:
        """Return the types that other nodes publish on a topic, or else listen to.

        Each name, such as `geometry_msgs/msg/Twist`, has the name of one of these nodes.
        """
        node = self.node
        find = (
            node.get_publishers_info_by_topic
            if is_published
            else node.get_subscriptions_info_by_topic
        )
        own = node.get_name(), node.get_namespace()
        return {
            str(each.topic_type): str(each.node_name)
            for each in find(self.topic(topic))
            if (each.node_name, each.node_namespace) != own
        }

    def wait_for(self, topic: str | None) -> None:
        """Wait until the nodes that are there have been found.

        Nodes are found at different times on a busy machine, so the wait is for a publisher of a
        topic that another node publishes for sure, and a little longer. The topic is None where
        none is known.
        """
        while time.monotonic() - self._began < MOST_DISCOVERY_SECONDS:
            is_found = topic is None or self.other_publishers(topic)
            if is_found and time.monotonic() - self._began >= DISCOVERY_SECONDS:
                return
            time.sleep(0.1)

    def service(self, name: str, handle: Callable[[], str]) -> None:
        """Offer a `std_srvs/Trigger`, if that package is there.

        `handle` does it and returns a message; a `ValueError` is a failure.
        """
        if self.ros.Trigger is None:
            return

        def serve(_: Any, response: Any) -> Any:
            try:
                response.success, response.message = True, handle()
            except ValueError as error:
                response.success, response.message = False, str(error)
            return response

        self.node.create_service(self.ros.Trigger, name, serve)

    def manage(self, handle: Callable[[str], None]) -> None:
        """Let the transitions of a managed node call a function with their names.

        The names are `configure`, `activate`, `deactivate`, `cleanup` and `shutdown`. It runs in
        the thread of the link. What it finds wrong, a `ValueError`, is a failure with a warning.
        """
        lifecycle = importlib.import_module("rclpy.lifecycle")
        results = importlib.import_module("rclpy.lifecycle.node").TransitionCallbackReturn

        def change(name: str) -> Any:
            try:
                handle(name)
            except ValueError as error:
                self.warn("lifecycle", f"{name}: {error}")
                return results.FAILURE
            return results.SUCCESS

        names = ("configure", "activate", "deactivate", "cleanup", "shutdown")
        calls = {f"on_{name}": lambda _, __, name=name: change(name) for name in names}
        self.node.add_managed_entity(type("Transitions", (lifecycle.ManagedEntity,), calls)())

    def repeat(self, period: float, handle: Callable[[], None]) -> Callable[[], object]:
        """Call a function each period [s] of real time; return a function that ends it."""
        clock = importlib.import_module("rclpy.clock")
        steady = clock.Clock(clock_type=clock.ClockType.STEADY_TIME)
        timer = self.node.create_timer(period, handle, clock=steady)
        return lambda: self.node.destroy_timer(timer)

    def wake(self) -> None:
        """Let the thread of the link look at what another thread has finished."""
        self._executor.wake()

    def _quality(self, is_kept: bool, *, is_input: bool, depth: int | None = None) -> Any:
        qos = self.ros.rclpy.qos
        if is_kept:
            return qos.QoSProfile(
                depth=1 if depth is None else depth,
                reliability=qos.ReliabilityPolicy.RELIABLE,
                durability=qos.DurabilityPolicy.TRANSIENT_LOCAL,
            )
        # Best effort hears reliable publishers as well, and never waits for what is old.
        reliability = qos.ReliabilityPolicy
        return qos.QoSProfile(
            depth=5 if depth is None else depth,
            reliability=reliability.BEST_EFFORT if is_input else reliability.RELIABLE,
        )

    def close(self) -> None:
        """Stop spinning, and remove the node from the network."""
        self._executor.shutdown(timeout_sec=1.0)
        if self._thread.ident is not None:
            self._thread.join(timeout=2.0)
        self.node.destroy_node()


@contextmanager
def connect(name: str, namespace: str | None = None, *, is_managed: bool = False) -> Iterator[Link]:
    """Connect to ROS 2 for the duration of a block, with a node as of `Link`.

    It raises a `ValueError` if ROS 2 is missing or cannot be started.
    """
    ros = import_ros()
    # Importing the package does not import these modules.
    import importlib

    for module in ("rclpy.action", "rclpy.executors", "rclpy.qos", "rclpy.signals", "rclpy.task"):
        importlib.import_module(module)
    try:
        # Ctrl-C is this program's, which stops the robot before it leaves the network.
        ros.rclpy.init(args=[], signal_handler_options=ros.rclpy.signals.SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise ValueError(f"ROS 2 cannot be started: {' '.join(str(error).split())}") from None
    try:
        link = Link(name, ros, namespace, is_managed=is_managed)
        try:
            yield link
        finally:
            link.close()
    finally:
        if ros.rclpy.ok():
            ros.rclpy.shutdown()
