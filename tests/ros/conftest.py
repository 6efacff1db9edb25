"""Programs that talk to each other in the messages of nav2, which no wheel has."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from tests.ros.test_field import ros_environment

HERE = Path(__file__).parent


@pytest.fixture(scope="session")
def run_with_nav2(tmp_path_factory):
    """Return a function that runs a program of this folder, and returns what it has seen.

    Its types of bond and nav2_msgs are made from the interfaces beside this file.
    """
    types = tmp_path_factory.mktemp("interfaces")
    line = [sys.executable, str(HERE / "interfaces.py"), str(types)]
    made = subprocess.run(line, capture_output=True, text=True, check=False)
    assert made.returncode == 0, made.stderr[-4000:]

    def run(program: str, *arguments: str) -> dict:
        environment = ros_environment()
        paths = [environment["PYTHONPATH"], str(types)]
        environment["PYTHONPATH"] = os.pathsep.join(paths)
        libraries = [str(types / "lib"), environment.get("LD_LIBRARY_PATH", "")]
        environment["LD_LIBRARY_PATH"] = os.pathsep.join(libraries)
        done = subprocess.run(
            [sys.executable, str(HERE / program), *arguments],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        lines = [line for line in done.stdout.splitlines() if line.startswith("SEEN ")]
        assert lines, done.stdout[-6000:] + done.stderr[-6000:]
        return json.loads(lines[0].removeprefix("SEEN "))

    return run
