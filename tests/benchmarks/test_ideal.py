"""A point without dynamics: it explores in the closed loop and wastes no way."""

import jax
import numpy as np
import pytest
from benchmarks.ideal import Point, nearest_cluster

from jaxplore import Lidar, OccupancyGrid, Perception
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.run import simulate

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def scenario() -> ExplorationScenario:
    """Two rooms of 3 m with a door, for a point with a lidar of 2 m."""
    solid = np.zeros((34, 64), np.float32)
    solid[[0, -1]] = solid[:, [0, -1]] = solid[:, 32] = 1.0
    solid[14:20, 32] = 0.0
    lidar = Lidar(num_beams=60, max_range=2.0, range_noise=0.0)
    robot = Point()
    return ExplorationScenario(
        OccupancyGrid(solid, 0.1),
        robot,
        lidar,
        (1.0, 1.6, 0.0),
        perception=Perception(lidar, 0.1, robot.radius, num_directions=8),
        control_rate=10.0,
        target_coverage=0.97,
    )


def test_a_point_explores_at_full_speed(scenario: ExplorationScenario) -> None:
    run = simulate(
        nearest_cluster(scenario), scenario, 300, key=jax.random.key(0), num_trajectories=2
    )
    metrics, positions = run.metrics, run.recording.positions
    assert metrics.coverage >= 0.97
    assert metrics.collisions == 0
    moves = np.hypot(*np.diff(positions, axis=0).T)
    # Full speed along the axes and the diagonals, and never more.
    assert moves.max() <= 0.1 + 1e-5
    assert np.median(moves) > 0.099
    # It ends in the other room, 3 m away at least.
    assert positions[-1, 0] > 3.3
    assert metrics.path_length >= np.hypot(*(positions[-1] - positions[0]))
