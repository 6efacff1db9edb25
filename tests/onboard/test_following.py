"""Paths of another program, followed on the robot's own map."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.dynamics.goal import Motion
from jaxplore.onboard import steps
from jaxplore.onboard.following import MOST_LENGTH, NUM_NODES, path_of_points, pieces_of_points
from jaxplore.onboard.options import Mode
from jaxplore.onboard.tasks import TaskControl

LATENCY = 0.06


def distance_from(points: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Distance of each state from a dense line."""
    away = states[:, None, :2] - points[None]
    return np.hypot(away[..., 0], away[..., 1]).min(axis=1)


def dense(corners) -> np.ndarray:
    corners = np.asarray(corners, np.float64)
    return np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(corners)])


def test_a_robot_follows_paths_one_after_the_other_and_stands_at_their_ends(
    make_follower, make_robot, drive, drive_until
) -> None:
    # Far from the origin of the odometry, as in UTM coordinates.
    place = np.array([500_000.0, 4_649_776.0, 0.0])
    pilot, robot = make_follower(latency=LATENCY), make_robot(delay=0.04)

    def moved(now, measured):
        return measured._replace(pose=measured.pose + place)

    def follow():
        """Drive to the end of the path, and stand there."""
        commands, states = drive_until(lambda: pilot.task.is_done, pilot, robot, 7.0, moved)
        more, after = drive(pilot, robot, 1.0, moved)
        return commands + more, np.concatenate([states, after])

    commands, _ = drive(pilot, robot, 0.5, moved)
    assert {(each.mode, each.reason) for each in commands} == {(Mode.WAITING, "no path yet")}
    first = dense([(1.0, 1.0), (2.2, 1.2), (2.6, 2.0), (2.6, 2.6)])
    pilot.task.take(first + place[:2])
    commands, states = follow()
    assert distance_from(first, states).max() < 0.2
    assert np.hypot(*(states[-1][:2] - first[-1])) < 0.25
    assert commands[-1].reason == "at the end of the path"
    assert not commands[-1].twist.any()
    before = steps.plan._cached._cache_size()
    second = dense([(2.6, 2.6), (1.4, 3.6)])
    pilot.task.take(second + place[:2])
    _, states = follow()
    assert np.hypot(*(states[-1][:2] - second[-1])) < 0.25
    # Another path is the same program.
    assert steps.plan._cached._cache_size() == before
    assert robot.num_contacts == 0
    assert pilot.recording().frames[-1].reference.shape[1] == 2


def test_a_path_that_turns_back_is_followed_in_pieces() -> None:
    """Points that recur and a last step of a millimetre make no piece of their own."""
    there, back = dense([(0.0, 0.0), (2.0, 0.0)]), dense([(2.0, 0.0), (1.0, 0.5)])
    jitter = back[-1] + [[0.001, -0.0005]]
    pieces = pieces_of_points(np.concatenate([there, back, jitter]))
    ends = [np.asarray(each.points)[[0, -1]] for each in pieces]
    np.testing.assert_allclose(ends, [there[[0, -1]], back[[0, -1]]], atol=1e-5)
    corner = dense([(0.0, 0.0), (2.0, 0.0), (1.0, 1.5)])
    assert len(pieces_of_points(corner)) == 1


def test_a_piece_begins_when_the_robot_stands_at_the_end_of_the_last(make_follower) -> None:
    pilot = make_follower()
    task = pilot.task
    task.take(dense([(0.0, 0.0), (2.0, 0.0), (1.0, 0.1)]))
    driver = TaskControl(pilot.controller, pilot.robot, np.asarray(pilot.scenario.start))

    def waits_for(x, y, speed):
        task.update_control(driver, np.zeros(2), np.zeros(2, np.float32))
        return task.waits_for(np.array([x, y]), Motion(speed, 0.0))

    assert waits_for(1.9, 0.0, 0.5) == waits_for(1.9, 0.0, 0.0) == ""
    # From here on the end of the second piece counts.
    assert waits_for(1.9, 0.0, 0.0) == waits_for(1.05, 0.1, 0.3) == ""
    assert not task.is_done
    assert waits_for(1.05, 0.1, 0.02) == "at the end of the path"


def test_a_robot_stops_where_its_map_shows_a_wall_across_the_path(
    make_follower, make_robot, drive
) -> None:
    pilot, robot = make_follower(latency=LATENCY), make_robot(delay=0.04)
    drive(pilot, robot, 0.2)
    # The wall between the rooms is at x = 3.2.
    pilot.task.take(dense([(1.0, 1.0), (5.0, 1.0)]))
    _, states = drive(pilot, robot, 5.0)
    assert robot.num_contacts == 0
    assert 2.0 < states[-1][0] < 3.05


def test_a_drive_along_paths_cannot_be_turned_back(make_follower) -> None:
    with pytest.raises(ValueError, match="cannot drive back to its start; accepted: in the mode"):
        make_follower().task.turn_back(0.0, "told to return")


@given(
    corners=st.lists(
        st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0)), min_size=2, max_size=8
    )
)
def test_a_smooth_path_keeps_its_ends_and_stays_near_the_points(corners) -> None:
    given = np.array(corners)
    length = np.hypot(*np.diff(given, axis=0).T).sum()
    if length < 0.2:
        return
    path = path_of_points(given)
    points = np.asarray(path.points, np.float64)
    assert points.shape == (NUM_NODES, 2)
    np.testing.assert_allclose(points[[0, -1]], given[[0, -1]], atol=1e-3)
    # A Gaussian cuts no corner by more than a few of its standard deviations.
    fine = np.concatenate([np.linspace(a, b, 400) for a, b in itertools.pairwise(given)])
    assert distance_from(fine, points).max() < 0.3
    assert float(path.length) <= length + 1e-3


@pytest.mark.parametrize(
    ("points", "named"),
    [
        (np.zeros((0, 2)), "path is 0 m long"),
        (np.ones((5, 2)), "path is 0 m long"),
        ([[0.0, 0.0], [np.nan, 1.0]], "not finite"),
        ([[0.0, 0.0], [2.0 * MOST_LENGTH, 0.0]], "m long; accepted"),
    ],
)
def test_paths_that_are_none_are_refused(make_follower, points, named) -> None:
    task = make_follower().task
    with pytest.raises(ValueError, match=named):
        task.take(np.array(points))
    assert task.waits_for(np.zeros(2)) == "no path yet"
