"""What tests share."""

import os
from pathlib import Path

import equinox as eqx
import hypothesis
import jax.numpy as jnp
import pytest

import jaxplore
from jaxplore.cli import main

# No test depends on a duration: the machine is shared, and the first call compiles.
hypothesis.settings.register_profile(
    "jaxplore", deadline=None, max_examples=50, derandomize=True, print_blob=True
)
hypothesis.settings.load_profile("jaxplore")


@pytest.fixture(scope="session")
def ros_maps() -> Path:
    """Return the folder of real ROS maps, which the repository does not copy."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "maps"
    folder = Path(os.environ.get("JAXPLORE_MAPS", beside))
    if not folder.is_dir():
        pytest.skip(f"no ROS maps at {folder}: set JAXPLORE_MAPS")
    return folder


@pytest.fixture
def fails(capsys: pytest.CaptureFixture[str]):
    """Return what runs a command that must fail as users' mistakes do, one line, exit code 2 and
    nothing written, and returns the line."""

    def run(*arguments: str) -> str:
        before = sorted(os.listdir())
        with pytest.raises(SystemExit) as exit_:
            main(arguments)
        captured = capsys.readouterr()
        assert exit_.value.code == 2
        assert captured.out == ""
        assert captured.err.startswith("jaxplore: ")
        assert captured.err.count("\n") == 1
        assert sorted(os.listdir()) == before
        return captured.err

    return run


@pytest.fixture(scope="session")
def empty_belief():
    """Return a belief of a free map, for controllers whose costs do not read it."""
    lidar = jaxplore.Lidar(num_beams=8, max_range=1.0)
    perception = jaxplore.Perception(lidar, 0.5, 0.2, num_directions=4)
    grid = jaxplore.OccupancyGrid(jnp.zeros((8, 8)), 0.5)
    return eqx.filter_jit(perception.init)(grid, jnp.asarray([2.0, 2.0, 0.0]))
