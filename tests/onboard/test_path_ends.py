"""The heading at the end of a path, and limits of the speed along it."""

import itertools
import math

import numpy as np
import pytest

from jaxplore import Omnidirectional, Unicycle, mpcc
from jaxplore.onboard import steps
from jaxplore.onboard.following import blank_path, slowed

pytestmark = pytest.mark.long

LATENCY = 0.06


def dense(corners) -> np.ndarray:
    corners = np.asarray(corners, np.float64)
    return np.concatenate([np.linspace(a, b, 200) for a, b in itertools.pairwise(corners)])


def test_a_robot_turns_to_the_heading_at_the_end_and_keeps_to_a_limit_of_its_speed(
    make_follower, make_robot, drive, drive_until
) -> None:
    pilot, robot = make_follower(end_heading=0.0, latency=LATENCY), make_robot(delay=0.04)
    task = pilot.task
    task.radius, task.tolerance = 0.25, 0.25
    task.max_speed = 0.3
    drive(pilot, robot, 0.5)
    for end, heading in (((2.4, 1.0), -1.6), ((1.0, 1.2), 0.2)):
        start = np.asarray(robot.state.robot)[:2]
        task.take(dense([start, end]), heading)
        _, states = drive_until(lambda: task.is_done, pilot, robot, 14.0)
        before = steps.plan._cached._cache_size()
        assert task.is_done
        x, y, yaw = states[-1][:3]
        assert math.hypot(x - end[0], y - end[1]) < 0.27
        assert abs((yaw - heading + math.pi) % math.tau - math.pi) < 0.3
        fastest = states[:, 3].max()
        assert fastest < (0.33 if task.max_speed == 0.3 else 0.9)
        task.max_speed = 0.8
    assert fastest > 0.5
    assert steps.plan._cached._cache_size() == before
    assert robot.num_contacts == 0


@pytest.mark.parametrize(
    ("robot", "named"),
    [
        (Omnidirectional(max_speed=1.0, min_speed=-0.6), ("max_speed", "max_lateral_speed")),
        (Unicycle(max_speed=1.0, min_speed=-0.1), ()),
    ],
)
def test_a_limit_is_that_of_each_model_and_is_taken_back(robot, named) -> None:
    whole = mpcc(robot, blank_path(), horizon=4, num_samples=8, comfort_weight=None)
    slow = slowed(whole.model, whole.model, 0.25)
    assert [float(getattr(slow.physical, name)) for name in named] == [0.25] * len(named)
    assert float(slow.virtual.control_max[0]) == 0.25
    if "v" in robot.control_names:
        assert np.asarray(slow.physical.control_max)[0] == 0.25
        assert np.asarray(slow.physical.control_min)[0] == np.float32(-0.1)
        assert (np.asarray(slow.physical.control_max)[1:] == robot.control_max[1:]).all()
    else:
        assert float(slow.physical.min_speed) == -0.25
    again = slowed(slow, whole.model, math.inf)
    for one, other in zip(
        map(np.asarray, steps.jax.tree.leaves(again)),
        map(np.asarray, steps.jax.tree.leaves(whole.model)),
        strict=True,
    ):
        np.testing.assert_array_equal(one, other)
