import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest

from jaxplore import Lidar, OccupancyGrid, PoseInformation, TrajectoryInformation
from jaxplore.information import EntropyFan
from jaxplore.information.batches import BATCH, over_poses

GRID = OccupancyGrid(np.full((9, 9), 0.3), 0.1)


@pytest.mark.parametrize("count", [1, BATCH, BATCH + 1, 2 * BATCH + 3])
def test_many_poses_are_one_each(count: int) -> None:
    position = jnp.arange(2.0 * count).reshape(count, 2)
    heading = jnp.arange(float(count))
    found = over_poses(lambda at, yaw: at[0] - 3.0 * at[1] + yaw, position, heading)
    np.testing.assert_allclose(found, position[:, 0] - 3.0 * position[:, 1] + heading)


@pytest.mark.parametrize(
    ("position", "heading"), [((3,), ()), ((2,), (1,)), ((3, 2), (2,)), ((3, 2), ()), ((), ())]
)
def test_other_shapes_are_named(
    position: tuple[int, ...], heading: tuple[int, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    # The type checks of the test run refuse them first, with another error.
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    for gain in (PoseInformation(Lidar(4, 0.5)), EntropyFan(Lidar(4, 0.5))):
        with pytest.raises(ValueError, match=r"position has shape .*accepted: \(2,\) and \(\)"):
            gain(GRID, jnp.zeros(position), jnp.zeros(heading))


def test_other_shapes_of_a_trajectory_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)
    trajectory = TrajectoryInformation(PoseInformation(Lidar(4, 0.5)))
    with pytest.raises(ValueError, match=r"positions has shape \(3, 3\); accepted: \(T, 2\)"):
        trajectory(GRID, jnp.zeros((3, 3)))
    with pytest.raises(ValueError, match=r"positions has shape \(0, 2\)"):
        trajectory(GRID, jnp.zeros((0, 2)))
    with pytest.raises(ValueError, match=r"headings has shape \(2,\); accepted: \(3,\)"):
        trajectory(GRID, jnp.zeros((3, 2)), jnp.zeros(2))
