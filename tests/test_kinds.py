"""A closed loop of each kind of task, beside the explorations of README's blocks: what is recorded
agrees with the true world, computed anew from the recorded states."""

from pathlib import Path

import jax
import numpy as np
import scipy.ndimage
from tests import kinds

import jaxplore as jx
from jaxplore.tasks.registry import build, make_settings

KEY = jax.random.key(0)


def distance_to(solid: np.ndarray, side: float, points: np.ndarray) -> np.ndarray:
    """Distances of points (N, d), (x, y) or (x, y, z), from the nearest solid cell's centre [m]."""
    field = scipy.ndimage.distance_transform_edt(~solid, sampling=side)
    cells = np.floor(points / side).astype(int)[:, ::-1]
    return field[tuple(cells.T)]


def check_run(run, again) -> None:
    """Check what holds for all kinds: nothing diverges, and the same seed gives the same run."""
    records = run.recording.records
    assert np.asarray(records.is_finite).all()
    assert run.metrics.collisions == 0
    np.testing.assert_array_equal(again.recording.records.state, records.state)
    np.testing.assert_array_equal(again.recording.records.control, records.control)


def check_folder(run, folder: Path) -> None:
    """Check that a run is read from its folder as it was saved, with pictures."""
    run.save(folder)
    assert jx.Run.load(folder).metrics.as_dict() == run.metrics.as_dict()
    assert list(folder.glob("*.png")) or list(folder.glob("*.gif"))


def test_a_quadrotor_explores_a_volume(tmp_path: Path) -> None:
    scenario, controller = kinds.volume(), kinds.volume_controller()
    # With one key of six, noise makes one voxel uncertain again for a step.
    key = jax.random.key(1)
    run, again = (jx.simulate(controller, scenario, 100, key=key) for _ in range(2))
    check_run(run, again)
    check_folder(run, tmp_path / "run")
    coverage = np.asarray(run.recording.records.coverage)
    assert (np.diff(coverage) >= 0.0).all()
    assert coverage[-1] > coverage[0] + 0.1
    # The state has its z axis down, the room has it up.
    points = np.asarray(run.recording.records.state)[:, :3] * (1.0, 1.0, -1.0)
    assert np.ptp(points, axis=0).max() > 0.3
    solid = np.asarray(kinds.room().is_occupied)
    away = distance_to(solid, kinds.SIDE, points) - float(kinds.QUADROTOR.radius)
    # A voxel reaches half its diagonal from its centre, and the point is as far from its own's.
    np.testing.assert_allclose(run.recording.records.clearance, away, atol=2.0 * kinds.SIDE)


def test_two_robots_explore_two_rooms(tmp_path: Path) -> None:
    one = kinds.alone()
    controller, scenario = kinds.fleet(one)
    run, again = (jx.simulate(controller, scenario, 60, key=KEY) for _ in range(2))
    check_run(run, again)
    check_folder(run, tmp_path / "run")
    records = run.recording.records
    assert records.coverage[-1] > records.coverage[0] + 0.05
    assert (records.coverage[:, None] >= records.parts["team"].coverages - 1e-6)[10:].all()
    states = np.asarray(records.state).reshape(len(records.state), 2, -1)
    solid = np.asarray(kinds.two_rooms().probability) > 0.5
    for robot in range(2):
        points = states[:, robot, :2]
        assert np.ptp(points, axis=0).max() > 0.2
        # From the centre of a cell a wall begins half a side before its own centre.
        assert distance_to(solid, 0.1, points).min() > 0.15
    apart = np.linalg.norm(states[:, 0, :2] - states[:, 1, :2], axis=1)
    assert apart.min() > 0.3
    assert not np.asarray(records.parts["team"].is_contact).any()


def test_a_car_follows_a_path_past_others(tmp_path: Path) -> None:
    passing = kinds.mpcc(other=kinds.OTHER + kinds.AROUND)
    scenario = jx.PathScenario(passing.model, kinds.RING, laps=2, **kinds.SHARED).with_disturbances(
        [kinds.NO_FAULTS]
    )
    run, again = (
        jx.simulate(passing.controller, scenario, 200, key=KEY, num_trajectories=0)
        for _ in range(2)
    )
    check_run(run, again)
    check_folder(run, tmp_path / "run")
    records = run.recording.records
    x, y = np.asarray(records.state)[:, :2].astype(np.float64).T
    # The ring has its centre at (0, 3) and a radius of 3 m.
    np.testing.assert_allclose(records.deviation, np.hypot(x, y - 3.0) - 3.0, atol=2e-4)
    assert run.metrics.corridor_violations == 0
    assert records.progress[-1] > 3.0


def test_a_robot_that_estimates_its_pose_explores_an_office(tmp_path: Path) -> None:
    """With wheels that drift, a gap in the scans, and controls of another gain than the model."""
    entries = {
        **kinds.OFFICE,
        "lidar": {"num_beams": 72},
        "controller": {"num_samples": 64, "horizon": 20},
        "localisation": {"distance_noise": 0.02},
        "variation": {"gain": [0.9, 1.1]},
        "faults": {"scan_dropout": [0.4, 0.6]},
    }
    controller, scenario, _, key = build(make_settings(entries))
    run = jx.simulate(controller, scenario, 100, key=key, num_trajectories=0)
    check_folder(run, tmp_path / "run")
    records = run.recording.records
    assert np.asarray(records.is_finite).all()
    assert run.metrics.collisions == 0
    # The judge's error is that of the recorded poses.
    assert 0.0 < run.metrics.ate < 0.1
    assert run.metrics.path_length > 0.2
