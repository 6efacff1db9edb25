"""The rules of a server of paths, and costmaps as scans, without ROS."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import Lidar
from jaxplore.control.stops import BLIND, GOOD, LOST
from jaxplore.dynamics.goal import STANDING, Motion
from jaxplore.onboard.costmap import Costmap
from jaxplore.onboard.following import Following
from jaxplore.onboard.options import Command, Mode
from jaxplore.onboard.path_server import (
    MOST_BRAKING,
    Ending,
    ErrorCode,
    PathRequest,
    PathServer,
    ServerOptions,
    Status,
)
from jaxplore.sensing.beams import Scan

HERE = np.zeros(3)
LINE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.5]])
DRIVING = Command(np.array([0.5, 0.0, 0.0]), Mode.DRIVING, "", None)
STOPPED = Command(np.zeros(3), Mode.WAITING, "", None)
BRAKING = Command(np.array([0.2, 0.0, 0.0]), Mode.BRAKING, "the scan is 0.40 s old", None)


class Task(Following):
    """Keeps what it is told; nobody drives."""

    def __init__(self) -> None:
        super().__init__(None)
        self.taken, self.left = [], 0

    def take(self, points, heading=None) -> None:
        super().take(points, heading)
        self.taken.append((points, heading))

    def leave(self) -> None:
        super().leave()
        self.left += 1


def server(**options) -> PathServer:
    return PathServer(Task(), ServerOptions(**options), 1.0)


def ended(goal, status, code=ErrorCode.NONE, said=""):
    return [(goal, Ending(status, code, said))]


def test_a_goal_succeeds_when_the_robot_stands_at_its_end() -> None:
    tested = server()
    assert tested.begin(0.0, "a", PathRequest("odom", LINE), HERE) == []
    ((points, heading),) = tested.task.taken
    np.testing.assert_array_equal(points, LINE[:, :2])
    assert heading == 0.5
    for time in np.arange(0.1, 2.0, 0.1):
        pose = np.array([time, 0.0, 0.0])
        assert tested.update(time, pose, Motion(1.0, 0.0), DRIVING) == []
        assert tested.distance_to_goal(pose) == pytest.approx(2.0 - round(time), abs=1e-9)
    tested.task.is_done = True
    # Its last command still turns it.
    turning = STOPPED._replace(twist=np.array([0.0, 0.0, 0.1]))
    assert tested.update(2.1, LINE[-1], STANDING, turning) == []
    assert tested.is_commanding
    assert tested.update(2.2, LINE[-1], STANDING, STOPPED) == ended("a", Status.SUCCEEDED)
    assert not tested.is_commanding
    assert tested.task.waits_for(HERE) == "no path yet"


def test_a_path_is_followed_in_the_frame_of_the_pose() -> None:
    tested = server()
    place = np.array([10.0, 20.0, math.pi / 2.0])
    tested.begin(0.0, "a", PathRequest("map", LINE), place)
    ((points, heading),) = tested.task.taken
    np.testing.assert_allclose(points, [[10.0, 20.0], [10.0, 21.0], [10.0, 22.0]], atol=1e-12)
    assert heading == pytest.approx(0.5 + math.pi / 2.0)


@pytest.mark.parametrize(
    ("request_", "place", "code", "said"),
    [
        (PathRequest("odom", LINE[:0]), HERE, ErrorCode.INVALID_PATH, "path has no poses"),
        (PathRequest("odom", LINE[:0], problem="x is nan"), HERE, ErrorCode.INVALID_PATH, "x is"),
        (PathRequest("odom", LINE * np.nan), HERE, ErrorCode.INVALID_PATH, "not finite"),
        (PathRequest("moon", LINE), None, ErrorCode.TF_ERROR, "no transform from the frame 'moon'"),
        (PathRequest("odom", LINE, "DWB"), HERE, ErrorCode.INVALID_CONTROLLER, "controller_id is"),
        (PathRequest("odom", LINE, "", "odd"), HERE, ErrorCode.UNKNOWN, "goal_checker_id is 'odd'"),
        (PathRequest("odom", LINE, "", "", "x"), HERE, ErrorCode.UNKNOWN, "progress_checker_id"),
        (PathRequest("odom", 1e6 * LINE), HERE, ErrorCode.INVALID_PATH, "m long; accepted"),
    ],
)
def test_a_goal_that_cannot_be_followed_ends_with_its_code_when_the_robot_stands(
    request_, place, code, said
) -> None:
    tested = server()
    tested.begin(0.0, "good", PathRequest("odom", LINE), HERE)
    # It replaces the good one, as in nav2.
    assert tested.begin(1.0, "bad", request_, place) == ended(
        "good", Status.ABORTED, said="replaced by a newer goal"
    )
    assert tested.task.waits_for(HERE) == "no path yet"
    assert tested.update(1.1, HERE, Motion(0.5, 0.0), BRAKING) == []
    ((goal, ending),) = tested.update(1.5, HERE, STANDING, STOPPED)
    assert (goal, ending.status, ending.code) == ("bad", Status.ABORTED, code)
    assert said in ending.message


def test_known_names_of_controller_and_checkers_are_accepted() -> None:
    names = ("FollowPath", "general_goal_checker", "progress_checker")
    tested = server()
    tested.begin(0.0, "a", PathRequest("odom", LINE, *names), HERE)
    assert tested.update(0.1, HERE, STANDING, DRIVING) == []
    assert tested.task.left == 0


def test_a_single_pose_is_a_place_to_turn_to() -> None:
    tested = server()
    tested.begin(0.0, "a", PathRequest("odom", LINE[-1:]), HERE)
    ((points, heading),) = tested.task.taken
    np.testing.assert_array_equal(points[-1], LINE[-1, :2])
    assert math.atan2(*(points[-1] - points[0])[::-1]) == pytest.approx(0.5)
    assert heading == 0.5


def test_a_newer_goal_replaces_an_older_one_and_keeps_the_clock_of_progress() -> None:
    tested = server(movement_time_allowance=5.0)
    tested.begin(0.0, 0, PathRequest("odom", LINE), HERE)
    for second in range(1, 6):
        # A planner replans each second, and the robot does not move.
        assert tested.update(float(second), HERE, STANDING, DRIVING) == []
        (old,) = tested.begin(float(second), second, PathRequest("odom", LINE), HERE)
        assert old == (second - 1, Ending(Status.ABORTED, ErrorCode.NONE, old[1].message))
    assert tested.task.left == 0
    assert tested.update(6.1, HERE, STANDING, DRIVING) == []
    said = "the robot moved less than 0.5 m in 5 s"
    assert tested.update(6.2, HERE, STANDING, STOPPED) == ended(
        5, Status.ABORTED, ErrorCode.FAILED_TO_MAKE_PROGRESS, said
    )


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=60))
def test_progress_is_that_of_navs_checker(steps) -> None:
    """The rule of nav2's SimpleProgressChecker, written down once more."""
    tested = server(required_movement_radius=0.7, movement_time_allowance=3.0)
    tested.begin(0.0, "a", PathRequest("odom", LINE), HERE)
    x, base, base_at = 0.0, None, 0.0
    for second, step in enumerate(steps):
        x += step if second % 7 else -step
        if base is None or abs(x - base) > 0.7:
            base, base_at = x, float(second)
        failed = second - base_at > 3.0
        found = tested.update(float(second), np.array([x, 0.0, 0.0]), STANDING, DRIVING)
        # The command still drives, so the goal is decided, and ends later.
        assert found == []
        assert (tested.task.left > 0) == failed
        if failed:
            break


@pytest.mark.parametrize(
    ("command", "stop", "problem", "code", "said"),
    [
        (BRAKING, BLIND, "", ErrorCode.CONTROLLER_TIMED_OUT, "the scan is 0.40 s old"),
        (BRAKING, LOST, "", ErrorCode.TF_ERROR, "the scan is 0.40 s old"),
        (BRAKING, GOOD, "", ErrorCode.PATIENCE_EXCEEDED, "the scan is 0.40 s old"),
        (DRIVING, GOOD, "no costmap", ErrorCode.CONTROLLER_TIMED_OUT, "no costmap"),
        (
            DRIVING._replace(reason="too close: 0.01 m"),
            GOOD,
            "",
            ErrorCode.PATIENCE_EXCEEDED,
            "too close: 0.01 m",
        ),
    ],
)
def test_without_a_valid_command_patience_ends(command, stop, problem, code, said) -> None:
    tested = server(failure_tolerance=1.0)
    tested.begin(0.0, "a", PathRequest("odom", LINE), HERE)
    for time in (0.5, 1.0):
        assert tested.update(time, HERE, STANDING, command, stop, problem) == []
    # One valid command is enough to begin again.
    assert tested.update(1.1, HERE, STANDING, DRIVING) == []
    assert tested.update(2.0, HERE, STANDING, command, stop, problem) == []
    assert tested.task.left == 0
    assert tested.update(2.2, HERE, STANDING, command, stop, problem) == []
    assert tested.update(2.3, HERE, STANDING, STOPPED) == ended("a", Status.ABORTED, code, said)


@pytest.mark.parametrize("tolerance", [0.0, -1.0])
def test_patience_may_be_none_or_endless(tolerance) -> None:
    tested = server(failure_tolerance=tolerance, movement_time_allowance=1e6)
    tested.begin(0.0, "a", PathRequest("odom", LINE), HERE)
    found = tested.update(0.05, HERE, STANDING, BRAKING)
    found += tested.update(9e5, HERE, STANDING, BRAKING)
    assert [each[1].code for each in found] == (
        [ErrorCode.NO_VALID_CONTROL] if tolerance == 0.0 else []
    )


def test_a_pause_is_no_failure() -> None:
    tested = server(failure_tolerance=0.5, movement_time_allowance=2.0)
    tested.begin(0.0, "a", PathRequest("odom", LINE), HERE)
    paused = STOPPED._replace(mode=Mode.PAUSED, reason="paused")
    for time in range(1, 20):
        assert tested.update(float(time), HERE, STANDING, paused) == []
    assert tested.update(20.0, HERE, STANDING, DRIVING) == []


def test_a_cancelled_goal_ends_at_rest_or_after_a_while() -> None:
    tested = server()
    for moving in (False, True):
        tested.begin(0.0, "a", PathRequest("odom", LINE), HERE)
        tested.cancel(1.0, "another")
        assert tested.task.waits_for(HERE) == ""
        tested.cancel(1.0, "a")
        assert tested.task.waits_for(HERE) == "no path yet"
        fast = Motion(0.3, 0.0)
        assert tested.update(1.1, HERE, fast, BRAKING) == []
        # Without odometry nobody sees that it stands.
        after, motion = (1.1 + MOST_BRAKING, fast) if moving else (1.5, STANDING)
        assert tested.update(after, HERE, motion, STOPPED) == ended(
            "a", Status.CANCELED, said="cancelled"
        )


def test_a_server_that_stops_aborts_its_goal() -> None:
    tested = server()
    tested.stop(0.0, "told to")
    assert tested.end_now() == []
    tested.begin(0.0, "a", PathRequest("odom", LINE), HERE)
    tested.stop(1.0, "told to")
    assert tested.end_now() == ended("a", Status.ABORTED, said="told to")


@pytest.mark.parametrize(
    ("limit", "is_percentage", "expected"),
    [(0.0, False, math.inf), (0.3, False, 0.3), (50.0, True, 0.4), (0.0, True, math.inf)],
)
def test_a_limit_of_the_speed_comes_as_fast_as_the_robot_brakes(
    limit, is_percentage, expected
) -> None:
    tested = server()
    tested.limit_speed(limit, 0.8, is_percentage=is_percentage)
    fast, found = DRIVING._replace(twist=np.array([0.8, 0.0, 0.0])), []
    for time in np.arange(0.0, 1.0, 0.1):
        tested.update(time, HERE, STANDING, fast)
        found.append(tested.task.max_speed)
        fast = fast._replace(twist=np.array([min(0.8, found[-1]), 0.0, 0.0]))
    assert found[-1] == pytest.approx(expected)
    # By 1 m/s^2.
    assert all(after >= before - 0.1 - 1e-9 for before, after in itertools.pairwise(found[1:]))
    tested.limit_speed(0.0, 0.8, is_percentage=False)
    tested.update(1.1, HERE, STANDING, fast)
    assert tested.task.max_speed == math.inf


@pytest.mark.parametrize(
    ("limit", "is_percentage"), [(-0.1, False), (math.nan, False), (101, True)]
)
def test_limits_that_are_none_are_refused(limit, is_percentage) -> None:
    with pytest.raises(ValueError, match=r"speed_limit is .*; accepted: "):
        server().limit_speed(float(limit), 0.8, is_percentage=is_percentage)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("xy_goal_tolerance", 0.0),
        ("yaw_goal_tolerance", -0.1),
        ("required_movement_radius", math.inf),
        ("movement_time_allowance", 0.0),
        ("failure_tolerance", -0.5),
    ],
)
def test_options_that_are_wrong_are_refused_and_nothing_changes(name, value) -> None:
    with pytest.raises(ValueError, match=f"{name} is .*; accepted: "):
        ServerOptions(**{name: value})
    tested = server()
    before = tested.options
    with pytest.raises(ValueError, match=f"{name} is .*; accepted: "):
        tested.set_options(**{name: value})
    assert tested.options == before
    tested.set_options(xy_goal_tolerance=0.4, yaw_goal_tolerance=7.0)
    assert (tested.task.radius, tested.task.tolerance) == (0.4, math.pi)


LIDAR = Lidar(num_beams=24, max_range=3.0)


def room(turn: float = 0.0) -> Costmap:
    """A map of 4 m x 3 m, turned around (1, 2), with one cell of 10 cm and some inflation."""
    cells = np.zeros((30, 40), np.int16)
    cells[10:21, 20:31] = 99
    cells[15, 25] = 100
    return Costmap.of_cells(cells, 0.1, np.array([1.0, 2.0, turn]), 0.0, "odom")


@pytest.mark.parametrize("turn", [0.0, 0.7, -2.0])
def test_a_costmap_is_seen_as_a_lidar_would(turn) -> None:
    """The obstacle is 1 m ahead of a robot that stands in the map."""
    costmap = room(turn)
    cos, sin = math.cos(turn), math.sin(turn)
    local = np.array([2.55 - 1.0, 1.55])
    place = np.array([1.0, 2.0]) + np.array([[cos, -sin], [sin, cos]]) @ local
    pose = np.array([*place, turn])
    radius = 0.1 / math.sqrt(math.pi)
    (point,) = costmap.points(pose, 3.0)
    np.testing.assert_allclose(point, [1.0 - radius, 0.0], atol=1e-9)
    scan = costmap.scan(LIDAR, pose)
    ahead = int(np.abs(LIDAR.beam_angles).argmin())
    hit = np.asarray(scan.is_return)
    assert hit.sum() <= 3
    assert hit[ahead]
    assert float(scan.ranges[ahead]) == pytest.approx(1.0 - radius, abs=1e-5)
    # Where nothing is, a beam ends at the edge of the map.
    for angle, away in zip(LIDAR.beam_angles[~hit], np.asarray(scan.ranges)[~hit], strict=True):
        end = local + away * np.array([math.cos(angle), math.sin(angle)])
        outside = np.maximum(np.maximum(-end, end - [4.0, 3.0]), 0.0).max()
        inside = np.minimum(end, [4.0, 3.0] - end).min()
        assert outside < 1e-4
        assert inside < 1e-4 or away == pytest.approx(3.0)


def test_the_nearer_one_of_scan_and_costmap_counts() -> None:
    pose = np.array([2.55, 3.55, 0.0])
    ranges = np.full(24, 2.0, np.float32)
    ahead = int(np.abs(LIDAR.beam_angles).argmin())
    for measured, seen in ((2.0, 0.94358), (0.5, 0.5), (0.0, 0.94358)):
        ranges[ahead] = measured
        is_return = ranges > 0.0
        found = room().scan(LIDAR, pose, Scan(ranges, is_return))
        assert float(found.ranges[ahead]) == pytest.approx(seen, abs=1e-4)
        assert bool(found.is_return[ahead])
        behind = (ahead + 12) % 24
        assert float(found.ranges[behind]) == 2.0


def test_a_costmap_without_obstacles_has_no_points() -> None:
    empty = Costmap.of_cells(np.full((4, 4), -1, np.int16), 0.1, HERE, 0.0, "odom")
    assert empty.points(HERE, 3.0).shape == (0, 2)
    assert not np.asarray(empty.scan(LIDAR, np.array([0.2, 0.2, 0.0])).is_return).any()
