"""Namespaces: two robots in one graph over real DDS, and the names that ROS accepts."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore.onboard.drive_clock import Instant
from jaxplore.ros.inputs import subscribe_pose
from jaxplore.settings.node import NodeSettings, part_node
from jaxplore.settings.ros_names import MOST_CHARACTERS, check_namespace

HERE = Path(__file__).parent
ros = pytest.mark.skipif(
    importlib.util.find_spec("rclpy") is None, reason="ROS 2 (rclpy) is not installed"
)
# Names as ROS has them, and all that may be wrong with them.
NAMES = st.text(st.sampled_from("aZ_19//~- é{"), max_size=12)


@pytest.fixture(scope="module")
def seen():
    done = subprocess.run(
        [sys.executable, str(HERE / "namespace_program.py")],
        env={
            **os.environ,
            "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "PYTHONPATH": str(HERE.parents[1] / "src"),
        },
        capture_output=True,
        text=True,
        check=False,
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith("SEEN ")]
    assert lines, done.stdout[-3000:] + done.stderr[-6000:]
    return json.loads(lines[0].removeprefix("SEEN "))


@ros
def test_each_robot_has_its_own_scans_poses_and_commands(seen) -> None:
    assert seen["ranges"] == [[1.0], [2.0]]
    assert seen["positions"] == [[10.0], [20.0]]
    assert seen["commands"] == [[0.1], [0.2]]
    assert seen["orders"] == [["pause"], []]


@ros
def test_frames_begin_with_the_namespace(seen) -> None:
    assert seen["frames"] == [
        ["robot1/base_scan", "robot1/odom"],
        ["fleet/robot2/base_scan", "fleet/robot2/odom"],
    ]
    assert seen["stamped"] == ["fleet/robot2/base_link"]
    assert seen["tree"] == ["fleet/robot2/map", "fleet/robot2/odom"]


@ros
def test_the_map_and_the_pose_in_it_have_its_frame_whatever_the_odometry_says(seen) -> None:
    assert seen["place"] == pytest.approx([1.0, 2.0, 0.5])
    assert seen["map"] == ["robot1/map", "robot1/map"]


@ros
def test_the_type_of_commands_is_found_from_the_graph(seen) -> None:
    assert seen["types"] == ["twist", "twist_stamped"]


@ros
def test_no_topic_and_no_service_is_outside_of_the_namespaces(seen) -> None:
    # The tree of transforms is shared, and the rest is of ROS itself.
    shared = {"/tf", "/tf_static", "/rosout", "/parameter_events"}
    names = [
        *(name for name in seen["topics"] if name not in shared),
        *(name for name in seen["services"] if not name.startswith("/watcher/")),
    ]
    assert [each for each in names if not each.startswith(("/robot1/", "/fleet/robot2/"))] == []
    assert {"/robot1/scan", "/robot1/odom", "/robot1/cmd_vel", "/robot1/map"} <= set(names)
    assert "/fleet/robot2/jaxplore/pause" in names


@ros
def test_a_second_node_of_a_namespace_is_refused(seen) -> None:
    assert seen["second"].startswith("/robot1/cmd_vel has another publisher, jaxplore; accepted: ")


@ros
@settings(max_examples=300, deadline=None)
@given(NAMES)
def test_names_are_those_that_ros_accepts(name) -> None:
    from rclpy.exceptions import NameValidationException
    from rclpy.validate_namespace import validate_namespace
    from rclpy.validate_topic_name import validate_topic_name

    def is_accepted(check) -> bool:
        try:
            check()
        except (NameValidationException, ValueError):
            return False
        return True

    absolute = name if name.startswith("/") else f"/{name}"
    # The root is a namespace of ROS, but none that tells robots apart.
    by_ros = name not in ("", "/") and is_accepted(lambda: validate_namespace(absolute))
    assert is_accepted(lambda: check_namespace("namespace", name)) == by_ros
    # Left out is what ROS takes and nobody means: braces, and ~ without a slash, to which ROS
    # appends the rest of the name.
    if "{" not in name and not re.match("~(?!/)", name):
        by_ros = is_accepted(lambda: validate_topic_name(name))
        assert is_accepted(lambda: part_node({"node": {"scan_topic": name}})) == by_ros


def test_the_longest_namespace_leaves_room_for_the_longest_topic() -> None:
    most = "n" * MOST_CHARACTERS
    assert NodeSettings(namespace=f"/{most[1:]}", scan_topic=most).namespace == most[1:]
    with pytest.raises(ValueError, match=f"at most {MOST_CHARACTERS} characters"):
        check_namespace("namespace", f"{most}n")
    # rmw.h: RMW_TOPIC_MAX_NAME_LENGTH is 255 without the 8 characters of a prefix.
    assert len(f"/{most}/{most}") <= 247


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["node", "--namespace", "a//b"], "setting node.namespace is 'a//b'; accepted: "),
        (["node", "--namespace", "robot-1"], "setting node.namespace is 'robot-1'; accepted: "),
        (["node", "--set", "node.namespace=1st"], "setting node.namespace is '1st'; accepted: "),
        (["node", "--namespace", ""], "setting node.namespace is ''; accepted: "),
        (["robot", "office", "--namespace", ""], "--namespace is ''; accepted: "),
        (["robot", "office", "--namespace", "robot1/"], "--namespace is 'robot1/'; accepted: "),
        (["node", "--set", "node.scan_topic=a b"], "setting node.scan_topic is 'a b'; accepted: "),
    ],
)
def test_names_that_ros_refuses_are_one_line(arguments, said, fails) -> None:
    assert fails(*arguments).startswith(f"jaxplore: {said}")


@pytest.mark.parametrize(
    ("frames", "found"),
    [
        ({}, ("robot1/odom", "robot1/base_link")),
        ({"world_frame": "/map"}, ("map", "robot1/base_link")),
    ],
)
def test_transforms_are_looked_up_under_the_namespace(frames, found) -> None:
    from jaxplore.ros.link import Link

    class Deaf:
        """A connection that only knows its namespace, and keeps what is subscribed to."""

        namespace, ros, handles = "robot1", SimpleNamespace(TFMessage="a class"), {}
        frame = Link.frame

        def topic(self, name):
            return name

        def instant(self):
            return Instant(1.0)

        def warn_of_clock(self, _, stamped, at):
            assert stamped == at.clock

        def subscribe(self, kind, topic, handle, **_):
            self.handles[topic] = handle

    link, taken = Deaf(), []
    subscribe_pose(link, NodeSettings(pose_type="tf", namespace="robot1", **frames), taken.append)

    def transform(parent, child, x):
        rotation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
        translation = SimpleNamespace(x=x, y=0.0, z=0.0)
        place = SimpleNamespace(translation=translation, rotation=rotation)
        stamp = SimpleNamespace(sec=1, nanosec=0)
        header = SimpleNamespace(frame_id=parent, stamp=stamp)
        return SimpleNamespace(header=header, child_frame_id=child, transform=place)

    others = ("robot2/odom", "robot2/base_link"), ("odom", "base_link"), ("map", "base_link")
    message = SimpleNamespace(transforms=[transform(*each, 1.0) for each in others])
    link.handles["/tf"](message)
    assert taken == []
    message.transforms.append(transform(*found, 3.0))
    link.handles["/tf"](message)
    (pose,) = taken
    assert pose.pose[0] == 3.0
    assert pose.frame == found[0]
