"""Mapping a log in parts: its sensor, the drift on its motions, and the size of its map."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.geometry.motion import accumulate_motions, motions_between, steps_along
from jaxplore.localisation import Localiser, Odometry, map_log
from jaxplore.localisation.log_drawing import Sampling, frame_around, log_sensor
from jaxplore.localisation.log_mapping import _follow_odometry, _thin_scans
from jaxplore.localisation.log_odometry import fit_odometry, measure_motions
from jaxplore.localisation.log_trust import judge_poses
from jaxplore.sensing import LaserLog, Lidar, Scan

KEY = jax.random.key(0)
EXACT = Odometry(0.0, 0.0, 0.0, 0.0)


def log_of(beams: int, spacing: float, number: int = 40, first: float = -90.0) -> LaserLog:
    """Return a log of a drive along a curve in which every beam reads 2 m."""
    turn = np.linspace(0.0, 3.0 * math.pi, number)
    poses = np.stack([100.0 + 3.0 * np.sin(turn), -3.0 * np.cos(turn), turn], axis=1)
    # As logs have them, in [-pi, pi].
    poses[:, 2] = np.arctan2(np.sin(turn), np.cos(turn))
    return LaserLog(
        0.5 * np.arange(number),
        np.full((number, beams), 2.0),
        poses,
        poses,
        math.radians(first),
        math.radians(spacing),
    )


@pytest.mark.parametrize(
    ("beams", "spacing", "first"),
    [
        (181, 1.0, -90.0),
        (180, 1.0, -90.0),
        (361, 0.5, -90.0),
        (360, 0.5, -90.0),
        (360, 1.0, -180.0),
        (5, 10.0, -20.0),
    ],
)
def test_the_sensor_has_the_beams_of_the_log(beams: int, spacing: float, first: float) -> None:
    """Each reading gets the beam in its own direction, and no other beam has one."""
    log = log_of(beams, spacing, first=first)
    log.ranges[0] = 1.0 + 0.001 * np.arange(beams)
    sensor = log_sensor(log, 25.0)
    scan = log.scan(0, sensor)
    is_return = np.asarray(scan.is_return)
    assert is_return.sum() == beams
    np.testing.assert_allclose(np.asarray(scan.ranges)[is_return], log.ranges[0], rtol=1e-6)
    np.testing.assert_allclose(sensor.beam_angles[is_return], log.beam_angles, atol=1e-5)


def test_motions_without_errors_are_those_of_the_log() -> None:
    log = log_of(181, 1.0)
    motions, elapsed = measure_motions(log, EXACT, KEY)
    np.testing.assert_allclose(elapsed, [0.0] + [0.5] * 39)
    reached = accumulate_motions(log.poses[0], np.asarray(motions, float))
    np.testing.assert_allclose(reached[:, :2], log.poses[:, :2], atol=1e-4)
    apart = reached[:, 2] - log.poses[:, 2]
    np.testing.assert_allclose(np.sin(apart), 0.0, atol=1e-4)


def test_drift_has_the_size_of_the_odometry_and_its_seed() -> None:
    log = log_of(181, 1.0, number=4000)
    noisy = Odometry(0.02, math.radians(1.0), 0.0, 0.0)
    motions, _ = measure_motions(log, noisy, KEY)
    exact, _ = measure_motions(log, EXACT, KEY)
    error = np.asarray(motions - exact, float)[1:]
    length = np.hypot(*np.asarray(exact, float)[1:, :2].T)
    scaled = error / np.sqrt(length)[:, None] / [0.02, 0.02, math.radians(1.0)]
    # Five standard errors.
    np.testing.assert_allclose(scaled.std(axis=0), 1.0, atol=0.06)
    again, _ = measure_motions(log, noisy, KEY)
    other, _ = measure_motions(log, noisy, jax.random.key(1))
    np.testing.assert_array_equal(again, motions)
    assert np.abs(np.asarray(other - motions)).max() > 0.0


def test_a_map_holds_all_points_of_scans() -> None:
    sensor = Lidar(4, max_range=9.0)
    scans = Scan(jnp.full((2, 4), 3.0), jnp.array([[True] * 4, [False] * 4]))
    poses = np.array([[1.0, 2.0, 0.0], [8.0, 2.0, 0.0]])
    frame, (rows, columns) = frame_around(sensor, scans, poses, 0.1, 0.5)
    low = np.asarray(frame.origin, float)[:2]
    high = low + 0.1 * np.array([columns, rows])
    # Beams to all sides from the first pose; from the second none returned.
    np.testing.assert_array_less(low, [-2.0 - 0.49, -1.0 - 0.49])
    np.testing.assert_array_less([8.0 + 0.49, 5.0 + 0.49], high)
    np.testing.assert_allclose(low, [-2.5, -1.5], atol=0.11)
    far = np.array([[0.0, 0.0, 0.0], [1000.0, 1000.0, 0.0]])
    with pytest.raises(ValueError, match=r"^resolution is 0\.1, which makes a map of .*; accepted"):
        frame_around(sensor, scans, far, 0.1, 0.5)


def test_a_localiser_without_room_is_refused() -> None:
    log = log_of(181, 1.0)
    with pytest.raises(ValueError, match=r"^localiser has room for 39 scans; accepted: at least 4"):
        map_log(log, key=KEY, localiser=Localiser(capacity=39))
    with pytest.raises(ValueError, match=r"^key is None"):
        map_log(log, drift=EXACT)


@pytest.mark.parametrize(
    ("noise", "spacing", "side"),
    [(0.01, 0.5, 0.05), (0.03, 1.0, 0.1), (0.01, 6.0, 0.2), (0.09, 0.5, 0.2)],
)
def test_cells_are_as_large_as_noise_and_gaps_need(noise: float, spacing: float, side: float):
    """Flat walls 4 m away, read to within a noise that is found again."""
    angles = np.radians(np.arange(-60.0, 60.1, spacing))
    log = log_of(len(angles), spacing)
    exact = 4.0 / np.cos(angles)
    ranges = exact + noise * np.random.default_rng(0).standard_normal((40, len(angles)))
    ranges[:, ::7] = 81.9
    found = Sampling.of(log._replace(ranges=ranges), 25.0)
    assert found.side == side
    assert found.noise == pytest.approx(noise, rel=0.25)
    gap = 4.0 * math.radians(spacing)
    assert found.filling == pytest.approx(max(2.0 * gap / side, 1.0), abs=1.0)


def test_the_errors_of_an_odometry_are_found_again() -> None:
    rng = np.random.default_rng(0)
    true = np.stack([rng.uniform(0.1, 1.0, 4000), np.zeros(4000), rng.normal(0.0, 0.4, 4000)], 1)
    length, turn = true[:, 0], np.abs(true[:, 2])
    stds = np.sqrt(
        np.stack([0.05**2 * length + 0.02**2 * turn] * 2 + [0.01**2 * length + 0.09**2 * turn], 1)
    )
    measured = true + stds * rng.standard_normal(true.shape)
    poses = accumulate_motions(np.zeros(3), np.concatenate([np.zeros((1, 3)), true]))
    found = fit_odometry(measured, poses)
    for length, turn in ((1.0, 0.0), (1.0, 0.3), (0.3, 0.3), (0.5, 1.0)):
        covariance = np.asarray(found.covariance(jnp.array([length, 0.0, turn]), jnp.zeros(())))
        across = 0.05**2 * length + 0.02**2 * turn
        yaw = 0.01**2 * length + 0.09**2 * turn
        assert covariance[0, 0] == pytest.approx(across, rel=0.1)
        # What turns hide of the straight way is less than a degree in a metre.
        assert covariance[2, 2] == pytest.approx(yaw, rel=0.1, abs=0.0175**2 * length)
    exact = fit_odometry(true, poses)
    assert 0.0 < float(exact.distance_noise) <= 0.02


def test_scans_near_the_one_before_follow_the_odometry() -> None:
    """A robot that stands, and drives in small steps: the other scans move with the used ones."""
    rng = np.random.default_rng(1)
    steps = rng.uniform(-0.02, 0.08, (200, 3)) * (rng.random((200, 1)) < 0.7)
    poses = accumulate_motions(np.array([1.0, 2.0, 0.3]), steps)
    used = _thin_scans(poses)
    assert used[0] == 0
    assert 10 < len(used) < 100
    between = motions_between(poses[used[:-1]], poses[used[1:]])
    is_far = (np.hypot(*between[:, :2].T) >= 0.2) | (np.abs(between[:, 2]) >= 0.2)
    assert is_far.all()
    found = poses[used] + rng.normal(0.0, 1.0, (len(used), 3))
    whole = _follow_odometry(found, poses, used)
    np.testing.assert_allclose(whole[used], found)
    own, given = steps_along(whole), steps_along(poses)
    is_between = ~np.isin(np.arange(200), used)
    np.testing.assert_allclose(own[is_between], given[is_between], atol=1e-9)


def square_log(number: int = 200) -> LaserLog:
    """Return a log of two laps in a square room with a box in its middle, seen exactly."""
    turn = np.linspace(0.0, 4.0 * math.pi, number)
    poses = np.stack([3.0 * np.cos(turn), 3.0 * np.sin(turn), turn + 0.5 * math.pi], axis=1)
    log = log_of(181, 1.0, number)
    ranges = np.empty((number, 181))
    for index, (x, y, yaw) in enumerate(poses):
        angles = yaw + log.beam_angles
        slopes = np.stack([np.cos(angles), np.sin(angles)], 1)
        # Walls 5 m to each side; the disc of 1 m in the middle.
        with np.errstate(divide="ignore"):
            ranges[index] = np.where(slopes > 0, (5 - np.array([x, y])) / slopes, np.inf).min(1)
            back = np.where(slopes < 0, (-5 - np.array([x, y])) / slopes, np.inf).min(1)
        ranges[index] = np.minimum(ranges[index], back)
        along = -(slopes @ [x, y])
        across = x * x + y * y - along**2
        is_met = (along > 0) & (across < 1.0)
        ranges[index][is_met] = (along - np.sqrt(np.maximum(1.0 - across, 0.0)))[is_met]
    return log._replace(ranges=ranges, poses=poses, odometry=poses)


def test_poses_are_judged_without_the_true_ones() -> None:
    log = square_log()
    trust = judge_poses(log, log.poses, 25.0)
    assert trust.warning == ""
    assert trust.num_places > 80
    assert (trust.doubtful_places, trust.doubtful_steps) == (0.0, 0.0)
    # Wherever the whole is.
    moved = log.poses + np.array([50.0, -20.0, 0.0])
    assert judge_poses(log, moved, 25.0).warning == ""
    # The second lap is a metre aside, or turned.
    for away in ([1.0, 0.0, 0.0], [0.0, 0.0, 0.3]):
        wrong = log.poses.copy()
        wrong[100:] += away
        trust = judge_poses(log, wrong, 25.0)
        assert "the map is not to be trusted" in trust.warning
        assert trust.doubtful_places > 0.3
    # A leap between neighbouring scans, each a metre on.
    wrong = log.poses.copy()
    wrong[:, 2] += 0.3 * (np.arange(200) % 7 == 0)
    assert judge_poses(log, wrong, 25.0).doubtful_steps > 0.2
    few = log._replace(**{name: getattr(log, name)[:60] for name in ("times", "ranges")})
    trust = judge_poses(few, log.poses[:60], 25.0)
    assert trust.warning == "0 places were seen twice, too few to tell whether the map is right"
