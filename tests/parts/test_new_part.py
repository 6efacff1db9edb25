"""A part of which nothing in the package knows is one folder, here a file, and one row."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

HERE = Path(__file__).parent
PAGE = Path(__file__).parents[2] / "docs" / "settings_page.py"
FILE = """\
office: {width: 8.0, height: 7.0}
time_limit: 3.0
lidar: {num_beams: 45, max_range: 3.0}
controller: {num_samples: 64, horizon: 15}
fields: {num_directions: 4, node_spacing: 0.4}
priority: {box: [0.0, 0.0, 8.0, 7.0], worth: 2.5}
"""

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("new_part")


@pytest.fixture(scope="module")
def told(folder: Path) -> dict:
    """Return what the commands say, in a process in which the row is there from the beginning."""
    (folder / "priority.yaml").write_text(FILE)
    command = [sys.executable, str(HERE / "new_part_program.py"), str(PAGE)]
    environment = os.environ | {"JAXPLORE_CACHE": "off"}
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=folder, env=environment
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_its_settings_are_explained_checked_and_completed(told: dict) -> None:
    assert "### priority (exploration)\n\nA rectangle that is seen first; none" in told["page"]
    assert "| `priority.worth` | what a cell is worth. | nat | `1.0` |" in told["page"]
    assert {"priority.box=", "priority.worth="} <= set(told["completed"])
    code, shown, _ = told["explained"]
    assert code == 0
    assert "what a cell is worth" in shown
    code, shown, _ = told["defaults"]
    assert yaml.safe_load(shown)["priority"] is None
    assert "# a rectangle that is seen first" in shown
    code, _, message = told["refused"]
    assert (code, "setting priority.worth is 0" in message) == (2, True)
    code, _, message = told["elsewhere"]
    assert (code, "priority" in message) == (2, True)


@pytest.mark.parametrize(("command", "robots"), [("run", 1), ("fleet", 2)])
def test_it_runs_from_a_settings_file(told: dict, folder: Path, command, robots) -> None:
    code, shown, message = told[command]
    assert code == 0, message
    assert "cells left" in shown
    out = folder / {"run": "alone", "fleet": "fleet"}[command]
    metrics = json.loads((out / "metrics.json").read_text())
    assert metrics["priority"]["seen"] > 0
    given = yaml.safe_load((out / "settings.yaml").read_text())
    assert given["priority"] == {"box": [0.0, 0.0, 8.0, 7.0], "worth": 2.5}
    assert (given["fleet"] or {"robots": 1})["robots"] == robots
