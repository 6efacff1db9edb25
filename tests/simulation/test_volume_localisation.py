"""A quadrotor that does not know its pose explores a volume in the closed loop."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from tests.kinds import CAMERA, QUADROTOR, room, volume, volume_controller

import jaxplore as jx
from jaxplore.localisation import VolumeLocaliser, VolumeOdometry
from jaxplore.robot.volume import level_pose, move_to
from jaxplore.simulation.run import record_run

pytestmark = pytest.mark.long

DRIFT = VolumeOdometry(0.06, 0.02, 0.02, 0.05)
"""More than a camera and an IMU have: the room is small."""


@pytest.fixture(scope="module")
def run():
    given = volume(localiser=VolumeLocaliser(DRIFT), target_coverage=1.0, give_up_after=60.0)
    return record_run(volume_controller(), given, 240, key=jax.random.key(6), num_trajectories=0)


def test_it_finds_its_pose_and_explores(run) -> None:
    metrics = run.metrics()
    assert metrics.collisions == 0
    assert metrics.coverage > 0.9
    assert metrics.ate < 0.2
    assert metrics.ate < 0.5 * metrics.odometry_ate
    assert metrics.rpe < 0.2
    rows = dict(metrics.rows())
    assert rows["trajectory error"].startswith(f"{metrics.ate:.3f} m")
    assert rows["  of odometry"] == f"{metrics.odometry_ate:.2f} m"


def test_its_estimate_is_not_the_truth_and_its_odometry_drifts_away(run) -> None:
    records, true = run.records, run.positions[1:]
    off = np.linalg.norm(np.asarray(records.estimate)[:, :3] - true, axis=1)
    alone = np.linalg.norm(np.asarray(records.reckoned)[:, :3] - true, axis=1)
    assert off[10:].min() > 1e-5
    assert run.metrics().greatest_error == pytest.approx(off.max(), rel=1e-5)
    # Between two scans the estimate follows the odometry.
    assert alone[-40:].mean() > 2.0 * off[-40:].mean()


def test_pictures_show_both_ways(run, tmp_path) -> None:
    figure = run.figures()["slices"]()
    labels = [each.get_text() for each in figure.axes[0].get_legend().get_texts()]
    assert labels == ["true way", "by odometry alone", "estimated way"]
    figure.savefig(tmp_path / "slices.png")


def test_recordings_far_from_the_origin_move_the_poses_too(run) -> None:
    moved = run.move(np.array([500000.0, 5700000.0]))
    for name in ("estimate", "reckoned"):
        before, after = (np.asarray(getattr(each.records, name), float) for each in (run, moved))
        offset = np.tile([500000.0, 5700000.0, 0.0, 0.0], (len(before), 1))
        np.testing.assert_allclose(after - before, offset, atol=1e-3)
    assert moved.metrics().ate == pytest.approx(run.metrics().ate, abs=1e-4)


def test_what_the_robot_observes_is_its_estimate() -> None:
    scenario = volume(localiser=VolumeLocaliser(DRIFT))
    state, _ = scenario.init(jax.random.key(0))
    np.testing.assert_allclose(scenario.measure_state(state), state.robot, atol=1e-6)
    pose = jnp.array([0.3, -0.2, 0.1, 0.25]) + level_pose(QUADROTOR, state.robot)
    own = state.own._replace(place=state.own.place._replace(pose=pose))
    tilted = QUADROTOR.project(
        state.robot.at[3:10].set(jnp.array([1, 0.5, -0.2, 0.9, 0.1, 0.2, 0.3]))
    )
    observed = scenario.measure_state(state._replace(own=own, robot=tilted))
    np.testing.assert_allclose(level_pose(QUADROTOR, observed), pose, atol=1e-5)
    # Speed, climb, tilt and body rates are those that are measured.
    np.testing.assert_allclose(
        np.linalg.norm(observed[3:5]), np.linalg.norm(tilted[3:5]), rtol=1e-5
    )
    np.testing.assert_allclose(observed[5], tilted[5], rtol=1e-6)
    np.testing.assert_allclose(observed[10:], tilted[10:])
    down = np.array([2.0 * (q[1] * q[3] - q[0] * q[2]) for q in (observed[6:10], tilted[6:10])])
    assert down[0] == pytest.approx(down[1], abs=1e-6)
    same = move_to(QUADROTOR, tilted, level_pose(QUADROTOR, tilted))
    np.testing.assert_allclose(same, tilted, atol=1e-6)


def test_a_window_beside_a_localiser_is_refused() -> None:
    perception = jx.VolumePerception([CAMERA], 0.2, 0.3, window=(8.0, 4.0, 2.4))
    with pytest.raises(ValueError, match=r"^window is \[8\.0, 4\.0, 2\.4\] beside a localiser"):
        jx.VolumeScenario(
            room(),
            QUADROTOR,
            CAMERA,
            (1.2, 2.0, 1.2, 0.3),
            perception=perception,
            localiser=VolumeLocaliser(),
        )
