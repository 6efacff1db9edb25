"""A node that is killed in the middle of an exploration goes on with its session, over real DDS."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest
from tests.ros.test_field import ros_environment

HERE = Path(__file__).parent
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(
        importlib.util.find_spec("rclpy") is None, reason="ROS 2 (rclpy) is not installed"
    ),
]


@pytest.fixture(scope="module")
def seen(tmp_path_factory):
    folder = tmp_path_factory.mktemp("session")
    done = subprocess.run(
        [sys.executable, str(HERE / "session_program.py"), str(folder)],
        env=ros_environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith("SEEN ")]
    assert lines, done.stdout[-3000:] + done.stderr[-6000:]
    print(lines[0])
    return json.loads(lines[0].removeprefix("SEEN "))


def test_the_map_goes_on_from_where_it_was(seen) -> None:
    assert seen["after"][0] > 0.95 * seen["before"][0] > 20.0
    assert seen["end"][0] > seen["after"][0]
    assert seen["contacts"] == 0


def test_the_robot_says_that_it_finds_itself(seen) -> None:
    assert any(each.startswith("finding itself on the map") for each in seen["reasons"])


def test_ctrl_c_keeps_the_session_and_the_drive(seen) -> None:
    assert seen["second"][0] == 130, seen["second"][1]


def test_a_second_node_and_other_settings_are_refused_in_one_line(seen) -> None:
    for name, said in (("third", "another process"), ("other", "node.map_size")):
        code, line = seen[name]
        assert code == 2
        assert line.startswith("jaxplore: ")
        assert said in line
    assert seen["is_same"]
