"""The guard of a quadrotor in a volume, in the closed loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.kinds import CAMERA, QUADROTOR, volume

import jaxplore as jx
from jaxplore.control import MotionGuard
from jaxplore.control.stops import REASONS
from jaxplore.control.validation import StopCheck
from jaxplore.maps import MovingObstacle
from jaxplore.parts import MovingObstacles
from jaxplore.robot.volume_points import MOVER_SPEED, volume_points
from jaxplore.sensing.volume import VolumeScan
from jaxplore.simulation.run import record_run

pytestmark = pytest.mark.long

DROPOUT = (1.2, 2.4)
"""Time without scans [s]."""
PEOPLE = MovingObstacles([MovingObstacle(((5.4, 1.0), (5.4, 2.4)), 0.4, 0.25)])
"""Somebody who walks to and fro across the room."""


@pytest.fixture(scope="module")
def run():
    given = volume(truths=[PEOPLE]).with_disturbances([jx.Faults(scan_dropout=DROPOUT)])
    guarded = given.with_guard(MotionGuard(check=StopCheck(0.0, evades=True)))
    flying = jx.volume_explorer(QUADROTOR, horizon=20, num_samples=128, has_moving_obstacles=True)
    return record_run(flying, guarded, 160, key=jax.random.key(0), num_trajectories=0)


def test_it_stands_while_its_scans_are_old(run) -> None:
    # The last scan is that of 1.1 s, and may be 0.3 s old. The next one comes at 2.4 s.
    stop = np.asarray(run.records.stop)
    np.testing.assert_array_equal(np.flatnonzero(stop), np.arange(29, 48))
    assert {REASONS[each] for each in stop[29:48]} == {"the scan is old"}
    speed = np.linalg.norm(np.asarray(run.records.state)[:, 3:6], axis=1)
    assert speed[:29].max() > 0.3
    assert speed[46] < 0.05
    metrics = run.metrics()
    assert metrics.stops == {"the scan is old": 1}
    assert metrics.stopped_steps == 19
    assert ("stopped", "19 steps") in metrics.rows()


def test_it_explores_on_without_contact(run) -> None:
    metrics = run.metrics()
    assert metrics.collisions == 0
    assert metrics.coverage > 0.5
    assert float(np.linalg.norm(np.asarray(run.records.state)[60:, 3:6], axis=1).max()) > 0.5


def test_points_are_the_shortest_of_neighbouring_rays() -> None:
    rng = np.random.default_rng(3)
    number = CAMERA.directions.shape[1]
    ranges = rng.uniform(0.5, CAMERA.max_range, number).astype(np.float32)
    ranges[::5] = CAMERA.max_range
    # A ray that ends early without a return has met what moves.
    is_return = (ranges < CAMERA.max_range) & (rng.random(number) < 0.7)
    scan = VolumeScan(jnp.asarray(ranges), jnp.asarray(is_return))
    given = volume()
    belief = given.init(None)[1]
    state = QUADROTOR.at_pose(1.2, 2.0, 0.5, -1.2)
    found = volume_points(
        belief, [CAMERA], [scan], state, state, jnp.float32(0.4), jnp.float32(0.1)
    )
    cos, sin = np.cos(0.5), np.sin(0.5)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    ways = CAMERA.directions.astype(np.float64)
    ends = np.array([1.2, 2.0, 1.2]) + (turn @ (ranges * ways)).T
    for group, (point, is_point, speed) in enumerate(
        zip(found.points, found.is_point, found.speeds, strict=True)
    ):
        own = np.arange(4 * group, min(4 * group + 4, number))
        met = own[ranges[own] < CAMERA.max_range]
        assert bool(is_point) == bool(len(met))
        if len(met):
            nearest = met[np.argmin(ranges[met])]
            np.testing.assert_allclose(point, ends[nearest], atol=1e-4)
            assert float(speed) == pytest.approx(0.0 if is_return[nearest] else MOVER_SPEED)
    # Nothing is known to be free but the ball of the robot, so nothing contradicts the map.
    assert float(found.misfit) == 0.0
