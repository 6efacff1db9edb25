"""Strict from day one: shapes and types of the whole package are checked at run time, implicit
dtype promotion is an error, and so is every warning (pyproject.toml)."""

import os
from pathlib import Path

import hypothesis
import jax
import pytest
from jaxtyping import install_import_hook

jax.config.update("jax_numpy_dtype_promotion", "strict")

with install_import_hook("jaxplore", "beartype.beartype"):
    import jaxplore

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


@pytest.fixture(scope="session")
def empty_belief():
    """Return a belief of a free map, for controllers whose costs do not read it."""
    lidar = jaxplore.Lidar(num_beams=8, max_range=1.0)
    perception = jaxplore.Perception(lidar, 0.5, 0.2, num_directions=4)
    grid = jaxplore.OccupancyGrid(jax.numpy.zeros((8, 8)), 0.5)
    return perception.init(grid, jax.numpy.asarray([2.0, 2.0, 0.0]))
