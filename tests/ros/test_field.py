"""The node and a simulated robot in two processes, over real DDS."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from jaxplore.simulation.run import Run

HERE = Path(__file__).parent
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(
        importlib.util.find_spec("rclpy") is None, reason="ROS 2 (rclpy) is not installed"
    ),
]


def ros_environment() -> dict[str, str]:
    """Processes of this test find only each other, and not those of another worker."""
    domain = str(1 + os.getpid() % 100)
    source = str(HERE.parents[1] / "src")
    return {
        **os.environ,
        "ROS_DOMAIN_ID": domain,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONPATH": os.pathsep.join([source, os.environ.get("PYTHONPATH", "")]),
    }


@pytest.fixture(scope="module")
def field(tmp_path_factory):
    folder = tmp_path_factory.mktemp("field")
    done = subprocess.run(
        [sys.executable, str(HERE / "field_program.py"), str(folder)],
        env=ros_environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    lines = [line for line in done.stdout.splitlines() if line.startswith("SEEN ")]
    assert lines, done.stdout[-3000:] + done.stderr[-6000:]
    return folder, json.loads(lines[0].removeprefix("SEEN "))


def test_the_robot_explores_without_a_contact(field) -> None:
    _, seen = field
    assert seen["state"]["coverage"] > 0.05
    assert seen["state"]["contacts"] == 0


def test_nothing_compiles_while_the_node_drives(field) -> None:
    assert field[1]["compiled"] == 0


def test_a_second_node_refuses_in_one_line(field) -> None:
    code, line = field[1]["second"]
    assert code == 2
    assert line.startswith("jaxplore: ")
    assert "another" in line


def test_a_node_that_dies_leaves_the_robot_to_its_watchdog(field) -> None:
    assert field[1]["state"]["watchdog_stops"] >= 1


def test_a_simulated_clock_may_begin_anew_and_pause(field) -> None:
    """The drive went on each time, and `test_the_robot_explores_without_a_contact` has the rest."""
    first, back, paused = field[1]["clock"]
    # From the time of the day to that of a simulator.
    assert first.startswith("the clock jumped by ")
    assert float(back.split()[4]) == pytest.approx(-30.0, abs=2.0)
    assert paused == "the simulated clock stands still"


def test_ctrl_c_stops_the_robot_and_keeps_the_drive(field) -> None:
    folder, seen = field
    code, text = seen["drive"]
    assert code == 130, text
    assert seen["last_command"] == [0.0, 0.0, 0.0]
    assert "stopped" in text
    # The order that no node knows gave a warning.
    assert "command is 'dance'; accepted: start, explore, pause, return, save, stop" in text
    run = Run.load(folder / "drive")
    assert run.metrics.path_length > 0.2
    assert (folder / "drive" / "map.png").exists()
    header, *rows = (folder / "drive" / "commands.csv").read_text().splitlines()
    assert header == "time,vx,vy,omega,mode,reason"
    assert any(",paused,paused" in row for row in rows)
    assert not (folder / "first").exists()


def test_belief_and_plan_are_published(field) -> None:
    seen = field[1]
    rows, columns, least = seen["map"]
    assert rows == columns == 300
    # Unknown cells are -1.
    assert least[0] == -1
    assert seen["plan"] > 5


def test_another_program_drives_to_the_goals_that_the_node_chooses(field) -> None:
    code, text, number = field[1]["goals"]
    assert code == 130, text
    assert number >= 2
    assert f"Done after {number} goals: stopped" in text
    assert field[1]["grown"] > 0.0


def test_the_robot_is_judged_by_its_run_folder(field) -> None:
    folder, seen = field
    assert seen["robot"][0] == 130, seen["robot"][1]
    metrics = Run.load(folder / "robot").metrics
    assert metrics.collisions == 0
    assert metrics.coverage == pytest.approx(seen["state"]["coverage"], abs=0.2)
