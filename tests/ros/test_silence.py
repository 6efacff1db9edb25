"""A robot that is gone, and commands of the type that it listens to, without ROS."""

from collections import Counter
from types import SimpleNamespace

import numpy as np
import pytest

from jaxplore.onboard.options import Command, Mode
from jaxplore.ros.command_publisher import COMMAND_TYPES, CommandPublisher
from jaxplore.ros.inputs import GONE_SECONDS, Silence
from jaxplore.settings.node import NodeSettings


class FakeLink:
    """Keeps warnings, and the publishers that are there."""

    def __init__(self, **heard) -> None:
        self.warnings, self.infos, self.heard, self.publishers = [], [], heard, []
        kinds = {
            "Twist": lambda: plain("linear", "angular"),
            "TwistStamped": lambda: SimpleNamespace(
                header=plain("stamp"), twist=plain("linear", "angular")
            ),
        }
        self.ros = SimpleNamespace(**kinds)
        self.node = SimpleNamespace(destroy_publisher=self.publishers.remove)

    def warn(self, kind, message, **_) -> None:
        self.warnings.append(message)

    def info(self, message) -> None:
        self.infos.append(message)

    def topic(self, name) -> str:
        return f"/{name}"

    def frame(self, name) -> str:
        return name

    def now(self) -> float:
        return 1.5

    def other_types(self, topic, *, is_published):
        assert (topic, is_published) == ("cmd_vel", False)
        return {COMMAND_TYPES.get(kind, kind): node for kind, node in self.heard.items()}

    def publisher(self, kind, topic):
        sent = []
        self.publishers.append(SimpleNamespace(kind=kind, sent=sent, publish=sent.append))
        return self.publishers[-1]


def plain(*names):
    return SimpleNamespace(**{name: SimpleNamespace() for name in names})


COMMAND = Command(np.array([0.4, 0.0, -0.2]), Mode.DRIVING, "", None)


def test_the_type_of_commands_is_that_of_a_robot_that_comes_late() -> None:
    link = FakeLink()
    commands = CommandPublisher(link, NodeSettings())
    commands.match()
    commands.publish(COMMAND)
    (first,) = link.publishers
    assert (commands.type, first.sent[0].linear.x) == ("twist", 0.4)
    link.heard["twist_stamped"] = "base"
    commands.match()
    commands.publish(COMMAND)
    (second,) = link.publishers
    (sent,) = second.sent
    assert (sent.twist.angular.z, sent.header.frame_id, sent.header.stamp.sec) == (
        -0.2,
        "base_link",
        1,
    )
    assert link.infos == ["commands on /cmd_vel are geometry_msgs/msg/TwistStamped"]
    # It stays while somebody listens to it, and the other one is named.
    link.heard["twist"] = "echo"
    commands.match()
    assert commands.type == "twist_stamped"
    (said,) = link.warnings
    assert said == (
        "echo listens to geometry_msgs/msg/Twist on /cmd_vel and does not hear this node, which "
        "publishes geometry_msgs/msg/TwistStamped; accepted: geometry_msgs/msg/TwistStamped, or "
        "the setting node.command_type"
    )


@pytest.mark.parametrize("heard", [{"twist_stamped": "base"}, {"std_msgs/msg/String": "odd"}])
def test_a_type_that_was_given_stays_and_the_mismatch_is_named(heard) -> None:
    link = FakeLink(**heard)
    commands = CommandPublisher(link, NodeSettings(command_type="twist"))
    commands.match()
    assert commands.type == "twist"
    (said,) = link.warnings
    assert "does not hear this node, which publishes geometry_msgs/msg/Twist;" in said


def test_a_robot_that_is_gone_is_named_and_in_the_end_given_up(monkeypatch) -> None:
    now, link = [100.0], FakeLink()
    monkeypatch.setattr("jaxplore.ros.inputs.time.monotonic", lambda: now[0])
    silence = Silence(link, ("/scan", "/odom"), 90.0)
    now[0] += GONE_SECONDS - 1.0
    silence.hear("/odom")
    assert (silence.check(), silence.is_long, link.warnings) == ("", False, [])
    now[0] += 2.0
    assert (silence.check(), silence.is_long) == ("", True)
    assert link.warnings == ["nothing has come on /scan for 11 s"]
    silence.hear("/scan")
    assert not silence.is_long
    now[0] += 89.0
    silence.hear("/scan")
    assert silence.check() == "nothing comes on /odom for 91 s: the robot is gone"


def test_without_a_limit_it_waits_for_ever(monkeypatch) -> None:
    now, link = [0.0], FakeLink()
    monkeypatch.setattr("jaxplore.ros.inputs.time.monotonic", lambda: now[0])
    silence = Silence(link, ("/scan",), None)
    now[0] = 1e6
    assert silence.check() == ""
    assert link.warnings == [
        "nothing has come on /scan for 1000000 s; node.give_up_after would end the node"
    ]


def test_reports_come_once_a_minute(monkeypatch) -> None:
    from jaxplore.ros.link import Link

    now, said = [0.0], []
    monkeypatch.setattr("jaxplore.ros.link.time.monotonic", lambda: now[0])
    link = object.__new__(Link)
    link.num_warnings, link._warned = Counter(), {}
    link.node = SimpleNamespace(get_logger=lambda: SimpleNamespace(warning=said.append))
    silence = Silence(link, ("/scan",), None)
    for now[0] in np.arange(0.0, 200.0, 0.5).tolist():
        silence.check()
    assert [each.split(";")[0] for each in said] == [
        f"nothing has come on /scan for {seconds} s" for seconds in (10, 70, 130, 190)
    ]
