"""The way to a goal against Dijkstra's algorithm on the same lattice, in double precision."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.ndimage
import scipy.sparse
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import dijkstra

from jaxplore import OccupancyGrid
from jaxplore.belief.exploration_field import goal_field
from jaxplore.belief.roadmap import TurnsOnTheSpot

SHAPE, RESOLUTION, STRIDE, LAYERS = (22, 29), 0.1, 2, 3
REQUIRED, FACTOR, MOST = 0.15, 0.5, 1.0
ORIGIN = (1.0, -2.0, 0.0)
SPACING = STRIDE * RESOLUTION
ROWS, COLUMNS = 11, 15
FREE, UNKNOWN, OCCUPIED = 0.05, 0.5, 0.95


@jax.jit
def field_of(probability, blocked, goal, required, factor):
    return goal_field(
        OccupancyGrid(probability, RESOLUTION, ORIGIN),
        blocked,
        goal,
        required,
        TurnsOnTheSpot(),
        unknown_factor=factor,
        max_clearance=MOST,
        stride=STRIDE,
    )


def found_field(p: np.ndarray, goal, blocked: np.ndarray | None = None, factor: float = FACTOR):
    blocked = np.zeros(SHAPE, bool) if blocked is None else blocked
    numbers = (jnp.asarray(value, jnp.float32) for value in (p, goal, REQUIRED, factor))
    probability, place, required, factor_ = numbers
    return field_of(probability, jnp.asarray(blocked), place, required, factor_)


def node_centres() -> np.ndarray:
    """Return where the nodes are (ROWS, COLUMNS, 2) [m]."""
    rows, columns = np.mgrid[:ROWS, :COLUMNS] + 0.5
    return np.stack([columns * SPACING, rows * SPACING], axis=-1) + ORIGIN[:2]


def lattice(p: np.ndarray, blocked: np.ndarray, factor: float) -> tuple[np.ndarray, np.ndarray]:
    """Return which nodes are open and what they cost a metre (ROWS, COLUMNS), by the definition."""
    solid = (p > 0.65) | blocked
    around = np.pad(solid, 1, constant_values=True)
    away = scipy.ndimage.distance_transform_edt(~around)[1:-1, 1:-1]
    clearance = np.clip((away - 0.5) * RESOLUTION, 0.0, MOST)
    is_unknown = (p >= 0.25) & (p <= 0.65)
    is_open, cost = np.zeros((ROWS, COLUMNS), bool), np.zeros((ROWS, COLUMNS))
    for row in range(ROWS):
        for column in range(COLUMNS):
            block = np.s_[2 * row : 2 * row + 2, 2 * column : 2 * column + 2]
            room = clearance[block].max()
            is_open[row, column] = room >= REQUIRED - 1e-4
            # Six times where it just fits, once where there is three times the room.
            tight = min(max(1.0 - (room - REQUIRED) / (2.0 * REQUIRED), 0.0), 1.0)
            share = is_unknown[block].sum() / 4.0
            cost[row, column] = (1.0 + 5.0 * tight**4) * (1.0 + factor * share)
    return is_open, cost


def ways(is_open: np.ndarray, cost: np.ndarray, goal) -> np.ndarray:
    """Return the cost to go from every node [m]; infinite where there is no way."""
    away = np.hypot(*np.moveaxis(node_centres() - goal, -1, 0))
    away = np.where(is_open, away, np.inf)
    edges = []
    for row, column in np.argwhere(is_open):
        for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
            there = (row + down, column + right)
            if there[0] < ROWS and 0 <= there[1] < COLUMNS and is_open[there]:
                length = SPACING * math.hypot(down, right)
                price = length * 0.5 * (cost[row, column] + cost[there])
                edges.append((row * COLUMNS + column, there[0] * COLUMNS + there[1], price))
        if away[row, column] <= away.min() + SPACING:
            # From the goal itself, the last node; a way of no length would be none.
            price = max(away[row, column], 1e-12)
            edges.append((ROWS * COLUMNS, row * COLUMNS + column, price))
    if not edges:
        return np.full((ROWS, COLUMNS), np.inf)
    start, end, price = np.array(edges).T
    size = ROWS * COLUMNS + 1
    graph = scipy.sparse.coo_matrix((price, (start, end)), (size, size)).tocsr()
    return dijkstra(graph, directed=False, indices=size - 1)[:-1].reshape(ROWS, COLUMNS)


@settings(max_examples=25)
@given(
    st.integers(0, 2**32 - 1),
    st.floats(0.02, 0.12),
    st.tuples(st.floats(0.0, 2.9), st.floats(0.0, 2.2)),
)
def test_it_is_the_shortest_path_through_what_is_not_known_to_be_blocked(
    seed: int, density: float, inside: tuple[float, float]
) -> None:
    rng = np.random.default_rng(seed)
    p = rng.choice([FREE, UNKNOWN, OCCUPIED], SHAPE, p=[0.6, 0.4 - density, density])
    p[rng.integers(0, 22) :, rng.integers(0, 29) :] = UNKNOWN
    blocked = rng.random(SHAPE) < 0.01
    goal = np.add(inside, ORIGIN[:2])
    is_open, cost = lattice(p, blocked, FACTOR)
    # A node just one spacing farther away than the nearest one is a source or none, by rounding.
    away = np.hypot(*np.moveaxis(node_centres() - goal, -1, 0))[is_open]
    assume(away.size and np.abs(away - away.min() - SPACING).min() > 1e-5)
    expected = ways(is_open, cost, goal)
    reached = np.isfinite(expected)
    assume(reached.any())
    found = np.asarray(found_field(p, goal, blocked).values)
    np.testing.assert_allclose(found[reached], expected[reached], rtol=1e-4, atol=1e-4)
    # Wherever there is no way it is farther than from the nodes around, or half way between the
    # ends of a diagonal step past the node, and finite.
    assert np.isfinite(found).all()
    around = np.pad(np.where(reached, expected, np.inf), 1, constant_values=np.inf)
    for row, column in np.argwhere(~reached):
        near = around[row : row + 3, column : column + 3]
        passing = [
            0.5 * (near[down, 1] + near[1, right])
            for down in (0, 2)
            for right in (0, 2)
            if np.isinf(near[down, right])
        ]
        if np.isfinite(passing).any():
            assert found[row, column] == pytest.approx(min(passing), rel=1e-4, abs=1e-4)
        else:
            assert found[row, column] >= np.where(np.isfinite(near), near, -np.inf).max()


def followed(field, start, steps: int = 400) -> np.ndarray:
    """Return the path (n, 2) of who follows the field's direction, in steps of 2 cm."""
    step = jax.jit(lambda place: place + 0.02 * field.direction(place))

    def advance(place, _):
        after = step(place)
        return after, after

    start = jnp.asarray(start, jnp.float32)
    return np.asarray(jax.lax.scan(advance, start, None, steps)[1])


# A wall from south to north with a gap in the north, of which the middle is not known.
START, GOAL = (1.4, -0.9), (3.5, -0.9)


def hall(middle: float) -> np.ndarray:
    p = np.full(SHAPE, FREE)
    p[:17, 14] = OCCUPIED
    p[7:15, 14] = middle
    return p


def test_through_a_wall_known_in_part_the_way_leads_through_what_is_not_known() -> None:
    direct, around = (found_field(hall(middle), GOAL) for middle in (UNKNOWN, OCCUPIED))
    at_start = [float(each(jnp.asarray(START))) for each in (direct, around)]
    assert at_start[0] < at_start[1] - 0.5
    through, by = (followed(each, START) for each in (direct, around))
    for path in (through, by):
        assert np.hypot(*(path[-1] - GOAL)) < 0.25
    crossing = [path[np.argmin(np.abs(path[:, 0] - 2.45)), 1] for path in (through, by)]
    # The unknown middle is from -1.3 to -0.5 m, the gap begins at -0.3 m.
    assert -1.3 < crossing[0] < -0.5
    assert crossing[1] > -0.3


def test_where_the_unknown_counts_more_known_space_is_worth_a_detour() -> None:
    p = hall(OCCUPIED)
    p[7:15, 14] = UNKNOWN
    p[3:17, 10:20] = UNKNOWN
    at_once, never = (followed(found_field(p, GOAL, factor=f), START, 600) for f in (0.0, 50.0))
    crossing = [path[np.argmin(np.abs(path[:, 0] - 2.45)), 1] for path in (at_once, never)]
    assert crossing[0] < -0.5
    assert crossing[1] > -0.3
    assert np.hypot(*(never[-1] - GOAL)) < 0.25


def test_blocked_ground_closes_cells_as_walls_do() -> None:
    free = np.full(SHAPE, FREE)
    blocked = hall(OCCUPIED) > 0.65
    walled = found_field(hall(OCCUPIED), GOAL)
    closed = found_field(free, GOAL, blocked)
    np.testing.assert_array_equal(closed.values, walled.values)
    np.testing.assert_array_equal(closed.descent, walled.descent)
    unblocked = found_field(free, GOAL)
    assert float(unblocked(jnp.asarray(START))) < float(closed(jnp.asarray(START))) - 0.5


def test_no_blocked_ground_is_the_same_as_none_blocked() -> None:
    numbers = (jnp.asarray(value, jnp.float32) for value in (hall(UNKNOWN), GOAL, REQUIRED, FACTOR))
    probability, goal, required, factor = numbers
    made = field_of(probability, None, goal, required, factor)
    np.testing.assert_array_equal(made.values, found_field(hall(UNKNOWN), GOAL).values)


def test_a_goal_in_a_wall_is_approached_as_near_as_there_is_a_node() -> None:
    p = np.full(SHAPE, FREE)
    p[6:16, 12:20] = OCCUPIED  # x from 2.2 to 3 m, y from -1.4 to -0.4 m
    goal = np.array([2.25, -0.85])
    field = found_field(p, goal)
    is_open, _ = lattice(p, np.zeros(SHAPE, bool), FACTOR)
    centres = node_centres()
    away = np.where(is_open, np.hypot(*np.moveaxis(centres - goal, -1, 0)), np.inf)
    values = np.where(is_open, np.asarray(field.values), np.inf)
    nearest = np.unravel_index(np.argmin(values), values.shape)
    assert away[nearest] == pytest.approx(away.min(), abs=1e-4)
    assert values[nearest] == pytest.approx(away.min(), abs=1e-4)
    # From the other side the way leads round, not through.
    path = followed(field, (3.5, -0.85), 600)
    cells = np.floor((path - ORIGIN[:2]) / RESOLUTION).astype(int)
    assert (p[cells[:, 1], cells[:, 0]] < 0.5).all()
    assert np.hypot(*(path[-1] - goal)) < away.min() + 0.2


def test_where_nothing_is_open_the_field_is_finite_and_flat() -> None:
    field = found_field(np.full(SHAPE, OCCUPIED), GOAL)
    assert np.isfinite(field.values).all()
    np.testing.assert_array_equal(field.descent, 0.0)
    assert float(field(jnp.asarray([50.0, 50.0]))) == pytest.approx(1e4)
