"""The cost-to-go to a goal in a volume against Dijkstra's algorithm in double precision."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.belief.test_volume_geodesic import SHAPE, plain

from jaxplore.belief.volume_goal import AHEAD, goal_roads, goal_sources, way_ahead
from jaxplore.belief.volume_roads import VolumeRoads

SPACING, REQUIRED, LEAST, FACTOR = 0.4, 0.4, 0.42, 0.5
ORIGIN = np.array([1.0, -2.0, 0.3], np.float32)
HALVES = tuple(2 * n - 1 for n in SHAPE)


@jax.jit
def costs_of(half_open, wall_room, near, goal, position):
    ones = jnp.ones(SHAPE)
    known = VolumeRoads(half_open, ones, jnp.asarray(ORIGIN), SPACING)
    numbers = (jnp.float32(each) for each in (REQUIRED, LEAST))
    ways = goal_roads(known, wall_room, *numbers, near, jnp.float32(FACTOR))
    costs = ways.lengths(goal_sources(ways, goal))
    return costs, way_ahead(costs, ways, position)


def places() -> np.ndarray:
    """Return the positions (D, H, W, 3) of the nodes as (x, y, z)."""
    index = np.stack(np.indices(SHAPE), axis=-1)[..., ::-1]
    return ORIGIN.astype(np.float64) + SPACING * index


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
    found, way = costs_of(half_open, wall_room, near, goal, goal + np.float32(0.1))

    passable = wall_room.astype(np.float64) >= np.float32(LEAST)
    nodes = passable[::2, ::2, ::2]
    tight = np.clip(3.0 - wall_room[::2, ::2, ::2].astype(np.float64) / REQUIRED, 0.0, 2.0) / 2.0
    unknown = ~half_open[::2, ::2, ::2]
    slowness = (1.0 + tight) * (1.0 + unknown * (FACTOR + near.astype(np.float64) ** 2))
    away = np.where(nodes, np.linalg.norm(at - goal, axis=-1), np.inf)
    ends = np.flatnonzero(away <= away.min() + SPACING + 1e-6)
    wanted = np.min(
        [SPACING * plain([end], slowness, passable) + away.reshape(-1)[end] for end in ends], axis=0
    )
    np.testing.assert_allclose(found, wanted, rtol=1e-5)
    assert np.hypot(*np.asarray(way)) <= 1.0 + 1e-5


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
    costs, way = costs_of(free, wall_room, near, *given)
    assert float(costs[1, 1, 2]) > 2.0 * np.linalg.norm(goal - here)
    # Four nodes along y: the door is farther away than these.
    assert at[1, -1, 2][1] - here[1] > AHEAD * SPACING
    assert way[1] > 0.9 > way[0] >= 0.0
    # Without any open node there is no way.
    _, way = costs_of(np.zeros(HALVES, bool), np.zeros(HALVES, np.float32), near, *given)
    np.testing.assert_array_equal(way, 0.0)
