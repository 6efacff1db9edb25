"""Goals on the maps of another program."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import OccupancyGrid
from jaxplore.onboard import goals
from jaxplore.onboard.goals import GoalChooser, power_of_two_shape
from jaxplore.planning import DiscountedInformation

OFFSET = np.array([500_000.0, 4_649_776.0])


def local_map(robot, shape=None) -> OccupancyGrid:
    grid = robot.state.belief.grid.unpad()
    values = np.asarray(grid.probability)
    if shape is not None:
        values = values[: shape[0], : shape[1]]
    return OccupancyGrid(values, grid.resolution, grid.frame.origin)


@pytest.fixture
def chooser(make_robot):
    robot = make_robot()
    return GoalChooser(robot.scenario.perception, DiscountedInformation(), max_speed=1.0)


def put(robot, x: float, y: float, yaw: float) -> None:
    model = robot.scenario.robot
    robot.state = robot.state._replace(robot=model.at_pose(x, y, yaw))


def look(robot) -> None:
    """Let the robot stand until it has scanned."""
    for _ in range(int(robot.scenario.steps_per_scan)):
        robot.step()


def test_a_robot_that_is_put_at_each_goal_sees_the_whole_map(chooser, make_robot) -> None:
    robot = make_robot()
    put(robot, 1.0, 1.0, 0.0)
    seen, now, pose = [], 0.0, np.array([*(OFFSET + 1.0), 0.0])
    for _ in range(30):
        look(robot)
        now += 1.0
        goal = chooser.update(now, local_map(robot), OFFSET, pose)
        if goal is None:
            break
        place = goal.pose - [*OFFSET, 0.0]
        # It is in known free space, where the robot fits, and worth the way.
        assert float(robot.state.belief.clearance(jnp.asarray(place[:2], jnp.float32))) > 0.2
        assert goal.information >= float(chooser.perception.min_information)
        assert goal.distance >= np.hypot(*(goal.pose - pose)[:2]) - 0.3
        seen.append(place)
        pose = goal.pose
        put(robot, *place)
    assert goal is None
    assert robot.coverage > 0.95
    assert 2 < len(seen) < 20
    assert robot.num_contacts == 0


def test_a_goal_stays_until_it_takes_too_long_and_is_then_dropped_for_a_while(
    chooser, make_robot
) -> None:
    robot = make_robot()
    look(robot)
    grid, pose = local_map(robot), np.array([1.0, 1.0, 0.0])
    nowhere = np.zeros(2)
    first = chooser.update(0.0, grid, nowhere, pose)
    assert chooser.update(5.0, grid, nowhere, pose) is first
    second = chooser.update(30.0, grid, nowhere, pose)
    assert chooser.num_dropped == 1
    assert np.hypot(*(second.pose - first.pose)[:2]) > 0.7
    # Nobody goes there: one after the other is dropped, until the first may be tried again.
    later = [chooser.update(31.0 + 20.0 * k, grid, nowhere, pose) for k in range(1, 6)]
    assert any(
        each is not None and np.allclose(each.pose[:2], first.pose[:2], atol=0.3) for each in later
    )


def test_who_drives_tells_how_a_goal_ended(chooser, make_robot) -> None:
    robot = make_robot()
    look(robot)
    grid, pose, nowhere = local_map(robot), np.array([1.0, 1.0, 0.0]), np.zeros(2)
    chooser.finish(0.0, is_reached=True)
    first = chooser.update(0.0, grid, nowhere, pose)
    chooser.finish(1.0, is_reached=False)
    assert (chooser.goal, chooser.num_dropped) == (None, 1)
    second = chooser.update(1.0, grid, nowhere, pose)
    assert np.hypot(*(second.pose - first.pose)[:2]) > 0.7
    # A robot that has reached its goal and sees nothing new there is not sent there again.
    chooser.finish(2.0, is_reached=True)
    assert chooser.num_dropped == 1
    third = chooser.update(2.0, grid, nowhere, pose)
    assert third is None or np.hypot(*(third.pose - second.pose)[:2]) > 0.4
    assert chooser.num_dropped == 2


def test_a_goal_that_was_seen_from_afar_is_replaced(chooser, make_robot) -> None:
    robot = make_robot()
    look(robot)
    pose, nowhere = np.array([1.0, 1.0, 0.0]), np.zeros(2)
    first = chooser.update(0.0, local_map(robot), nowhere, pose)
    known = np.array(robot.scenario.world.probability)
    grid = local_map(robot)
    # Everything within three metres of the goal becomes known.
    rows, columns = np.mgrid[: known.shape[0], : known.shape[1]]
    away = np.hypot(0.1 * columns - first.pose[0], 0.1 * rows - first.pose[1])
    values = np.where(away < 3.0, np.where(known > 0.5, 0.97, 0.02), np.asarray(grid.probability))
    seen = OccupancyGrid(values.astype(np.float32), 0.1)
    second = chooser.update(1.0, seen, nowhere, pose)
    assert second is None or np.hypot(*(second.pose - first.pose)[:2]) > 0.5


def test_a_known_map_of_another_program_has_no_goals_whatever_its_probabilities(
    chooser, make_robot
) -> None:
    """Cartographer, for one, ends at 0.12 in free cells."""
    robot = make_robot()
    known = np.asarray(robot.scenario.world.probability) > 0.5
    pose, nowhere = np.array([1.0, 1.0, 0.0]), np.zeros(2)
    for free, occupied in ((0.0, 1.0), (0.12, 0.88), (0.24, 0.66)):
        grid = OccupancyGrid(np.where(known, occupied, free).astype(np.float32), 0.1)
        assert chooser.update(0.0, grid, nowhere, pose) is None


def test_maps_that_grow_compile_one_program_for_each_power_of_two(chooser, make_robot) -> None:
    robot = make_robot()
    look(robot)
    pose = np.array([1.0, 1.0, 0.0])
    sizes = []
    for shape in ((40, 40), (44, 50), (48, 62)):
        chooser.goal = None
        chooser.update(0.0, local_map(robot, shape), np.zeros(2), pose)
        sizes.append(goals.choose._cached._cache_size())
    assert len(set(sizes)) == 1
    assert power_of_two_shape((40, 70)) == (64, 128)
    assert power_of_two_shape((1024, 1025)) == (1024, 2048)


@pytest.mark.parametrize("name", ["max_speed", "patience", "least_time", "drop_time", "near"])
def test_numbers_that_make_no_sense_are_refused(chooser, name) -> None:
    with pytest.raises(ValueError, match=f"{name} is 0"):
        GoalChooser(chooser.perception, chooser.rule, **{"max_speed": 1.0, name: 0.0})
