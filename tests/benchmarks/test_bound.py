"""Bounds of an exploration: tours, floors, views and ways, each against an oracle of its own."""

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from benchmarks.bound.floor import lower_bound
from benchmarks.bound.order import open_tour
from benchmarks.bound.problem import Problem
from benchmarks.bound.roads import OCTILE, Roads, is_straight, step_lengths
from benchmarks.bound.sight import Sight, count
from benchmarks.bound.tour import Planner, line_length
from hypothesis import given
from hypothesis import strategies as st

pytestmark = pytest.mark.long

Make = Callable[..., Problem]
SHAPE = (24, 40)


@pytest.mark.parametrize("number", range(1, 8))
def test_open_tours_are_as_short_as_the_best_of_all_orders(number: int) -> None:
    pytest.importorskip("pyvrp", reason="PyVRP is not installed")
    places = np.random.default_rng(number).uniform(0.0, 10.0, (number, 2))
    lengths = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))

    def total(order: tuple[int, ...]) -> float:
        return sum(lengths[a, b] for a, b in itertools.pairwise(order))

    found = open_tour(lengths)
    assert found[0] == 0
    assert sorted(found) == list(range(number))
    least = min(total((0, *rest)) for rest in itertools.permutations(range(1, number)))
    # PyVRP counts in millimetres.
    assert total(tuple(found)) <= least + 1e-3 * number


@pytest.mark.parametrize("lengths", [np.zeros((2, 3)), np.zeros((0, 0)), np.full((2, 2), np.inf)])
def test_lengths_of_another_shape_or_without_a_way_are_refused(lengths: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"lengths has .*; accepted: "):
        open_tour(lengths)


def corridor() -> np.ndarray:
    """Two corridors of 38 cells that no way joins; the robot fits in the middle row of each."""
    solid = np.ones(SHAPE, bool)
    solid[3:8, 1:39] = solid[12:17, 1:39] = False
    return solid


@pytest.mark.parametrize("share", [0.9, 0.99])
def test_the_tour_of_a_corridor_has_its_known_length(make_problem: Make, share: float) -> None:
    pytest.importorskip("pyvrp", reason="PyVRP is not installed")
    problem = make_problem(corridor(), (5.5, 3.5), sensors=_sensors(1.0))
    columns = problem.cells[:, 1]
    assert set(problem.cells[:, 0].tolist()) == {5}
    # The robot sees 1 m ahead and back, so it ends where that reaches the last cell it must see.
    last = columns.min() + problem.needed(share) - 1
    least = (last + 1 - 3.5) * 0.1 - 1.0
    tour = Planner(problem, rounds=5).tour(share)
    assert tour.coverage >= share - 1e-6
    assert least - 1e-3 <= tour.metres <= least + 0.05
    floor = lower_bound(problem, share)
    assert 0.0 < floor.reach <= least
    assert floor.metres <= least
    assert problem.seconds(tour.metres) == pytest.approx(tour.metres + 0.5)


def _sensors(max_range: float) -> tuple[object, ...]:
    from jaxplore.sensing.lidar import Lidar

    return (Lidar(num_beams=64, max_range=max_range, range_noise=0.02),)


def rooms(seed: int) -> np.ndarray:
    """A hall with pillars and a wall across with a door."""
    rng = np.random.default_rng(seed)
    solid = np.zeros(SHAPE, bool)
    solid[[0, -1]] = solid[:, [0, -1]] = True
    solid[:, 20] = True
    solid[8:14, 20] = False
    for row, column in rng.integers((2, 8), (SHAPE[0] - 2, SHAPE[1] - 2), (5, 2)):
        solid[row : row + 2, column : column + 2] = True
    solid[3:9, 3:7] = False
    return solid


def test_a_tour_sees_what_it_says_and_stays_where_the_robot_fits(make_problem: Make) -> None:
    pytest.importorskip("pyvrp", reason="PyVRP is not installed")
    problem = make_problem(rooms(0), (5.5, 5.5))
    planner = Planner(problem, rounds=10)
    tour = planner.tour(0.99)
    ways = list(zip(tour.line[:-1], tour.line[1:], strict=True))
    assert np.allclose(tour.line[0], problem.start)
    assert all(is_straight(problem.reachable, problem.free, *way) for way in ways)
    assert tour.metres == pytest.approx(sum(math.dist(*way) for way in ways) * 0.1)
    # Scan by scan, by a robot of its own.
    seen = np.zeros(problem.num_cells, bool)
    for one, other in ways:
        number = math.ceil(math.dist(one, other) / problem.scan_step - 1e-3)
        for along in [*(np.arange(number) * problem.scan_step), math.dist(one, other)]:
            place = one + along / math.dist(one, other) * (other - one)
            yaw = np.array([problem.heading(one, other)])
            seen |= planner.sight.unpacked(planner.sight.views(place[None], yaw))[0]
    assert seen.mean() == pytest.approx(tour.coverage)
    assert tour.coverage >= 0.99 - 1e-6
    assert lower_bound(problem, 0.99).metres <= tour.metres
    assert planner.tour(0.9).metres <= tour.metres


@pytest.mark.parametrize("seed", [1, 2])
def test_a_view_holds_the_cells_that_beams_cross(make_problem: Make, seed: int) -> None:
    origin = (4.0, -2.0, 0.7)
    problem = make_problem(rooms(seed), (5.5, 5.5), origin)
    rng = np.random.default_rng(seed)
    places = problem.cells[rng.choice(problem.num_cells, 4)] + rng.uniform(0.2, 0.8, (4, 2))
    yaws = rng.uniform(-3.0, 3.0, 4)
    sight = Sight(problem)
    views = sight.unpacked(sight.views(places, yaws))
    (lidar,) = problem.sensors
    is_solid = np.asarray(problem.world.probability) > 0.5
    step = 1e-3
    for place, yaw, view in zip(places, yaws, views, strict=True):
        surely, maybe = np.zeros(SHAPE, bool), np.zeros(SHAPE, bool)
        for angle in yaw - origin[2] + lidar.beam_angles.astype(np.float64):
            along = np.arange(0.5 * step, lidar.max_range / 0.1, step)
            ray = place + along[:, None] * np.array([np.sin(angle), np.cos(angle)])
            row, column = np.floor(ray).astype(int).T
            blocked = is_solid[np.clip(row, 0, 23), np.clip(column, 0, 39)]
            end = int(blocked.argmax()) if blocked.any() else len(along)
            cells, chords = np.unique(row[:end] * 40 + column[:end], return_counts=True)
            # A cell counts if the beam is in it for at least the deviation of a reading.
            chords = chords * step
            last = row[end - 1] * 40 + column[end - 1] if not blocked.any() else -1
            surely.flat[cells[(chords > 0.2 + 0.01) & (cells != last)]] = True
            maybe.flat[cells[chords > 0.2 - 0.01]] = True
        inside = tuple(problem.cells.T)
        assert (view[surely[inside]]).all()
        assert (maybe[inside][view]).all()
    assert count(sight.views(places, yaws)).tolist() == views.sum(axis=1).tolist()


@given(st.integers(0, 2**32 - 1))
def test_ways_on_the_lattice_are_between_the_straight_line_and_the_steps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    free = np.ones((12, 15), bool)
    free[rng.random(free.shape) < 0.25] = False
    start = np.argwhere(free)[rng.integers(int(free.sum()))]
    # A point robot: what is free is reachable.
    reachable = np.isfinite(step_lengths(free, free, start[None]))
    problem = _point_problem(free, reachable, start + 0.5)
    roads = Roads(problem, 3)
    lengths, places = roads.lengths, roads.places
    assert np.isfinite(lengths).all()
    straight = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    assert (lengths >= straight - 1e-5).all()
    steps = step_lengths(free, free, start[None])[tuple(np.floor(places).astype(int).T)]
    last = int(steps.argmax())
    line = roads.line(roads.stops(0, last))
    assert np.allclose(line[0], places[0])
    assert np.allclose(line[-1], places[last])
    assert line_length(line) == pytest.approx(lengths[0, last], abs=1e-4)
    for one, other in itertools.pairwise(line):
        assert is_straight(reachable, free, one, other)


def _point_problem(free: np.ndarray, reachable: np.ndarray, start: np.ndarray) -> Problem:
    import jax.numpy as jnp

    from jaxplore.maps.occupancy_grid import OccupancyGrid

    world = OccupancyGrid(jnp.asarray(~free, jnp.float32), 0.1)
    return Problem(world, (), reachable, start.astype(float), 1.0, 1.0, 0.1, 0.01)


@given(st.integers(0, 2**32 - 1))
def test_a_line_is_straight_where_samples_of_it_are_in_the_mask(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask = rng.random((9, 9)) < 0.8
    first, last = rng.uniform(0.0, 9.0, (2, 2))
    line = first + np.linspace(0.0, 1.0, 20001)[:, None] * (last - first)
    cells, samples = np.unique(np.floor(line).astype(int), axis=0, return_counts=True)
    # Cells that the line is in for less than a thousandth of a cell may go either way.
    clear = samples * math.dist(first, last) / 20000 > 1e-3
    found = is_straight(mask, np.ones_like(mask), first, last)
    if not mask[tuple(cells[clear].T)].all():
        assert not found
    elif mask[tuple(cells.T)].all():
        assert found or math.dist(first, last) < 1e-3
    assert not is_straight(mask, mask, np.array([0.5, 0.5]), np.array([0.5, 9.5]))


def test_a_line_does_not_slip_through_a_corner() -> None:
    mask = np.eye(3, dtype=bool)
    ends = np.array([0.5, 0.5]), np.array([2.5, 2.5])
    assert not is_straight(mask, mask, *ends)
    assert is_straight(mask, np.ones_like(mask), *ends)


def test_steps_are_at_most_an_octile_ratio_longer_than_the_straight_line() -> None:
    mask = np.ones((30, 40), bool)
    lengths = step_lengths(mask, mask, np.array([[15, 20]]))
    away = np.hypot(*(np.argwhere(mask) - (15, 20)).T).reshape(mask.shape)
    assert (lengths >= away - 1e-9).all()
    assert (lengths <= OCTILE * away + 1e-9).all()
    assert np.isinf(step_lengths(mask, mask, np.array([[15, 20]]), 5.0)[0, 0])


def test_problems_without_a_bound_are_refused(make_problem: Make) -> None:
    from jaxplore.sensing.lidar import Lidar
    from jaxplore.tasks.registry import make_settings

    with pytest.raises(ValueError, match="field_of_view of a sensor is 180 degrees; accepted: 360"):
        make_problem(corridor(), (5.5, 3.5), sensors=(Lidar(field_of_view=math.pi),))
    car = make_settings({"map": "office", "robot": {"model": "ackermann"}})
    with pytest.raises(ValueError, match=r"robot.model is 'ackermann'; accepted: robots that turn"):
        Problem.from_settings(car)
    doubtful = make_settings({"map": "office", "sensor_model": {"free": -0.4}})
    with pytest.raises(ValueError, match=r"sensor_model makes a cell free by -0.4"):
        Problem.from_settings(doubtful)


def test_times_of_ways(make_problem: Make) -> None:
    problem = make_problem(corridor(), (5.5, 3.5), speed=2.0, acceleration=1.0)
    assert problem.seconds(10.0) == pytest.approx(6.0)
    assert problem.seconds(0.5) == pytest.approx(1.0)
