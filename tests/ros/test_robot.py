"""The simulated robot's transforms, with plain objects for messages: `tf2_msgs` is no wheel."""

from types import SimpleNamespace

import numpy as np
import pytest

from jaxplore import Lidar
from jaxplore.onboard.simulated_robot import RobotMeasurement
from jaxplore.parts import Battery, TrueBattery
from jaxplore.ros.messages import battery_share_of
from jaxplore.ros.robot import RobotNode
from jaxplore.ros.transforms import Transforms


class Plain:
    """A message whose fields come into being when they are read or set."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        self.__dict__[name] = Plain()
        return self.__dict__[name]


class FakeLink:
    """Keeps what is published by topic; names of frames begin with the namespace."""

    def __init__(self, **kinds) -> None:
        names = "LaserScan Odometry OccupancyGrid PoseWithCovarianceStamped String Twist TFMessage"
        more = ("BatteryState", "TransformStamped", "TwistStamped")
        every = dict.fromkeys((*names.split(), *more), Plain)
        self.ros = SimpleNamespace(**{**every, **kinds})
        self.sent, self.heard, self.warnings = {}, {}, []

    def publisher(self, kind, topic, *, is_kept=False):
        sent = self.sent.setdefault(topic, [])
        return SimpleNamespace(publish=sent.append, is_kept=is_kept)

    def subscribe(self, kind, topic, handle) -> None:
        pass

    def frame(self, name) -> str:
        return f"robot1/{name}"

    def topic(self, name) -> str:
        return f"/{name}"

    def now(self) -> float:
        return 12.5

    def other_types(self, topic, *, is_published):
        assert (topic, is_published) == ("cmd_vel", True)
        return self.heard

    def warn(self, kind, message) -> None:
        self.warnings.append(message)


def robot_node(link, *, has_map, truths=(), **state):
    sensors = (Lidar(num_beams=4, max_range=5.0),)
    scenario = SimpleNamespace(sensors=sensors, steps_per_scan=1, truths=truths)
    state = SimpleNamespace(truths=state)
    robot = SimpleNamespace(scenario=scenario, period=0.1, mount=np.zeros(3), state=state)
    return RobotNode(link, robot, command_type="twist", has_map=has_map)


ODOMETRY, TRUTH = np.array([3.0, -1.0, 0.3]), np.array([2.0, 1.5, -2.9])


@pytest.mark.parametrize("has_map", [True, False])
def test_the_chain_leads_to_the_lidar_and_from_the_map_to_the_truth(has_map) -> None:
    link = FakeLink()
    node = robot_node(link, has_map=has_map)
    node._publish(RobotMeasurement(ODOMETRY, np.zeros(3), None, TRUTH), 12.5)
    transforms = Transforms()
    for topic, is_static in (("/tf", False), ("/tf_static", True)):
        (message,) = link.sent[topic]
        for each in message.transforms:
            transforms.add(each, is_static=is_static)
    found = transforms.pose("robot1/odom", "robot1/base_scan")
    assert found.time == 12.5
    np.testing.assert_allclose(found.pose, ODOMETRY, atol=1e-12)
    found = transforms.pose("robot1/map", "robot1/base_scan")
    assert (found is not None) == has_map
    if has_map:
        np.testing.assert_allclose(found.pose, TRUTH, atol=1e-12)
        (pose,) = link.sent["pose"]
        assert pose.header.frame_id == "robot1/map"


def test_without_the_package_of_transforms_the_rest_is_published() -> None:
    link = FakeLink(TFMessage=None)
    node = robot_node(link, has_map=False)
    node._publish(RobotMeasurement(ODOMETRY, np.zeros(3), None, TRUTH), 12.5)
    assert {topic for topic, sent in link.sent.items() if sent} == {"odom"}


def test_commands_of_another_type_are_named() -> None:
    link = FakeLink()
    node = robot_node(link, has_map=False)
    link.heard = {"geometry_msgs/msg/Twist": "node"}
    node._warn_of_types()
    assert link.warnings == []
    link.heard = {"geometry_msgs/msg/TwistStamped": "nav2"}
    node._warn_of_types()
    (said,) = link.warnings
    assert said.startswith("nav2 publishes geometry_msgs/msg/TwistStamped on /cmd_vel, which does")


def test_the_charge_of_a_battery_is_published_as_a_share() -> None:
    link, battery = FakeLink(), TrueBattery(Battery(capacity=2.0))
    charge = SimpleNamespace(energy=np.float32(0.25 * 2.0 * 3600.0))
    node = robot_node(link, has_map=False, truths=(battery,), battery=charge)
    node._publish_battery(12.5)
    (message,) = link.sent["battery_state"]
    assert battery_share_of(message) == pytest.approx(0.25)
    assert message.present is True
    assert message.header.frame_id == "robot1/base_link"
    without = FakeLink()
    robot_node(without, has_map=False)._publish_battery(12.5)
    assert "battery_state" not in without.sent
