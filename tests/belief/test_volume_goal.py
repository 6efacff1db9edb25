"""The cost-to-go to a goal in a volume against Dijkstra's algorithm in double precision."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage
from tests.belief.test_volume_geodesic import SHAPE, plain

from jaxplore.belief.volume_goal import (
    AHEAD,
    goal_roads,
    look_sources,
    resting_place,
    sees,
    unknown_around,
    way_ahead,
)
from jaxplore.belief.volume_roads import VolumeRoads
from jaxplore.maps.volume_field import VolumeField
from jaxplore.maps.voxel_grid import VoxelGrid

SPACING, REQUIRED, LEAST, FACTOR = 0.4, 0.4, 0.42, 0.5
ORIGIN = np.array([1.0, -2.0, 0.3], np.float32)
HALVES = tuple(2 * n - 1 for n in SHAPE)


@jax.jit
def costs_of(half_open, wall_room, near, goal, position):
    ones = jnp.ones(SHAPE)
    known = VolumeRoads(half_open, ones, jnp.asarray(ORIGIN), SPACING)
    numbers = (jnp.float32(each) for each in (REQUIRED, LEAST))
    ways = goal_roads(known, wall_room, *numbers, near, jnp.float32(FACTOR))
    costs = ways.lengths(ways.around(goal))
    field = ways.extend(costs, known.is_open).values
    return costs, way_ahead(costs, ways, position), field


def places() -> np.ndarray:
    """Return the positions (D, H, W, 3) of the nodes as (x, y, z)."""
    index = np.stack(np.indices(SHAPE), axis=-1)[..., ::-1]
    return ORIGIN.astype(np.float64) + SPACING * index


def extended(costs: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Return costs with values in closed nodes, node by node: four layers of the greatest value
    beside known nodes, then four of the least one beside any."""
    is_closed = ~np.isfinite(costs)
    values = np.where(is_closed | ~known, np.nan, costs)
    for choose in (max, min):
        for _ in range(4):
            before = values.copy()
            for node in np.argwhere(is_closed):
                beside = []
                for axis, step in itertools.product(range(3), (-1, 1)):
                    there = node.copy()
                    there[axis] += step
                    if 0 <= there[axis] < SHAPE[axis] and np.isfinite(before[tuple(there)]):
                        beside.append(before[tuple(there)])
                if np.isnan(before[tuple(node)]) and beside:
                    values[tuple(node)] = choose(beside) + 2.0 * SPACING
        values = np.where(is_closed, values, costs)
    return np.where(np.isnan(values), 1e4, values)


@settings(max_examples=20)
@given(st.integers(0, 2**31))
def test_the_cost_to_go_is_that_of_dijkstra(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wall_room = rng.uniform(0.3, 1.5, HALVES).astype(np.float32)
    # Where the robot is known to fit, there are no walls either.
    half_open = (rng.random(HALVES) < 0.5) & (wall_room >= LEAST)
    near = rng.uniform(0.0, 5.0, SHAPE).astype(np.float32)
    at = places()
    low, high = at.reshape(-1, 3).min(axis=0), at.reshape(-1, 3).max(axis=0)
    goal = rng.uniform(low, high).astype(np.float32)
    found, way, field = costs_of(half_open, wall_room, near, goal, goal + np.float32(0.1))

    passable = wall_room.astype(np.float64) >= np.float32(LEAST)
    nodes = passable[::2, ::2, ::2]
    tight = np.clip(3.0 - wall_room[::2, ::2, ::2].astype(np.float64) / REQUIRED, 0.0, 2.0) / 2.0
    unknown = ~half_open[::2, ::2, ::2]
    slowness = (1.0 + tight) * (1.0 + unknown * (FACTOR + near.astype(np.float64) ** 2))
    # Only nodes to which open points of half the spacing lead from the one nearest to the goal.
    halves = ORIGIN + 0.5 * SPACING * np.stack(np.indices(HALVES), axis=-1)[..., ::-1]
    far = np.where(passable, np.linalg.norm(halves - goal.astype(np.float64), axis=-1), np.inf)
    cube = np.ones((3, 3, 3))
    joined = ndimage.binary_dilation(far == far.min(), cube, iterations=4, mask=passable)
    away = np.where(nodes & joined[::2, ::2, ::2], np.linalg.norm(at - goal, axis=-1), np.inf)
    ends = np.flatnonzero(away <= away.min() + SPACING + 1e-6)
    wanted = np.min(
        [SPACING * plain([end], slowness, passable) + away.reshape(-1)[end] for end in ends], axis=0
    )
    np.testing.assert_allclose(found, wanted, rtol=1e-5)
    assert np.hypot(*np.asarray(way)) <= 1.0 + 1e-5
    costs = np.asarray(found, np.float64)
    np.testing.assert_allclose(field, extended(costs, ~unknown), rtol=1e-5)


@pytest.mark.long
def test_the_way_leads_through_the_door_and_not_to_the_goal_behind_the_wall() -> None:
    wall_room = np.full(HALVES, 2.0, np.float32)
    # A wall across x with a door at the far end of y.
    wall_room[:, :-2, 8] = 0.0
    at = places()
    near = np.zeros(SHAPE, np.float32)
    free = wall_room > 1.0
    here, goal = at[1, 1, 2], at[1, 1, 7]
    given = [np.asarray(each, np.float32) for each in (goal, here)]
    costs, way, _ = costs_of(free, wall_room, near, *given)
    assert float(costs[1, 1, 2]) > 2.0 * np.linalg.norm(goal - here)
    # Four nodes along y: the door is farther away than these.
    assert at[1, -1, 2][1] - here[1] > AHEAD * SPACING
    assert way[1] > 0.9 > way[0] >= 0.0
    # Without any open node there is no way.
    _, way, _ = costs_of(np.zeros(HALVES, bool), np.zeros(HALVES, np.float32), near, *given)
    np.testing.assert_array_equal(way, 0.0)


@pytest.mark.parametrize("knows_behind", [False, True])
def test_a_wall_does_not_attract_a_robot_that_has_a_long_way_around_it(knows_behind) -> None:
    # Of the two sides of a wall across x the other one is much nearer to the goal.
    wall_room = np.full(HALVES, 2.0, np.float32)
    wall_room[:, :-2, 6:11] = 0.0
    free = (wall_room > 1.0) & (knows_behind | (np.arange(HALVES[2]) < 8))
    at = places()
    given = [np.asarray(each, np.float32) for each in (at[1, 1, 7], at[1, 1, 1])]
    costs, _, field = costs_of(free, wall_room, np.zeros(SHAPE, np.float32), *given)
    assert costs[1, 1, 2] > costs[1, 1, 6] + 3.0
    # Nodes 3 to 5 are closed: from the robot's side on the field rises into the wall.
    assert (np.diff(np.asarray(field)[1, 1, 2:5]) > 0.0).all()


BOX, SIDE = (12, 14, 16), 0.1
CORNER = np.array([0.5, -0.3, 0.2], np.float32)


def field_of(values: np.ndarray) -> VolumeField:
    return VolumeField(
        jnp.asarray(values, jnp.float32), jnp.asarray(CORNER + 0.5 * SIDE), SIDE, jnp.zeros(())
    )


rest = jax.jit(lambda *given: resting_place(*map(field_of, given[:2]), *given[2:]))


@settings(max_examples=30)
@given(st.integers(0, 2**31), st.floats(0.05, 0.4))
def test_the_robot_rests_at_the_place_with_room_next_to_the_goal(seed: int, reach: float) -> None:
    rng = np.random.default_rng(seed)
    walls = ndimage.gaussian_filter(rng.uniform(-1.0, 2.0, BOX), 1.0)
    # What is not known to be free is no farther away than walls.
    known = walls - ndimage.gaussian_filter(rng.uniform(0.0, 0.6, BOX), 1.0)
    goal = CORNER + 0.5 + rng.uniform(0.0, 0.3, 3)
    radius = 0.3
    given = [np.asarray(each, np.float32) for each in (known, walls, goal, reach, radius)]
    place, fits = rest(*given)
    place = np.asarray(place, np.float64)
    away = np.linalg.norm(place - goal)
    assert away <= 0.9 * reach + 1e-5

    # In double precision, by SciPy's interpolation, at many more places in the ball.
    def room(values: np.ndarray, points: np.ndarray) -> np.ndarray:
        grid = (points - CORNER)[..., ::-1] / SIDE - 0.5
        return ndimage.map_coordinates(values, grid.T, order=1, mode="nearest")

    ways = rng.normal(size=(4000, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    others = goal + 0.9 * reach * ways * rng.random((4000, 1)) ** (1 / 3)
    field = known if fits else walls
    found, there = room(field, place[None])[0], room(field, others)
    # A lattice of a quarter of the ball's radius: nothing within it is much better.
    slack = 0.9 * reach * 0.25 * np.sqrt(3.0) * (1.0 + 2.0 * 0.6 / SIDE)
    if fits:
        assert found >= radius - 1e-4
    else:
        assert room(known, goal[None])[0] < radius
    cost = np.linalg.norm(others - goal, axis=1) + 2.0 * np.maximum(radius + 0.05 - there, 0.0)
    if (there >= radius).any() and found >= radius:
        mine = away + 2.0 * max(radius + 0.05 - found, 0.0)
        assert mine <= cost[there >= radius].min() + slack


def test_a_goal_with_room_is_where_the_robot_rests() -> None:
    roomy = np.full(BOX, 0.6, np.float32)
    goal = CORNER + np.float32(0.55)
    place, fits = rest(roomy, roomy, goal, np.float32(0.15), np.float32(0.3))
    np.testing.assert_array_equal(place, goal)
    assert bool(fits)
    # Unknown all around: it will rest there, but is not known to fit.
    place, fits = rest(0.0 * roomy, roomy, goal, np.float32(0.15), np.float32(0.3))
    np.testing.assert_array_equal(place, goal)
    assert not bool(fits)


LOW, HIGH, RANGE = -0.5, 0.5, 5.0
VOXELS, EDGE = (15, 40, 40), 0.1
see = jax.jit(lambda grid, *given: sees(grid, (LOW, HIGH), RANGE, *given))


@settings(max_examples=20)
@given(st.integers(0, 2**31))
def test_lines_of_sight_are_those_that_small_steps_find(seed: int) -> None:
    rng = np.random.default_rng(seed)
    states = np.full(VOXELS, -5.0, np.float32)
    for value in (5.0, 0.0, 5.0):
        low = rng.integers(0, [8, 30, 30])
        states[tuple(slice(a, a + b) for a, b in zip(low, (6, 8, 8), strict=True))] = value
    places = rng.uniform(0.1, [3.9, 3.9, 1.4], (60, 3)).astype(np.float32)
    point = rng.uniform(0.5, [3.5, 3.5, 1.0]).astype(np.float32)
    found = np.asarray(see(VoxelGrid(states, EDGE), places, point))
    for is_seen, place in zip(found, places.astype(np.float64), strict=True):
        gap = point - place
        length, lift = np.linalg.norm(gap), np.arctan2(gap[2], np.hypot(*gap[:2]))
        is_in = 0.8 <= length <= 3.0 and LOW + 0.1 <= lift <= HIGH - 0.1
        shares = np.linspace(0.0, 1.0, 2000)
        at = place + shares[:, None] * gap
        met = states[tuple(np.floor(at / EDGE).astype(int)[:, ::-1].T)]
        is_end = (1.0 - shares) * length <= 0.5
        is_free = ((met < -1.0) | (is_end & (met < 1.0))).all()
        if is_seen != (is_in and is_free):
            # Only a line that passes less than a step through what blocks it may be missed.
            blocked = ~((met < -1.0) | (is_end & (met < 1.0)))
            assert is_seen
            assert is_in
            assert blocked.sum() / 2000 * length < 0.12


def test_the_robot_looks_from_where_it_sees_what_is_unknown() -> None:
    # A room of 4 m by 4 m by 1.5 m, unknown below a goal in its middle, the robot beside that.
    states = np.full((15, 40, 40), -5.0, np.float32)
    states[:5, 18:23, 18:23] = 0.0
    grid = VoxelGrid(states, EDGE)
    goal = jnp.array([2.05, 2.05, 0.7])
    point = np.asarray(unknown_around(grid, goal, jnp.float32(0.3)))
    # The middle of the voxels in the ball that are unknown, by hand.
    centres = (np.stack(np.indices(states.shape), axis=-1)[..., ::-1] + 0.5) * EDGE
    inside = (np.linalg.norm(centres - np.asarray(goal), axis=-1) <= 0.35) & (states == 0.0)
    np.testing.assert_allclose(point, centres[inside].mean(axis=0), atol=0.05)
    nodes = (3, 9, 9)
    halves = jnp.ones(tuple(2 * n - 1 for n in nodes), bool)
    roads = VolumeRoads(halves, jnp.ones(nodes), jnp.array([0.3, 0.3, 0.3]), 0.4)
    source = np.asarray(
        look_sources(grid, roads, (LOW, HIGH), RANGE, jnp.zeros((8, *nodes)), jnp.asarray(point))
    )
    x, y, z = (np.asarray(each) for each in roads.places)
    away = np.sqrt((x - point[0]) ** 2 + (y - point[1]) ** 2 + (z - point[2]) ** 2)
    assert (away[np.isfinite(source)] >= 0.8).all()
    assert np.isfinite(source).sum() > 20
    np.testing.assert_array_equal(source[np.isfinite(source)], 0.0)
    # Where the robot has looked in vain for 2 s, another place is better by as many metres.
    dwell = np.zeros((8, *nodes), np.float32)
    turns = np.arctan2(point[1] - y, point[0] - x) / (2.0 * np.pi / 8)
    # The node whose bearing is farthest from the edge of a sector.
    clear = np.where(np.isfinite(source), np.abs(turns % 1.0 - 0.5), np.inf)
    node = np.unravel_index(np.argmin(clear), clear.shape)
    sector = int(np.floor(turns[node])) % 8
    dwell[(sector, *node)] = 2.0
    again = np.asarray(
        look_sources(grid, roads, (LOW, HIGH), RANGE, jnp.asarray(dwell), jnp.asarray(point))
    )
    assert again[node] == 2.0
    assert np.isfinite(again).sum() == np.isfinite(source).sum()
    assert (again[np.isfinite(again)] == 0.0).sum() == np.isfinite(source).sum() - 1
