"""A lidar beside the robot's centre that turns once between two scans, and what the pilot makes of
its messages."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from tests.onboard.conftest import LIDAR, rooms

from jaxplore import Lidar
from jaxplore.onboard.scan_points import TakenScan
from jaxplore.ros import messages
from jaxplore.ros.messages import Mount
from jaxplore.sensing.lidar_errors import LidarErrors

pytestmark = pytest.mark.long

MOUNT = (0.12, -0.08, 0.6)
LATENCY = 0.06
ERRORS = LidarErrors(least_range=0.2, missing=0.05, false_returns=0.01, pitch=0.1, roll=0.05)
"""With them the lidar sees the floor 2 m ahead, from a height of 0.2 m."""


def taken(robot, measured, now):
    """Return the scan of a measurement as a node takes it from a message."""
    stamp = SimpleNamespace(sec=0, nanosec=0)
    message = SimpleNamespace(header=SimpleNamespace(stamp=stamp, frame_id=""))
    pause = robot.period * int(robot.scenario.steps_per_scan) / LIDAR.num_beams
    messages.fill_laser_scan(
        *(message, measured.scan, LIDAR, now - measured.scan_age, "laser"),
        period=0.1,
        pause=pause if robot.is_turning else 0.0,
    )
    return messages.laser_scan_of(message, LIDAR, Mount(*np.asarray(robot.mount).tolist()))


def lidar_with(errors: LidarErrors) -> Lidar:
    return Lidar(LIDAR.num_beams, LIDAR.max_range, range_noise=0.01, height=0.2, errors=errors)


def away_from_walls(points: np.ndarray) -> np.ndarray:
    """Return the distances (N,) of points from the nearest solid cell [m]."""
    world = rooms()
    rows, columns = np.nonzero(~np.asarray(world.is_free))
    low = world.resolution * np.stack([columns, rows], axis=-1)
    gap = np.maximum(low - points[:, None], points[:, None] - low - world.resolution)
    return np.hypot(*np.maximum(gap, 0.0).transpose(2, 0, 1)).min(axis=1)


def placed(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return points @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]


@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), MOUNT])
def test_a_turning_lidar_is_undistorted_by_the_odometry(make_robot, mount) -> None:
    robot = make_robot(lidar=lidar_with(LidarErrors()), mount=mount, is_turning=True)
    poses, found = {}, []
    for _ in range(round(1.6 / robot.period)):
        robot.set_velocity(np.array([0.5, 0.0, 1.0]))
        now, poses[robot.num_steps] = robot.time, np.asarray(robot.state.robot)[:3]
        measured = robot.step()
        if measured.scan is not None and now > 0.8:
            scan = taken(robot, measured, now)
            assert scan.time == pytest.approx(now - 0.1)
            found.append((scan, poses[round(scan.time / robot.period)], measured.twist))
    assert len(found) >= 7
    wrong = []
    for scan, pose, twist in found:
        given = TakenScan(scan.time, scan.scan, scan.points, scan.sweep)
        right = given.undistort(LIDAR, twist, np.array(mount[:2]))
        assert away_from_walls(placed(right.points, pose)).max() < 0.06
        wrong.append(away_from_walls(placed(scan.points, pose)).max())
    assert min(wrong) > 0.08


def test_a_pilot_drives_by_a_turning_lidar_with_errors_beside_the_centre(
    make_pilot, make_robot
) -> None:
    pilot = make_pilot(latency=LATENCY, lidar_x=MOUNT[0], lidar_y=MOUNT[1])
    robot = make_robot(lidar=lidar_with(ERRORS), delay=0.04, mount=MOUNT, is_turning=True)
    for _ in range(round(12.0 / robot.period)):
        now, measured = robot.time, robot.step()
        pilot.add_odometry(now, measured.pose, measured.twist)
        if measured.scan is not None:
            scan = taken(robot, measured, now)
            pilot.add_scan(scan.time, scan.scan, scan.points, sweep=scan.sweep)
        robot.set_velocity(pilot.command(now).twist)
        pilot.update_belief(now)
    assert robot.num_contacts == 0
    assert robot.coverage > 0.6
    # What the pilot takes to be occupied is at a wall of the world.
    grid = pilot.belief.grid
    cells = np.argwhere(np.asarray(grid.crop(grid.probability)) > 0.7)
    origin = np.asarray(grid.frame.origin)[:2] + pilot.offset
    away = away_from_walls(origin + grid.resolution * (cells[:, ::-1] + 0.5))
    assert len(cells) > 60
    assert np.quantile(away, 0.95) < 0.1
