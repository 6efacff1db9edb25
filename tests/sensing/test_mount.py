"""A lidar beside the robot's centre that turns while the robot drives."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import Lidar, OccupancyGrid
from jaxplore.sensing.beams import Scan
from jaxplore.sensing.mount import LidarMount, ScanMotion, project_scan
from jaxplore.simulation.exploration.moving_discs import MovingDiscs
from jaxplore.simulation.exploration.true_world import TrueWorld

SIDE, TURN = 6.0, 0.1
PLACE = LidarMount(0.25, 0.1, math.radians(40.0), is_turning=True)
LIDAR = Lidar(360, 8.0, range_noise=0.0, mount=PLACE)
POSE = np.array([2.2, 3.1, 0.5], np.float32)
PILLAR = (slice(34, 38), slice(40, 44))
KEY = jax.random.key(0)


def room() -> OccupancyGrid:
    """6 x 6 m in cells of 0.1 m, with a pillar of 0.4 m."""
    world = np.zeros((62, 62), np.float32)
    world[0] = world[-1] = world[:, 0] = world[:, -1] = world[PILLAR] = 1.0
    return OccupancyGrid(world, 0.1, (-0.1, -0.1, 0.0))


@jax.jit
def scan_world(lidar, pose, motion, moving=None):
    truth = TrueWorld(room(), None, lambda: moving, is_told=False)
    return truth.scans((lidar,), pose, KEY, motion)[0]


def scan_of(lidar=LIDAR, true=(0.0, 0.0, 0.0), known=None, moving=None) -> Scan:
    twists = (np.asarray(each, np.float32) for each in (true, true if known is None else known))
    found = scan_world(lidar, POSE, ScanMotion(*twists, np.float32(TURN)), moving)
    return Scan(*(np.asarray(each) for each in found))


def ends_of(scan: Scan, lidar=LIDAR) -> np.ndarray:
    """Return the returns of a scan around the robot's centre, in the world."""
    angles = POSE[2] + lidar.beam_angles.astype(np.float64)
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return (POSE[:2] + scan.ranges[:, None] * ways)[scan.is_return]


def away_from_walls(points: np.ndarray) -> np.ndarray:
    """Return the distance of points from the nearest face, in closed form [m]."""
    outer = np.minimum(points, SIDE - points).min(axis=1)
    low = np.array([PILLAR[1].start, PILLAR[0].start]) * 0.1 - 0.1
    beside = np.maximum(np.maximum(low - points, points - low - 0.4), 0.0)
    return np.minimum(np.abs(outer), np.hypot(*beside.T))


def place_after(twist, time: float) -> np.ndarray:
    """Return the pose in the frame of the robot after a time, by many small steps."""
    pose, steps = np.zeros(3), 2000
    for _ in range(steps):
        middle = pose[2] + 0.5 * twist[2] * time / steps
        cos, sin = math.cos(middle), math.sin(middle)
        vx, vy = twist[0] * time / steps, twist[1] * time / steps
        pose += [cos * vx - sin * vy, sin * vx + cos * vy, twist[2] * time / steps]
    return pose


@pytest.mark.parametrize("twist", [(0.0, 0.0, 0.0), (1.0, 0.0, 1.5), (0.5, -0.4, -2.0)])
def test_poses_are_those_of_an_integration(twist) -> None:
    times = np.asarray(PLACE.times(4, jnp.asarray(TURN)))
    np.testing.assert_allclose(times, [-0.075, -0.05, -0.025, 0.0], atol=1e-7)
    found = np.asarray(PLACE.poses(jnp.asarray(twist, jnp.float32), jnp.asarray(times)))
    for time, pose in zip(times.tolist(), found, strict=True):
        x, y, yaw = place_after(twist, time)
        cos, sin = math.cos(yaw), math.sin(yaw)
        place = [x + cos * 0.25 - sin * 0.1, y + sin * 0.25 + cos * 0.1]
        np.testing.assert_allclose(pose, [*place, yaw + math.radians(40.0)], atol=1e-3)


@pytest.mark.parametrize("twist", [(0.0, 0.0, 0.0), (1.0, 0.0, 1.5), (0.5, -0.4, -2.0)])
def test_walls_are_where_they_are(twist) -> None:
    scan = scan_of(true=twist)
    right = away_from_walls(ends_of(scan))
    # Around the pillar the room hides a part of itself.
    assert len(right) > 300
    # A line between two ends cuts off a corner between them.
    assert right.max() < 0.06
    assert np.quantile(right, 0.95) < 2e-3
    if any(twist):
        wrong = away_from_walls(ends_of(scan_of(true=twist, known=(0.0, 0.0, 0.0))))
        assert np.quantile(wrong, 0.95) > 0.05
        # A motion that is not known is taken for none.
        lost = away_from_walls(ends_of(scan_of(true=twist, known=(np.nan, 0.0, 0.0))))
        np.testing.assert_array_equal(lost, wrong)


def test_nothing_is_free_that_the_lidar_has_not_seen() -> None:
    """The lidar sees a place if the line to it does not meet the pillar, made smaller by what is
    between two beams."""
    scan = scan_of()
    lidar = POSE[:2] + turned(np.array([0.25, 0.1]), POSE[2])
    low = np.array([PILLAR[1].start, PILLAR[0].start]) * 0.1 - 0.1 + 0.04
    ways = turned(np.stack([np.cos(LIDAR.beam_angles), np.sin(LIDAR.beam_angles)], 1), POSE[2])
    along = np.linspace(0.0, 1.0, 200)
    for way, reach in zip(ways, scan.ranges, strict=True):
        for share in along[1:]:
            line = lidar + along[:, None] * (POSE[:2] + share * reach * way - lidar)
            assert not ((line > low) & (line < low + 0.32)).all(axis=1).any()
    # What the pillar hides from the lidar alone is not measured, and that is little.
    assert 0 < (scan.ranges == 0.0).sum() < 40


def turned(points: np.ndarray, angle: float) -> np.ndarray:
    cos, sin = math.cos(angle), math.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])


def test_a_mount_of_nothing_changes_nothing() -> None:
    plain = scan_of(Lidar(360, 8.0, range_noise=0.0))
    found = scan_of(Lidar(360, 8.0, range_noise=0.0, mount=LidarMount()))
    np.testing.assert_allclose(found.ranges, plain.ranges, atol=1e-3)
    np.testing.assert_array_equal(found.is_return, plain.is_return)


projected = jax.jit(lambda scan, lidar, poses: project_scan(scan, lidar, poses))


def test_a_circle_is_a_circle_around_another_centre() -> None:
    """At the angle a from the offset d the wall of radius r is sqrt(r^2 - d^2 sin^2 a) - d cos a
    away."""
    poses = np.tile(np.array([-0.3, 0.0, 0.7], np.float32), (360, 1))
    for radius, is_return in ((3.0, True), (8.0, False)):
        ranges = np.full(360, radius, np.float32)
        found = projected(Scan(ranges, np.full(360, is_return)), LIDAR, poses)
        angles = LIDAR.beam_angles.astype(np.float64)
        expected = np.sqrt(radius**2 - 0.09 * np.sin(angles) ** 2) - 0.3 * np.cos(angles)
        expected = np.minimum(expected, LIDAR.max_range)
        np.testing.assert_allclose(found.ranges, expected, atol=1e-3)
        np.testing.assert_array_equal(found.is_return, is_return)


def test_single_errors_cost_little_and_single_returns_are_kept() -> None:
    poses = np.tile(np.array([-0.3, 0.1, 0.0], np.float32), (360, 1))
    ranges = np.full(360, 3.0, np.float32)
    ranges[20:300:40] = 0.0
    ranges[40:300:40] = 1.0
    found = projected(Scan(ranges, ranges > 0.0), LIDAR, poses)
    number = len(range(20, 300, 40)) + len(range(40, 300, 40))
    assert (found.ranges == 0.0).sum() <= 3 * number
    # Each return that is alone is there, where it is.
    angles = LIDAR.beam_angles[40:300:40].astype(np.float64)
    ends = poses[0, :2] + np.stack([np.cos(angles), np.sin(angles)], 1)
    bearing = np.degrees(np.arctan2(ends[:, 1], ends[:, 0]))
    beam = np.round(bearing + 180.0).astype(int) % 360
    np.testing.assert_allclose(found.ranges[beam], np.hypot(*ends.T), atol=1e-3)
    assert np.asarray(found.is_return)[beam].all()


def test_a_sector_says_nothing_of_what_is_beside_it() -> None:
    lidar = Lidar(181, 5.0, field_of_view=math.pi)
    poses = np.tile(np.array([0.5, 0.0, 0.0], np.float32), (181, 1))
    found = projected(Scan(np.full(181, 2.0, np.float32), np.ones(181, bool)), lidar, poses)
    # The half circle around (0.5, 0) begins at (0.5, 2), in the direction of 75.96 degrees.
    is_beside = np.abs(np.degrees(lidar.beam_angles)) > 75.97
    assert is_beside.sum() > 20
    np.testing.assert_array_equal(np.asarray(found.ranges) == 0.0, is_beside)


def test_what_moves_is_where_it_is_when_its_beam_is_measured() -> None:
    """A person who walks past at 2 m/s, 1.5 m away: 0.2 m during a turn."""
    ahead = POSE[:2] + 1.5 * np.array([math.cos(POSE[2] - 1.6), math.sin(POSE[2] - 1.6)])
    velocity = np.array([[2.0, 0.0]], np.float32)
    moving = MovingDiscs(ahead[None].astype(np.float32), velocity, np.full(1, 0.2, np.float32))
    lidar = Lidar(360, 8.0, range_noise=0.0, mount=LidarMount(is_turning=True))
    scan = scan_of(lidar, moving=moving)
    points = ends_of(scan, lidar)
    # A quarter of a turn after the first beam, which points backwards.
    beam = 360 * (math.pi - 1.6) / math.tau
    time = TURN * (beam - 359) / 360
    away = np.hypot(*(points - ahead - time * velocity[0]).T)
    assert away.min() == pytest.approx(0.2, abs=0.02)
    assert ((away > 0.17) & (away < 0.3)).sum() > 8
    assert np.hypot(*(points - ahead).T).min() > 0.05
