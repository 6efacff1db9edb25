"""Frontiers, rules and explorers by targets: against definitions on small maps, in double
precision with scipy, and in the closed loop."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra.numpy import arrays
from scipy.ndimage import (
    binary_dilation,
    convolve,
    distance_transform_edt,
    label,
    maximum_filter,
)
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from jaxplore import DifferentialDrive, Lidar, OccupancyGrid, Perception, explorer
from jaxplore.belief.roadmap import TurnsOnTheSpot
from jaxplore.planning.strategy.frontiers import cluster_sizes, find_frontiers
from jaxplore.planning.strategy.target_explorer import TargetExplorer
from jaxplore.planning.strategy.target_rules import (
    RULES,
    DiscountedInformation,
    DistanceAdvantage,
    GainPerCost,
    NearestCluster,
    NearestFrontier,
    NextBestView,
    RandomFrontier,
    TargetRule,
    Wander,
)
from jaxplore.simulation.exploration.scenario import ExplorationScenario
from jaxplore.simulation.loop import copy_tree, initial_loop_state, run_chunk

pytestmark = pytest.mark.long

RESOLUTION, SHAPE, STRIDE, REQUIRED = 0.1, (50, 60), 2, 0.25
KEY = jax.random.key(0)
LIDAR = Lidar(num_beams=60, max_range=2.0, range_noise=0.05)
ROBOT = DifferentialDrive(max_speed=1.0, radius=0.2)
PERCEPTION = Perception(LIDAR, RESOLUTION, 0.2, num_directions=8)
NUMBERS = {"min_information": 1.0, "leftover_share": 0.1}


def world() -> np.ndarray:
    """Two rooms with a door, and a closed one."""
    cells = np.zeros(SHAPE, np.float32)
    cells[[0, -1]] = cells[:, [0, -1]] = 1.0
    cells[:, 30] = 1.0
    cells[20:30, 30] = 0.0
    cells[36:, 40] = cells[36, 40:] = 1.0
    return cells


def belief_of(probability: np.ndarray, position=(1.0, 2.5)):
    grid = OccupancyGrid(probability.astype(np.float32), RESOLUTION)
    return init(grid, jnp.asarray([*position, 0.0]))


init = eqx.filter_jit(lambda grid, pose: PERCEPTION.init(grid, pose))


@eqx.filter_jit
def look(belief, position):
    return find_frontiers(
        belief,
        jnp.append(position, 0.0),
        TurnsOnTheSpot(),
        required_clearance=jnp.asarray(REQUIRED),
        min_information=jnp.asarray(NUMBERS["min_information"]),
        leftover_share=jnp.asarray(NUMBERS["leftover_share"]),
        min_frontier=jnp.asarray(0.75),
        stride=STRIDE,
        near=3,
    )


@pytest.fixture(scope="module")
def half_known():
    """The left room is known but for a corner, the door too; the right room is not."""
    p = np.where(world() > 0.5, 0.99, 0.01)
    p[:, 34:] = 0.5
    p[40:, :12] = 0.5
    belief = belief_of(p)
    position = jnp.asarray([1.0, 2.5])
    return belief, position, look(belief, position), p


def ways(found, node) -> np.ndarray:
    """Return the lengths of the ways from a node by Dijkstra's algorithm, in double precision."""
    is_open, slow = np.asarray(found.roads.is_open), np.asarray(found.roads.slowness, np.float64)
    number = -np.ones(is_open.shape, int)
    number[is_open] = np.arange(is_open.sum())
    rows, columns, costs = [], [], []
    for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = np.argwhere(is_open)
        b = a + np.array([down, right])
        inside = ((b >= 0) & (b < is_open.shape)).all(axis=1)
        a, b = a[inside], b[inside]
        both = is_open[tuple(b.T)]
        a, b = a[both], b[both]
        rows += number[tuple(a.T)].tolist()
        columns += number[tuple(b.T)].tolist()
        length = np.hypot(down, right)
        costs += (0.5 * length * (slow[tuple(a.T)] + slow[tuple(b.T)])).tolist()
    graph = coo_matrix((costs, (rows, columns)), (is_open.sum(), is_open.sum()))
    found_ways = dijkstra(graph, directed=False, indices=number[tuple(node)])
    result = np.full(is_open.shape, np.inf)
    result[is_open] = found_ways
    return result


def test_frontiers_are_open_reachable_and_beside_unknown_space(half_known) -> None:
    belief, _, found, p = half_known
    # What the robot stands on is freed when it starts.
    p = np.asarray(belief.grid.probability)
    unknown = 4 * p * (1 - p) > 0.5
    cross = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], bool)
    cells = (p < 0.35) & binary_dilation(unknown, cross)
    blocks = cells.reshape(25, 2, 30, 2).sum(axis=(1, 3))
    beside = 0.1 * convolve(blocks, np.ones((7, 7), int), mode="constant") > 0.74
    room = distance_transform_edt(p < 0.35) * RESOLUTION
    can_be = beside & np.isfinite(np.asarray(found.distance))
    worth = np.asarray(found.worth)
    np.testing.assert_array_equal(found.is_frontier, can_be & (worth >= 1.0))
    largest = sizes_by_scipy(cells).reshape(25, 2, 30, 2).max(axis=(1, 3))
    beside_cluster = 0.1 * maximum_filter(largest, 7, mode="constant") > 0.74
    can_be = beside_cluster & np.isfinite(np.asarray(found.distance))
    np.testing.assert_array_equal(found.is_cluster, can_be & (worth >= 1.0))
    assert found.is_frontier.any()
    rows, columns = np.nonzero(np.asarray(found.is_frontier))
    fits = room.reshape(25, 2, 30, 2).max(axis=(1, 3))
    assert (fits[rows, columns] > REQUIRED - RESOLUTION).all()
    # The door's side of the right room and the corner; nothing in the middle of the left room.
    assert ((columns >= 13) | (rows >= 16)).all()
    assert (columns >= 13).any()
    assert ((rows >= 16) & (columns <= 8)).any()


def sizes_by_scipy(cells: np.ndarray) -> np.ndarray:
    """Return the size of the cluster of each cell."""
    labels, _ = label(cells, np.ones((3, 3), int))
    return np.where(cells, np.bincount(labels.ravel())[labels], 0)


def check_clusters(cells: np.ndarray) -> None:
    np.testing.assert_array_equal(compiled_sizes(jnp.asarray(cells)), sizes_by_scipy(cells))


compiled_sizes = jax.jit(cluster_sizes)


@given(arrays(bool, (14, 17)))
def test_clusters_are_those_of_scipy(cells: np.ndarray) -> None:
    check_clusters(cells)


def test_long_clusters_are_whole() -> None:
    """A spiral, along which labels go a long way, and a comb, whose teeth meet at one end."""
    spiral = np.zeros((41, 41), bool)
    row, column, down, right, reach = 0, 0, 0, 1, 40
    spiral[0, 0] = True
    while reach > 0:
        for _ in range(2):
            for _ in range(reach):
                row, column = row + down, column + right
                spiral[row, column] = True
            down, right = right, -down
        reach -= 2
    comb = np.zeros((41, 41), bool)
    comb[:, ::2] = comb[-1] = True
    for cells in (spiral, comb, comb[::-1].copy(), ~comb):
        check_clusters(cells)


def test_ways_are_dijkstra_s(half_known) -> None:
    found = half_known[2]
    start = np.unravel_index(np.argmin(found.distance), found.distance.shape)
    ours = np.asarray(found.distance, np.float64)
    expected = ways(found, start)
    reached = np.isfinite(expected)
    np.testing.assert_array_equal(np.isfinite(ours), reached)
    # Both start from the node nearest to the robot, or one beside it that is as near.
    assert np.abs(ours[reached] - expected[reached]).max() < 0.25


def chosen(rule, found, key=KEY):
    scores = np.where(rule.candidates(found), rule.scores(found, key=key), -np.inf)
    return np.unravel_index(np.argmax(scores), scores.shape)


def test_rules_choose_what_they_say(half_known) -> None:
    found = half_known[2]
    distance, worth = np.asarray(found.distance, np.float64), np.asarray(found.worth, np.float64)
    frontier, view = np.asarray(found.is_frontier), np.asarray(found.is_view)

    def best(mask, score):
        return np.unravel_index(np.argmax(np.where(mask, score, -np.inf)), mask.shape)

    assert chosen(NearestFrontier(), found) == best(frontier, -distance)
    assert chosen(NearestCluster(), found) == best(np.asarray(found.is_cluster), -distance)
    assert chosen(GainPerCost(), found) == best(frontier, worth / np.maximum(distance, 0.2))
    assert chosen(NextBestView(), found) == best(view, worth)
    assert chosen(DiscountedInformation(0.7), found) == best(view, worth * np.exp(-0.7 * distance))
    for rule, mask in ((RandomFrontier(), frontier), (Wander(3.0), distance <= 3.0)):
        nodes = {chosen(rule, found, key) for key in jax.random.split(KEY, 30)}
        assert len(nodes) > 10
        assert all(mask[node] for node in nodes)


def test_distance_advantage_is_by_dijkstra(half_known) -> None:
    found = half_known[2]
    frontier = np.asarray(found.is_frontier)
    count = int(frontier.sum())
    rule = DistanceAdvantage(count + 5)  # all of them, and what is asked for beyond
    scores = np.asarray(rule.scores(found, key=KEY))
    between = [ways(found, node) for node in np.argwhere(frontier)]
    total = np.sum([np.where(frontier, each, 0.0) for each in between], axis=0)
    expected = total / (count - 1) - np.where(frontier, found.distance, 0.0)
    np.testing.assert_allclose(scores[frontier], expected[frontier], atol=2e-3)
    # The corner lies apart from the door's frontiers, which are more.
    assert chosen(rule, found)[0] >= 16


def make(rule, shape=SHAPE, **changes) -> TargetExplorer:
    tracker = explorer(ROBOT, horizon=15, num_samples=64, information_weight=0.0)
    frame = OccupancyGrid(world(), RESOLUTION).frame
    given = {"required_clearance": REQUIRED, "every": 4, **NUMBERS, **changes}
    return TargetExplorer(tracker, rule, frame, shape, STRIDE, **given)


def choose(controller, state, belief, position, key=KEY):
    """Choose; the compiled function takes no defaults, each pattern of which it would compile."""
    return compiled_choice(controller, state, belief, position, key)


@eqx.filter_jit
def compiled_choice(controller, state, belief, position, key):
    observation = controller.tracker.dynamics.at_pose(0.0, 0.0, 0.0).at[:2].set(position)
    return controller._choose_if_due(state, observation, belief, key)


def test_a_target_is_kept_until_it_is_seen_reached_or_cut_off(half_known) -> None:
    belief, position, _, p = half_known
    controller = make(RandomFrontier(), every=1)
    first = choose(controller, controller.init(), belief, position)
    assert first.has_target
    kept = choose(controller, first, belief, position, jax.random.key(9))
    np.testing.assert_array_equal(kept.node, first.node)
    near = first.guidance.frame.cell_centre(first.node)
    other = choose(controller, first, belief, near, jax.random.key(9))
    assert not np.array_equal(other.node, first.node)
    # One that does not see all around looks first, as long as it is worth it.
    looking = make(RandomFrontier(), every=1, stays=True)
    same = choose(looking, first, belief, near, jax.random.key(9))
    np.testing.assert_array_equal(same.node, first.node)
    dwelt = dataclasses.replace(belief, dwell=jnp.full_like(belief.dwell, 100.0))
    assert not choose(looking, first, dwelt, near).has_target
    seen = belief_of(np.where(world() > 0.5, 0.99, 0.01))
    # Nothing that is left over is worth as much.
    sure = make(RandomFrontier(), every=1, leftover_share=1.0, min_information=100.0)
    done = choose(sure, first, seen, position)
    assert not done.has_target
    assert not np.any(done.guidance.descent)
    closed = np.where(p < 0.4, 0.01, p)
    closed[:, 24] = 0.99
    cut = choose(
        controller, first._replace(node=jnp.asarray([12, 16])), belief_of(closed), position
    )
    assert int(cut.node[1]) < 12


def test_a_nearer_cluster_replaces_the_target_only_with_a_lead(half_known) -> None:
    belief, position, found, _ = half_known
    nearest = chosen(NearestCluster(), found)
    distance = np.asarray(found.distance)
    further = np.where(np.asarray(found.is_cluster), distance - distance[nearest], np.inf)
    for lead in (0.5, 2.0):
        controller = make(NearestCluster(lead), every=1)
        state = choose(controller, controller.init(), belief, position)
        for node in np.argwhere(np.isfinite(further) & (np.abs(further - lead) > 1e-3)):
            held = state._replace(node=jnp.asarray(node, jnp.int32))
            after = tuple(np.asarray(choose(controller, held, belief, position).node))
            assert after == (tuple(node) if further[tuple(node)] < lead else nearest)


def test_it_looks_as_often_as_it_is_told(half_known) -> None:
    belief, position, _, _ = half_known
    controller = make(NearestFrontier(), every=3)
    state = choose(controller, controller.init(), belief, position)
    moved = state._replace(node=jnp.asarray([12, 4]), has_target=jnp.asarray(True))
    for due in (False, False, True):
        after = choose(controller, moved, belief, position)
        assert np.array_equal(after.node, moved.node) != due
        moved = moved._replace(since=after.since)


def test_guidance_leads_to_the_target(half_known) -> None:
    belief, position, found, _ = half_known
    controller = make(NearestFrontier())
    state = choose(controller, controller.init(), belief, position)
    assert tuple(np.asarray(state.node)) == chosen(NearestFrontier(), found)
    target = state.guidance.frame.cell_centre(state.node)
    assert float(state.guidance(target)) == pytest.approx(0.0, abs=1e-5)
    to_go = ways(found, np.asarray(state.node))
    start = np.asarray(state.guidance.frame.to_cell(position))
    assert float(state.guidance(position)) == pytest.approx(to_go[tuple(start)], abs=0.4)


class Chosen(TargetRule):
    """One of two rules by its number, so that both are one program."""

    number: jax.Array
    rules: tuple[TargetRule, TargetRule]

    def candidates(self, frontiers):
        first, second = (each.candidates(frontiers) for each in self.rules)
        return jnp.where(self.number == 0, first, second)

    def scores(self, frontiers, *, key):
        first, second = (each.scores(frontiers, key=key) for each in self.rules)
        return jnp.where(self.number == 0, first, second)


BOTH = ("nearest-frontier", "wander")


@pytest.mark.parametrize("name", BOTH)
def test_rules_explore_without_contact(name: str) -> None:
    """One that asks for frontiers and one that does not."""
    scenario = ExplorationScenario(
        OccupancyGrid(world(), RESOLUTION),
        ROBOT,
        LIDAR,
        (1.0, 2.5, 0.0),
        perception=PERCEPTION,
        control_rate=20.0,
        target_coverage=0.95,
    )
    shape = scenario.map_arrays.world.shape
    rule = Chosen(jnp.asarray(BOTH.index(name), jnp.int32), tuple(RULES[each]() for each in BOTH))
    controller = make(rule, shape).at_period(0.05)
    smaller = make(rule)
    with pytest.raises(ValueError, match=r"shape is \(50, 60\); accepted: .* of \(64, 64\) cells"):
        jax.eval_shape(
            smaller.step,
            eqx.filter_eval_shape(smaller.init),
            scenario.start,
            eqx.filter_eval_shape(scenario.init, KEY)[1],
            key=KEY,
        )
    state = initial_loop_state(controller, scenario, KEY)
    state, records, done = run_chunk(
        (controller, scenario, KEY, jnp.asarray(800, jnp.int32)), copy_tree(state), 800
    )
    steps = int(done)
    assert not np.asarray(records.is_collision)[:steps].any()
    begin, end = records.coverage[0], records.coverage[steps - 1]
    assert end > (0.6 if name == "wander" else 0.94)
    assert end > begin + 0.2
    heavier = make(rule, shape, min_information=2.0, every=5).at_period(0.05)
    before = run_chunk._cached._cache_size()
    run_chunk((heavier, scenario, KEY, jnp.asarray(1, jnp.int32)), copy_tree(state), 800)
    assert run_chunk._cached._cache_size() == before


def test_a_look_shows_the_target(half_known) -> None:
    belief, position, found, _ = half_known
    controller = make(NearestFrontier())
    observation = ROBOT.at_pose(*map(float, position), 0.0)

    @eqx.filter_jit
    def reference(controller, observation, belief):
        """Return that of a look; its rollouts are not computed then."""
        return controller.inspect(
            controller.init(), observation, belief, key=KEY, num_trajectories=4
        ).reference

    row, column = chosen(NearestFrontier(), found)
    expected = found.roads.frame.cell_centre(jnp.asarray([row, column]))
    shown = reference(controller, observation, belief)
    np.testing.assert_allclose(shown[0], expected, atol=1e-5)
