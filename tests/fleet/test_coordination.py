"""Claims and assignments agree with computations by other means."""

import inspect
import itertools
import math
import types

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import OccupancyGrid
from jaxplore.belief.belief import Belief
from jaxplore.belief.claims import claim_cost, trust_in
from jaxplore.robot.robot import Knowledge, RobotState
from jaxplore.simulation.exploration.state import ExplorationState
from jaxplore.simulation.fleet.assignment import (
    ELSEWHERE,
    NO_WAY,
    assign_clusters,
    cluster_costs,
    frontier_clusters,
    with_assignments,
)
from jaxplore.simulation.fleet.radio import Heard, Radio


@pytest.mark.parametrize("seed", range(3))
def test_claims_are_those_of_a_loop_over_places(seed) -> None:
    rng = np.random.default_rng(seed)
    own, others = rng.uniform(0, 30, (4, 5)), rng.uniform(0, 30, (3, 4, 5))
    own[0, 0], others[1, 2, 2], trust = np.inf, np.inf, np.array([1.0, 0.4, 0.0])
    args = (jnp.asarray(each, jnp.float32) for each in (own, others, trust))
    cost = claim_cost(*args, sharpness=jnp.float32(1.5), decay_length=jnp.float32(8.0))
    for place in np.ndindex(4, 5):
        claims = 0.0
        for k in range(3):
            if math.isfinite(own[place]) and math.isfinite(others[k][place]):
                lead = (own[place] - others[k][place]) / 1.5
                claims += trust[k] * math.exp(min(lead, 30.0))
        assert cost[place] == pytest.approx(-8.0 * math.log(1.0 / (1.0 + claims)), rel=1e-4)


def test_the_nearest_robot_pays_almost_nothing_and_shares_add_up() -> None:
    lengths = jnp.array([[1.0, 4.0], [9.0, 4.0]], jnp.float32)
    costs = [
        claim_cost(
            lengths[i],
            lengths[1 - i][None],
            jnp.ones(1),
            sharpness=jnp.float32(1.0),
            decay_length=jnp.float32(5.0),
        )
        for i in (0, 1)
    ]
    shares = np.exp(-np.stack(costs) / 5.0)
    np.testing.assert_allclose(shares.sum(axis=0), 1.0, rtol=1e-5)
    assert costs[0][0] < 0.01
    np.testing.assert_allclose(costs[0][1], costs[1][1])


def test_old_claims_fade_and_those_never_heard_do_not_count() -> None:
    trust = trust_in(jnp.array([0.0, 60.0, jnp.inf]), jnp.float32(60.0))
    np.testing.assert_allclose(trust, [1.0, math.exp(-1.0), 0.0], rtol=1e-6)


costs = st.integers(1, 5).flatmap(
    lambda rows: st.integers(1, 5).flatmap(
        lambda columns: st.lists(
            st.lists(
                st.one_of(st.integers(0, 50), st.just(math.inf)),
                min_size=columns,
                max_size=columns,
            ),
            min_size=rows,
            max_size=rows,
        )
    )
)


@given(costs)
def test_no_permutation_has_less_cost_than_the_assignment(given_costs) -> None:
    table = np.array(given_costs, float)
    robots, clusters = table.shape
    finite = np.minimum(table, NO_WAY)
    chosen = assign_clusters(table)
    taken = chosen[chosen >= 0]
    assert len(set(taken)) == len(taken)
    assert np.isfinite(table[chosen >= 0, taken]).all()
    # By brute force: every way to give different clusters to as many robots as there can be.
    if robots <= clusters:
        ways = (
            sum(finite[i, j] for i, j in enumerate(columns))
            for columns in itertools.permutations(range(clusters), robots)
        )
    else:
        ways = (
            sum(finite[i, j] for j, i in enumerate(rows))
            for rows in itertools.permutations(range(robots), clusters)
        )
    missing = min(robots, clusters) - len(taken)
    total = table[chosen >= 0, taken].sum() + missing * NO_WAY
    assert total == pytest.approx(min(ways))


def test_clusters_are_the_free_cells_beside_unknown_ones() -> None:
    """A known room with two openings of 8 and 6 cells; a frontier of 2 cells is left out."""
    grid = np.full((20, 30), 0.5)
    grid[4:16, 4:26] = 0.99
    grid[5:15, 5:25] = 0.01
    grid[5:13, 25], grid[15, 8:14], grid[4, 20:22] = 0.01, 0.01, 0.01
    first, second = frontier_clusters(grid, 0.1)
    assert {tuple(cell) for cell in first.tolist()} == {(row, 25) for row in range(5, 13)}
    assert {tuple(cell) for cell in second.tolist()} == {(15, column) for column in range(8, 14)}
    lengths = np.full((2, 10, 15), np.inf)
    lengths[0, 4, 10], lengths[0, 6, 5], lengths[1, 4, 11] = 3.0, 2.0, 7.0
    found = cluster_costs(lengths, [first, second], 2)
    np.testing.assert_array_equal(found, [[3.0, 2.0], [7.0, np.inf]])
    assert cluster_costs(lengths, [], 2).shape == (2, 0)


def test_each_robot_is_led_to_the_cluster_that_is_assigned_to_it() -> None:
    """A corridor with a frontier at each end: the robot near an end is sent there, whatever its
    place in the fleet, and also where it has not heard of the others."""
    cells = np.full((12, 60), 0.99, np.float32)
    cells[3:9, 3:57] = 0.01
    cells[3:9, :3] = cells[3:9, 57:] = 0.5
    grid = OccupancyGrid(cells, 0.1)
    stride, shape = 2, (6, 30)
    x = np.broadcast_to(np.arange(30) * 0.2, shape)
    # Robots at the right end, at the left one, and in the middle.
    lengths = np.stack([6.0 - x, x, np.abs(x - 3.0)]).astype(np.float32)
    scenario = types.SimpleNamespace(
        perception=types.SimpleNamespace(field_sensor=types.SimpleNamespace(stride=stride))
    )
    own = RobotState(Belief(grid=grid), Knowledge.nothing())
    state = ExplorationState(*[None] * 9)._replace(own=own)
    for places in ((0, 1, 2), (1, 0), (0,), (1,)):
        heard = Heard(
            jnp.zeros((3, 3, *grid.shape)),
            jnp.asarray(np.broadcast_to(lengths, (3, *lengths.shape))),
            jnp.ones((3, 3), jnp.int32),
        )
        assign = inspect.unwrap(with_assignments)
        given = [scenario] * len(places), [state] * len(places), places, heard
        claims = [np.asarray(each.belief.claims) for each in assign(*given)]
        for place, claim in zip(places, claims, strict=True):
            # The third robot finds no cluster left, and is free to go anywhere.
            is_away = claim[2:4] == ELSEWHERE
            assert is_away[:, :3].all() == is_away[:, :3].any() == (place == 0)
            assert is_away[:, -3:].all() == is_away[:, -3:].any() == (place == 1)


def test_robots_hear_each_other_up_to_the_range_wherever_they_are() -> None:
    """To the millimetre, and far from the origin, where a wrong offset shows."""
    rng = np.random.default_rng(3)
    links = Radio(4.0, uses_sight=False).links
    for origin in ((0.0, 0.0), (60.0, -35.0)):
        for angle in rng.uniform(0.0, 2.0 * math.pi, 4):
            way = np.array([math.cos(angle), math.sin(angle)])
            places = np.array(origin) + way * np.array([0.0, 3.999, 8.0])[:, None]
            found = np.asarray(links(jnp.asarray(places, jnp.float32), jnp.zeros((3, 3), bool)))
            wanted = np.zeros((3, 3), bool)
            wanted[0, 1] = wanted[1, 0] = True
            np.testing.assert_array_equal(found, wanted)
