"""Mapping a log in parts: its sensor, the drift on its motions, and the size of its map."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore.localisation import Localiser, LoopCloser, Odometry, map_log
from jaxplore.localisation.log_mapping import (
    _accumulated,
    drifted_motions,
    frame_around,
    log_sensor,
)
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
    motions, elapsed = drifted_motions(log, EXACT, KEY)
    np.testing.assert_allclose(elapsed, [0.0] + [0.5] * 39)
    reached = _accumulated(log.poses[0], np.asarray(motions, float))
    np.testing.assert_allclose(reached[:, :2], log.poses[:, :2], atol=1e-4)
    apart = reached[:, 2] - log.poses[:, 2]
    np.testing.assert_allclose(np.sin(apart), 0.0, atol=1e-4)


def test_drift_has_the_size_of_the_odometry_and_its_seed() -> None:
    log = log_of(181, 1.0, number=4000)
    noisy = Odometry(0.02, math.radians(1.0), 0.0, 0.0)
    motions, _ = drifted_motions(log, noisy, KEY)
    exact, _ = drifted_motions(log, EXACT, KEY)
    error = np.asarray(motions - exact, float)[1:]
    length = np.hypot(*np.asarray(exact, float)[1:, :2].T)
    scaled = error / np.sqrt(length)[:, None] / [0.02, 0.02, math.radians(1.0)]
    # Five standard errors.
    np.testing.assert_allclose(scaled.std(axis=0), 1.0, atol=0.06)
    again, _ = drifted_motions(log, noisy, KEY)
    other, _ = drifted_motions(log, noisy, jax.random.key(1))
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
    for name, value in (("resolution", 0.0), ("resolution", 2.0), ("max_range", -1.0)):
        with pytest.raises(ValueError, match=rf"^{name} is .*; accepted: "):
            map_log(log, key=KEY, closer=LoopCloser(), **{name: value})
