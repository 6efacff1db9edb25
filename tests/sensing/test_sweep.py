"""Scans of a robot that moves during the scan, against poses in small steps and known walls."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.beams import Scan
from jaxplore.sensing.lidar import Lidar
from jaxplore.sensing.sweep import Sweep, undistort_points, undistort_scan

SENSOR = Lidar(180, 8.0, range_noise=0.0)
SECTOR = Lidar(91, 8.0, np.pi, range_noise=0.0)
SIDE, SECONDS = 6.0, 0.1


def room() -> OccupancyGrid:
    """Return a room whose walls are at 0.2 m and at 5.8 m."""
    probability = np.ones((120, 120), np.float32)
    probability[4:-4, 4:-4] = 0.0
    return OccupancyGrid(probability, 0.05)


def to_wall(points: np.ndarray) -> np.ndarray:
    """Return the distance (N,) of points from the nearest wall [m]."""
    edges = np.concatenate([points - 0.2, 5.8 - points], axis=1)
    return np.abs(edges).min(axis=1)


def place_after(pose: np.ndarray, twist: np.ndarray, seconds: float) -> np.ndarray:
    """Return a pose (3,) after some time, by a thousand small steps."""
    x, y, yaw = pose
    step = seconds / 1000
    for k in range(1000):
        at = yaw + twist[2] * step * (k + 0.5)
        x += step * (np.cos(at) * twist[0] - np.sin(at) * twist[1])
        y += step * (np.sin(at) * twist[0] + np.cos(at) * twist[1])
    return np.array([x, y, yaw + twist[2] * seconds])


@given(
    twist=st.tuples(*[st.floats(-2.0, 2.0) for _ in range(3)]),
    seconds=st.floats(0.0, 0.2),
    point=st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0)),
)
def test_points_are_moved_as_the_robot_was(twist, seconds: float, point) -> None:
    twist = np.array(twist)
    x, y, yaw = place_after(np.zeros(3), twist, seconds)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    found = undistort_points(np.array([point]), np.array([seconds]), twist)[0]
    # The chord of an arc of 0.4 rad is shorter than the arc by 0.7 %.
    np.testing.assert_allclose(found, [x, y] + turn @ point, atol=5e-3)


@jax.jit
def cast(poses):
    """Return the reading of beam k from pose k."""
    scans = jax.vmap(lambda pose: SENSOR.scan(room(), pose, key=jax.random.key(0)))(poses)
    return jnp.diagonal(scans.ranges), jnp.diagonal(scans.is_return)


@pytest.mark.parametrize("twist", [(0.0, 0.0, 2.0), (1.0, 0.0, -1.5), (0.8, 0.5, 0.0)])
@pytest.mark.parametrize("is_clockwise", [False, True])
def test_walls_are_where_they_are(twist, is_clockwise: bool) -> None:
    twist, begin = np.array(twist), np.array([2.5, 3.5, 0.4])
    angles = SENSOR.beam_angles.astype(np.float64)
    first = angles[-1] if is_clockwise else angles[0]
    rate = (-1.0 if is_clockwise else 1.0) * 2.0 * np.pi / SECONDS
    sweep = Sweep(first, rate)
    times = sweep.times(angles)
    assert times.min() == pytest.approx(0.0, abs=1e-6)
    assert times.max() == pytest.approx(SECONDS * 179 / 180, abs=1e-5)
    poses = np.stack([place_after(begin, twist, each) for each in times])
    scan = Scan(*cast(jnp.asarray(poses, jnp.float32)))
    found = undistort_scan(scan, SENSOR, sweep, twist, np.zeros(2))

    def ends(each: Scan) -> np.ndarray:
        is_return = np.asarray(each.is_return)
        bearing = begin[2] + angles[is_return]
        ways = np.stack([np.cos(bearing), np.sin(bearing)], 1)
        return begin[:2] + np.asarray(each.ranges)[is_return, None] * ways

    before, after = to_wall(ends(scan)), to_wall(ends(found))
    # Beams are 2 degrees apart, and an end goes to the nearest one.
    assert np.quantile(after, 0.9) < 0.06
    assert np.quantile(after, 0.9) < 0.7 * np.quantile(before, 0.9)
    # Few beams are left without an end.
    assert np.asarray(found.is_return).mean() > 0.95


@pytest.mark.parametrize("sensor", [SENSOR, SECTOR])
def test_a_robot_that_stands_has_the_same_scan(sensor: Lidar) -> None:
    rng = np.random.default_rng(1)
    number = sensor.num_beams
    ranges = rng.uniform(0.5, 7.0, number).astype(np.float32)
    ranges[3] = 0.0
    is_return = rng.random(number) < 0.8
    is_return[3] = False
    scan = Scan(jnp.asarray(ranges), jnp.asarray(is_return))
    sweep = Sweep(float(sensor.beam_angles[0]), 60.0)
    found = undistort_scan(scan, sensor, sweep, np.zeros(3), np.array([0.2, -0.1]))
    np.testing.assert_allclose(found.ranges, ranges, atol=1e-4)
    np.testing.assert_array_equal(found.is_return, is_return)
