import itertools
import math
from collections import deque
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import (
    Ackermann,
    Camera,
    DifferentialDrive,
    ExplorationScenario,
    Faults,
    Lidar,
    MovingObstacles,
    OccupancyGrid,
    Perception,
    Quadrotor,
    TerrainMap,
    generate_map,
    start_pose,
)
from jaxplore.belief.car import car_motion
from jaxplore.dynamics import Goal
from jaxplore.geometry import Chassis, Rectangle
from jaxplore.maps import Ground
from jaxplore.maps.collision import clearance_reach, disc_clearance
from jaxplore.parts import Targets, Wheels
from jaxplore.simulation import PartTruth
from jaxplore.simulation.exploration.reachability import open_spot, reachable_cells

pytestmark = pytest.mark.long

ROBOT = DifferentialDrive(radius=0.2)
LIDAR = Lidar(16, 1.0)


@given(st.integers(0, 2**32 - 1))
def test_reachable_cells_are_those_of_a_flood_fill(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = (rng.random((18, 22)) < 0.04).astype(np.float32)
    world[7:11, 7:11] = 0.0
    solid = [
        (r, c) for r in range(-1, 19) for c in range(-1, 23)
        if not (0 <= r < 18 and 0 <= c < 22) or world[r, c] > 0
    ]  # fmt: skip

    def has_room(row: int, column: int) -> bool:
        nearest = min(math.hypot(row - r, column - c) for r, c in solid)
        return (nearest - 0.5) * 0.1 >= 0.15 - 1e-6

    start, seen = (8, 8), set()
    if not has_room(*start):
        return
    queue = deque([start])
    while queue:
        cell = queue.popleft()
        if cell in seen or not (0 <= cell[0] < 18 and 0 <= cell[1] < 22) or not has_room(*cell):
            continue
        seen.add(cell)
        queue.extend((cell[0] + i, cell[1] + j) for i in (-1, 0, 1) for j in (-1, 0, 1))
    # The cells around the start count as beginnings, too: keep to worlds where that is the same.
    around = {(r, c) for r in (7, 8, 9) for c in (7, 8, 9) if has_room(r, c)}
    if not around <= seen:
        return
    found = reachable_cells(OccupancyGrid(world, 0.1), np.array([0.85, 0.85]), 0.15)
    assert set(map(tuple, np.argwhere(found))) == seen


@given(st.integers(0, 2**32 - 1), st.floats(0.02, 0.98), st.floats(0.02, 0.98))
def test_no_reachable_cell_is_behind_a_diagonal_wall(seed: int, x: float, y: float) -> None:
    """Of a robot that needs no more than half a cell: both cells beside a step must be free."""
    rng = np.random.default_rng(seed)
    world = (rng.random((16, 18)) < 0.1).astype(np.float32)
    for _ in range(3):
        row, column, slope = rng.integers(0, 16), rng.integers(0, 18), rng.choice([-1, 1])
        for step in range(rng.integers(3, 16)):
            if row + step < 16 and 0 <= column + slope * step < 18:
                world[row + step, column + slope * step] = 1.0
    start = (int(rng.integers(0, 16)), int(rng.integers(0, 18)))
    world[start] = 0.0
    seen, queue = {start}, deque([start])
    while queue:
        row, column = queue.popleft()
        for i, j in itertools.product((-1, 0, 1), repeat=2):
            cell = (row + i, column + j)
            passed = (cell, (row + i, column), (row, column + j))
            is_free = all(0 <= r < 16 and 0 <= c < 18 and world[r, c] == 0.0 for r, c in passed)
            if is_free and cell not in seen:
                seen.add(cell)
                queue.append(cell)
    pose = np.array([start[1] + x, start[0] + y]) * 0.5
    found = reachable_cells(OccupancyGrid(world, 0.5), pose, 0.005)
    assert set(map(tuple, np.argwhere(found))) == seen


@given(st.integers(0, 2**32 - 1))
def test_clearance_of_a_disc_is_the_distance_to_square_cells(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = rng.random((20, 20)) < 0.02
    centre = rng.uniform(-1, 21, 2)
    expected = math.inf
    for row in range(-12, 32):
        for column in range(-12, 32):
            inside = 0 <= row < 20 and 0 <= column < 20
            if inside and not solid[row, column]:
                continue
            dy = max(row - centre[0], centre[0] - row - 1, 0)
            dx = max(column - centre[1], centre[1] - column - 1, 0)
            expected = min(expected, math.hypot(dx, dy))
    found = CLEARANCE(jnp.asarray(solid), jnp.asarray(centre, jnp.float32))
    assert float(found) == pytest.approx(min(expected, 7.0) * 0.1 - 0.2, abs=1e-4)


CLEARANCE = jax.jit(lambda solid, grid: disc_clearance(solid, grid, jnp.asarray(0.2), 0.1, 7))


def test_reach_covers_radius_and_margin() -> None:
    assert clearance_reach(0.2, 0.1, 0.5) >= 7


def test_open_spot_has_the_most_room() -> None:
    world = np.ones((20, 30), np.float32)
    world[5:16, 10:25] = 0.0
    x, y = open_spot(OccupancyGrid(world, 0.1, (5.0, 0.0, 0.0)), 0.2)
    assert 5.0 + 1.5 < x < 5.0 + 2.0
    assert y == pytest.approx(1.05)
    with pytest.raises(ValueError, match="no place for a robot of radius 3 m"):
        open_spot(OccupancyGrid(world, 0.1), 3.0)


WORLD = np.zeros((30, 30), np.float32)
WORLD[10, :] = 1.0
WORLD[20, :] = 0.5


@pytest.mark.parametrize(
    ("start", "reason"),
    [
        ((9.0, 1.0, 0.0), "off the map; accepted: free space within x 0 to 3, y 0 to 3"),
        ((-0.1, 1.0, 0.0), "off the map"),
        ((1.5, 1.05, 0.0), r"in a wall; accepted: free space, for example \("),
        ((1.5, 2.05, 0.0), "in unknown space"),
        ((1.5, 0.85, 0.0), "where a robot of radius 0.2 m touches something"),
        ((0.05, 0.5, 0.0), "touches something"),
        ((0.5, 0.5), "start is .*accepted: 3 finite numbers"),
    ],
)
def test_bad_starts_are_named(start, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as error:
        ExplorationScenario(OccupancyGrid(WORLD, 0.1), ROBOT, LIDAR, start)
    assert "\n" not in str(error.value)


def test_off_the_map_hint_follows_a_turned_map() -> None:
    grid = OccupancyGrid(np.zeros((10, 20)), 1.0, (0.0, 0.0, math.pi / 2))
    with pytest.raises(ValueError, match=r"x -10 to .*, y .* to 20"):
        reachable_cells(grid, np.array([5.0, 5.0]), 0.2)


def test_a_perception_must_fit_the_scenario() -> None:
    grid = OccupancyGrid(WORLD, 0.1)
    for perception in (Perception(LIDAR, 0.2, 0.2), Perception(Lidar(16, 2.0), 0.1, 0.2)):
        message = r"perception is for .*; accepted: .* \[1\.0\] m and 0\.1 m"
        with pytest.raises(ValueError, match=message):
            ExplorationScenario(grid, ROBOT, LIDAR, (1.5, 0.5, 0.0), perception=perception)


GRID, START = OccupancyGrid(WORLD, 0.1), (1.5, 0.5, 0.0)


def scenario(**arguments) -> ExplorationScenario:
    return ExplorationScenario(GRID, ROBOT, LIDAR, START, **arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"goal": (1.5, 1.05)}, r"goal is \[1.5, 1.0.*\]; accepted: a place in free space"),
        ({"goal": (1.5, 2.05)}, "goal is .*; accepted: a place in free space"),
        ({"goal": (-0.1, 0.5)}, "goal is .*; accepted: a place in free space"),
        ({"goal": (1.5, 3.01)}, "goal is .*; accepted: a place in free space"),
        ({"goal": (1.5,)}, "goal is .*; accepted: 2 finite numbers"),
        ({"goal": (1.5, 0.5, 0.0)}, "goal is .*; accepted: 2 finite numbers"),
        (
            {"prior": OccupancyGrid(np.zeros((30, 31)), 0.1)},
            r"prior has shape \(30, 31\); accepted: the world's, \(30, 30\)",
        ),
    ],
)
def test_a_bad_end_or_prior_is_named(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        scenario(**arguments)


@pytest.mark.parametrize("name", ["sensing_rate", "field_rate"])
@pytest.mark.parametrize(
    ("rate", "accepted"), [(15.0, "16.6667"), (20.0, "25"), (49.0, "50"), (30.0, "25")]
)
def test_a_rate_must_divide_the_control_rate(name: str, rate: float, accepted: str) -> None:
    message = f"{name} is {rate}; accepted: a whole fraction of .* 50 Hz, such as {accepted}$"
    with pytest.raises(ValueError, match=message):
        scenario(**{name: rate})


@pytest.mark.parametrize(
    ("control", "sensing", "field", "steps"),
    [(50.0, 50.0, 1.0, (1, 50)), (30.0, 10.0, 7.5, (3, 4)), (50.0, 16.6667, 50 / 7, (3, 7))],
)
def test_rates_that_divide_become_whole_steps(control, sensing, field, steps) -> None:
    made = scenario(control_rate=control, sensing_rate=sensing, field_rate=field)
    assert (int(made.steps_per_scan), int(made.steps_per_field)) == steps
    assert float(made.control_period) == pytest.approx(1.0 / control)


def test_hover_time_is_whole_steps() -> None:
    made = scenario(hover_time=1.5, control_rate=20.0, sensing_rate=10.0, field_rate=5.0)
    assert int(made.hover_steps) == 30
    assert int(scenario().hover_steps) == 0


def test_the_perception_shares_the_goal() -> None:
    goal = (2.5, 0.5)
    made = scenario(goal=Goal(goal, max_unknown=0.2))
    np.testing.assert_allclose(made.perception.goal, goal)
    assert float(made.perception.max_unknown) == pytest.approx(0.2)
    assert scenario().perception.goal is None
    with_goal = Perception(LIDAR, 0.1, 0.2, goal=goal)
    assert scenario(goal=goal, perception=with_goal).perception is with_goal
    with pytest.raises(ValueError, match=r"perception has the goal .*; accepted: .*, None"):
        scenario(perception=with_goal)
    with pytest.raises(ValueError, match=r"perception has the goal None; accepted: .*2\.5"):
        scenario(goal=goal, perception=Perception(LIDAR, 0.1, 0.2))


def test_a_perception_for_another_goal_is_refused() -> None:
    with pytest.raises(ValueError, match="perception has the goal"):
        scenario(goal=(2.5, 0.5), perception=Perception(LIDAR, 0.1, 0.2, goal=(0.5, 0.5)))


@pytest.mark.parametrize(
    "prior", [OccupancyGrid(WORLD, 0.2), OccupancyGrid(WORLD, 0.1, (5.0, 0.0, 0.0))]
)
def test_a_prior_of_other_cells_is_refused(prior: OccupancyGrid) -> None:
    with pytest.raises(ValueError, match="prior"):
        scenario(prior=prior)


def test_without_a_prior_nothing_is_known() -> None:
    np.testing.assert_array_equal(scenario().prior.probability, 0.5)
    prior = OccupancyGrid(np.full((30, 30), 0.2), 0.1)
    np.testing.assert_array_equal(scenario(prior=prior).prior.probability, prior.probability)


def test_altitude_is_the_start_of_robots_that_fly() -> None:
    robot = Quadrotor()
    expected = np.array(robot.at_pose(1.5, 0.5, 0.0))
    assert robot.state_names[2] == "z"
    assert expected[2] == 0.0
    expected[2] = -1.25
    made = ExplorationScenario(GRID, robot, LIDAR, START, altitude=-1.25)
    np.testing.assert_array_equal(made.start, expected)
    np.testing.assert_array_equal(scenario(altitude=-1.25).start, [1.5, 0.5, 0.0, 0.0, 0.0])


# Sensors, ground, targets and what moves

CLIFF = np.ones((30, 30))
CLIFF[:10, 15] = 0.0
TERRAIN = TerrainMap(GRID, Ground(np.zeros((30, 30)), 0.1, traversability=CLIFF))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tracking_noise": (0.1,)}, "tracking_noise is .*; accepted: 2 finite numbers"),
        # Free, but behind the wall.
        (
            {"goal": Goal((1.5, 1.5), 0.3)},
            r"goal is \[1.5, 1.5\], which a robot of radius 0.2 m cannot reach",
        ),
        ({"goal": Goal((1.5, 0.97), 0.1)}, "0.23 m is the nearest it gets; accepted"),
    ],
)
def test_what_cannot_be_seen_or_reached_is_named(arguments: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message) as error:
        scenario(**arguments)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("places", "message"),
    [
        ([(2.5, 1.05)], r"targets\[0\] is \[2.5, 1.0.*\]; accepted: a place in free"),
        ([(0.5, 0.5), (1.5, 2.05)], r"targets\[1\] is .*; accepted: a place in free"),
        ([(0.5, 0.5), (3.5, 0.5)], r"targets\[1\] is \[3.5, 0.5\]; accepted"),
        ([(0.5, math.nan)], r"targets\[0\] is \[0.5, nan\]; accepted"),
        ([(0.5, 0.5, 0.0)], r"targets have shape \(1, 3\); accepted: \(M, 2\)"),
        (np.zeros((0, 2)), r"places has shape \(0, 2\); accepted: .* M >= 1"),
        ((0.5, 0.5), r"places has shape \(2,\); accepted: \(M, 2\)"),
    ],
)
def test_targets_that_cannot_be_seen_are_named(places: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        scenario(truths=[Targets(places)])


class Bell(PartTruth):
    """The task is finished when a bell rings."""

    name = "bell"
    needs_part = False
    is_judging = True
    objective = "bell.rung_at"

    def init(self, pose):
        return jnp.array(False)

    def is_finished(self, own):
        return own


def test_truths_of_parts_end_a_task_together_and_in_place_of_the_map() -> None:
    plain = scenario(target_coverage=0.5)
    assert not plain.ends_by_parts
    assert plain.is_finished_by_parts({}) is None
    assert plain.objective == "finished_at + 100*collisions"
    made = scenario(truths=[Wheels(Chassis(0.4, 0.3, 0.1)), Bell(), Targets([(0.5, 0.5)])])
    # What the task is about comes first, in the order in which it is given.
    assert [each.name for each in made.truths] == ["bell", "targets", "wheels"]
    # A bell has no report.
    assert made.metric_groups == ("targets", "wheels")
    assert made.objective == "bell.rung_at + 100*collisions"
    for is_rung, is_found in itertools.product((False, True), repeat=2):
        states = {"bell": jnp.array(is_rung), "targets": jnp.array([is_found])}
        assert bool(made.is_finished_by_parts(states)) == (is_rung and is_found)
    # However long nothing new is seen: the state is not read.
    assert not bool(made.is_given_up(None))


def test_disturbances_that_cannot_happen_are_named() -> None:
    walls = Faults(walls=np.zeros((31, 30), bool))
    message = r"walls has shape \(31, 30\); accepted: the world's, \(30, 30\)"
    with pytest.raises(ValueError, match=message):
        scenario().with_disturbances([walls])
    with pytest.raises(ValueError, match=r"disturbances\[1\] is a second 'faults'; accepted: one"):
        scenario().with_disturbances([Faults(), Faults()])


def test_a_goal_is_reached_from_as_far_as_its_radius() -> None:
    assert scenario(goal=Goal((1.5, 0.97), radius=0.25)).goal is not None
    # Across the wall, but near enough.
    assert scenario(goal=Goal((1.5, 1.5), radius=0.8)).goal is not None


def test_no_sensor_and_no_mover() -> None:
    with pytest.raises(ValueError, match="sensors is empty; accepted: a Sensor, or a list of them"):
        ExplorationScenario(GRID, ROBOT, (), START)
    for still in (scenario(), scenario(truths=[MovingObstacles([])])):
        assert still.perception.tracker is None
        assert still.init(None)[0].truths == {}
    assert scenario().truths == ()
    (found,) = scenario(truths=[Targets([(0.5, 0.5), (0.7, 0.5)])]).truths
    assert found.number == 2


def test_several_sensors_are_kept_in_their_order() -> None:
    camera = Camera(8, 2.0)
    made = ExplorationScenario(GRID, ROBOT, [camera, LIDAR], START)
    assert made.sensors == made.perception.sensors == (camera, LIDAR)
    other = Perception([LIDAR, camera], 0.1, 0.2)
    message = r"perception is for ranges of \[1\.0, 2\.0\] m .*; accepted: .* \[2\.0, 1\.0\] m"
    with pytest.raises(ValueError, match=message):
        ExplorationScenario(GRID, ROBOT, [camera, LIDAR], START, perception=other)
    message = r"perception is for ranges of \[1\.0\] m .*; accepted: .* \[2\.0, 1\.0\] m"
    with pytest.raises(ValueError, match=message):
        ExplorationScenario(
            GRID, ROBOT, [camera, LIDAR], START, perception=Perception(LIDAR, 0.1, 0.2)
        )


def test_ground_that_may_not_be_entered_is_out_of_reach() -> None:
    made = ExplorationScenario(TERRAIN, ROBOT, LIDAR, (0.7, 0.5, 0.0))
    reachable = np.asarray(made.reachable)
    assert reachable[4, 3:13].all()
    assert not reachable[:, 13:].any()
    assert np.asarray(scenario().reachable)[4, 3:27].all()
    # It is no wall: the world stays as it is.
    np.testing.assert_array_equal(made.world.probability, WORLD)
    padded = made.map_arrays.ground
    for mine, expected in ((made.ground, TERRAIN.ground), (made.perception.ground, padded)):
        for one, other in zip(jax.tree.leaves(mine), jax.tree.leaves(expected), strict=True):
            np.testing.assert_array_equal(one, other)
    with pytest.raises(ValueError, match=r"goal is .* cannot reach from its start"):
        ExplorationScenario(TERRAIN, ROBOT, LIDAR, (0.7, 0.5, 0.0), goal=Goal((2.5, 0.5), 0.3))


def test_the_perception_shares_the_ground() -> None:
    plain = Perception(LIDAR, 0.1, 0.2)
    with pytest.raises(ValueError, match="perception has no ground; accepted: that of the world"):
        ExplorationScenario(TERRAIN, ROBOT, LIDAR, (0.7, 0.5, 0.0), perception=plain)
    hilly = Perception(LIDAR, 0.1, 0.2, ground=TERRAIN.ground)
    with pytest.raises(
        ValueError, match="perception has another ground; accepted: that of the world"
    ):
        scenario(perception=hilly)


def test_a_perception_for_another_ground_is_refused() -> None:
    other = Ground(np.zeros((30, 30)), 0.1)
    for ground in (other, Ground(np.zeros((29, 30)), 0.1)):
        message = r"perception has .* ground; accepted: that of the world"
        with pytest.raises(ValueError, match=message):
            ExplorationScenario(
                TERRAIN,
                ROBOT,
                LIDAR,
                (0.7, 0.5, 0.0),
                perception=Perception(LIDAR, 0.1, 0.2, ground=ground),
            )


def test_never_is_a_coverage_that_is_not_reached() -> None:
    assert float(scenario(target_coverage=None).target_coverage) > 1.0
    assert float(scenario(target_coverage=1.0).target_coverage) == 1.0


def test_a_goal_apart_is_reached_when_the_robot_is_there() -> None:
    goal = (2.5, 0.5)
    apart = Perception(LIDAR, 0.1, 0.2, goal=goal, is_goal_apart=True)
    numbers = [(made.goal.radius, made.goal.max_unknown) for made in (
        scenario(goal=goal), scenario(goal=goal, perception=apart),
        scenario(goal=Goal(goal, 0.7, max_unknown=0.3), perception=apart),
    )]  # fmt: skip
    np.testing.assert_allclose(numbers, [(0.15, 0.05), (0.15, 1.0), (0.7, 0.3)], rtol=1e-6)


@pytest.mark.parametrize("kind", ["rooms", "cave", "hall"])
def test_every_reachable_cell_can_be_seen_from_the_one_beside_it(kind: str) -> None:
    """So coverage of what is reachable is coverage of what is reachable and observable."""
    grid = generate_map(kind, 1)
    reachable = reachable_cells(grid, np.asarray(start_pose(grid)), 0.2)
    beside = {
        (row + down, column + right): (row, column)
        for row, column in np.argwhere(reachable)
        for down in (-1, 0, 1)
        for right in (-1, 0, 1)
        if down or right
    }
    cells = np.argwhere(reachable)
    assert all(tuple(cell) in beside for cell in cells)
    chosen = cells[:: max(1, len(cells) // 300)]
    targets = grid.frame.cell_centre(jnp.asarray(chosen))
    places = grid.frame.cell_centre(jnp.asarray([beside[tuple(cell)] for cell in chosen]))
    offset = targets - places
    yaw = jnp.arctan2(offset[:, 1], offset[:, 0])
    camera = Lidar(9, 5.0, field_of_view=math.pi / 2)
    poses = jnp.concatenate([places, yaw[:, None]], axis=1)
    seen = jax.jit(jax.vmap(lambda pose, point: camera.sees(grid, pose, point[None])))
    assert bool(seen(poses, targets).all())


@pytest.mark.parametrize(("front", "rear", "farthest"), [(5.0, 5.0, "0.0"), (2.3, 0.3, "0.[1-9]")])
def test_a_car_that_cannot_leave_its_place_is_refused(
    front: float, rear: float, farthest: str
) -> None:
    solid = np.ones((40, 40), np.float32)
    solid[5:35, 5:32] = 0.0  # a room of 2.7 m by 3 m
    car = Ackermann(footprint=Rectangle(front, rear, 0.4))
    perception = Perception(LIDAR, 0.1, 0.2, num_directions=4, car=car_motion(car))
    message = rf"a car of {front + rear:g} m by 0\.4 m with .* gets {farthest} m far at most"
    with pytest.raises(ValueError, match=message):
        ExplorationScenario(
            OccupancyGrid(solid, 0.1), car, LIDAR, (0.95, 2.0, 0.0), perception=perception
        )
