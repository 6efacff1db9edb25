"""Targets by definition: clearance by scipy, ways by Dijkstra's algorithm from the targets, both in
double precision, sharing nothing with the package but the map."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from jaxplore import Lidar, OccupancyGrid, Perception, PoseInformation
from jaxplore.belief.belief import Belief
from jaxplore.belief.guidance import GuidanceField
from jaxplore.belief.zones import Zones
from jaxplore.information.trajectory import METHODS, TrajectoryInformation
from jaxplore.maps import ScalarField
from jaxplore.maps.frame import GridFrame
from jaxplore.planning import GradientReference
from jaxplore.planning.strategy.references import ReferenceStart, descend
from jaxplore.planning.strategy.target_choices import RemainingInformation, TrajectoryChoice
from jaxplore.planning.strategy.targets import TargetReference, Targets

pytestmark = pytest.mark.long

SIZE, RESOLUTION, REQUIRED = 40, 0.1, 0.21  # 4 m x 4 m
FREE, DIM, UNKNOWN, WALL = 0.01, 0.2, 0.5, 0.99
STRAIGHT, TURNED = (0.0, 0.0, 0.0), (1.0, -2.0, 0.7)
PERCEPTION = Perception(Lidar(num_beams=8, max_range=1.0), RESOLUTION, 0.15, num_directions=4)
FLAT = ScalarField(jnp.zeros((4, 4)), GridFrame(0.5), jnp.zeros(()))
WALK = GradientReference(1.0, 60, 0.1)
NAN = math.nan

TRACES: list[str] = []

init = eqx.filter_jit(lambda grid, pose: PERCEPTION.init(grid, pose))


def standing(position: jax.Array) -> ReferenceStart:
    """Return the start of a robot that stands, with its height or without one."""
    whole = jnp.concatenate([position, jnp.zeros(3 - position.shape[0])])
    return ReferenceStart(whole, jnp.zeros(()), jnp.zeros(()))


@eqx.filter_jit
def judge(choice, belief: Belief, position: jax.Array):
    TRACES.append("judge")
    start = standing(position)
    return choice(belief, start), choice.targets.distances(belief, start.pose)


@eqx.filter_jit
def refer(reference, belief: Belief, start) -> jax.Array:
    TRACES.append("refer")
    return reference(belief, FLAT, standing(start))


@eqx.filter_jit
def weigh(choice: TrajectoryChoice, belief: Belief, position: jax.Array):
    return choice(belief, standing(position))


def choose(choice, belief: Belief, position: jax.Array):
    if isinstance(choice, TrajectoryChoice):
        return weigh(choice, belief, position)
    return judge(choice, belief, position)[0]


def by_remains(zones, goal, weight=0.05, depleted=0.05, *, straight=False, **ways):
    return RemainingInformation(
        Targets(zones, goal, depleted=depleted, **ways), weight, straight=straight
    )


def by_trajectory(zones, goal, information, walk=None, weight=1.0, depleted=0.05, **ways):
    targets = Targets(zones, goal, depleted=depleted, **ways)
    return TrajectoryChoice(targets, information, walk, weight)


def believe(p: np.ndarray, position=(2.0, 2.0), frame=STRAIGHT) -> Belief:
    """Return what a robot knows that is given a map; around itself it knows that all is free."""
    pose = jnp.asarray([*position, 0.0], jnp.float32)
    return init(OccupancyGrid(p, RESOLUTION, frame), pose)


def room() -> np.ndarray:
    p = np.full((SIZE, SIZE), FREE, np.float32)
    p[0] = p[-1] = p[:, 0] = p[:, -1] = WALL
    return p


def zones_of(*blocks: tuple[int, int, int, int]) -> Zones:
    """Return three zones from (first row, first column, rows, columns).

    Where fewer are given a cell in a corner of `room` makes up for them, of which nothing remains.
    """
    member = np.zeros((3, SIZE, SIZE), bool)
    member[len(blocks) :, -1, -1] = True
    for one, (row, column, rows, columns) in zip(member, blocks, strict=False):
        one[row : row + rows, column : column + columns] = True
    return Zones(jnp.asarray(member))


def at(row: float, column: float, frame=STRAIGHT) -> jax.Array:
    """Return the world position of grid coordinates."""
    u, v = column * RESOLUTION, row * RESOLUTION
    c, s = math.cos(frame[2]), math.sin(frame[2])
    return jnp.asarray([frame[0] + c * u - s * v, frame[1] + s * u + c * v], jnp.float32)


class Oracle:
    """Where a disc of radius `required` fits, and how long the ways are."""

    def __init__(self, p: np.ndarray, stride: int = 1, required: float = REQUIRED) -> None:
        free = np.pad(np.asarray(p, np.float64) < 0.25, 1)
        clearance = (distance_transform_edt(free)[1:-1, 1:-1] - 0.5) * RESOLUTION
        clearance = np.clip(clearance, 0.0, 1.0)
        self.stride, self.spacing = stride, stride * RESOLUTION
        height, width = (-(-size // stride) for size in clearance.shape)
        room = np.zeros((height, width))
        for row, column in np.ndindex(clearance.shape):
            block = row // stride, column // stride
            room[block] = max(room[block], clearance[row, column])
        self.is_open = room >= required
        slowness = self.spacing * (1 + np.clip(1 - (room - required) / required / 2, 0, 1))
        edges = [
            (row * width + column, r * width + c, np.hypot(down, right) * mean)
            for row, column in np.argwhere(self.is_open)
            for down, right in ((0, 1), (1, 0), (1, 1), (1, -1))
            for r, c in [(row + down, column + right)]
            if r < height and 0 <= c < width and self.is_open[r, c]
            for mean in [(slowness[row, column] + slowness[r, c]) / 2]
        ]
        i, j, length = np.array(edges).reshape(-1, 3).T
        size = height * width
        self.graph = coo_matrix((length, (i.astype(int), j.astype(int))), shape=(size, size))

    def nearest(self, row: float, column: float) -> tuple[np.ndarray, float]:
        """Return the open nodes (n, 2) nearest to grid coordinates, and how far away they are."""
        nodes, away = self.around(row, column, 1e-3)
        return nodes, away.min()

    def around(self, row: float, column: float, spacings: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the open nodes (n, 2) that are not farther than the nearest by more spacings."""
        nodes = np.argwhere(self.is_open)
        away = np.hypot(*((nodes + 0.5) * self.stride - (row, column)).T) * RESOLUTION
        near = away <= away.min() + spacings * self.spacing
        return nodes[near], away[near]

    def ends(self, target: np.ndarray) -> np.ndarray:
        """Return the nodes (n, 2) at which the ways to a target end."""
        nodes = {(r // self.stride, c // self.stride) for r, c in np.argwhere(target)}
        within = [node for node in nodes if self.is_open[node]]
        if within:
            return np.array(within)
        return self.nearest(*(np.argwhere(target).mean(axis=0) + 0.5))[0]

    def cost_to(self, target: np.ndarray) -> np.ndarray:
        sources = np.ravel_multi_index(self.ends(target).T, self.is_open.shape)
        cost = dijkstra(self.graph.tocsr(), directed=False, indices=sources, min_only=True)
        return np.where(self.is_open, cost.reshape(self.is_open.shape), np.inf)

    def distance(self, row: float, column: float, target: np.ndarray) -> float:
        nodes, away = self.around(row, column, 1.0 + 1e-5)
        return (self.cost_to(target)[tuple(nodes.T)] + away).min()


def targets_of(zones: Zones, goal_cell: tuple[int, int]) -> np.ndarray:
    goal = np.zeros((1, SIZE, SIZE), bool)
    goal[0][goal_cell] = True
    return np.concatenate([np.asarray(zones.member), goal])


def random_case(seed: int):
    """Return a map with walls, zones of which much or little is known, and a free cell."""
    rng = np.random.default_rng(seed)
    p = room()
    for _ in range(5):
        row, column = rng.integers(2, SIZE - 2, 2)
        length = rng.integers(5, 22)
        if rng.random() < 0.5:
            p[row, column : column + length] = WALL
        else:
            p[row : row + length, column] = WALL
    blocks = []
    for level in rng.permutation([UNKNOWN, DIM, FREE]):
        row, column = rng.integers(2, SIZE - 10, 2)
        rows, columns = rng.integers(3, 9, 2)
        part = p[row : row + rows, column : column + columns]
        part[rng.random(part.shape) < 0.8] = level
        blocks.append((row, column, rows, columns))
    free = np.argwhere(p < 0.1)
    cell = free[rng.integers(len(free))]
    return p, zones_of(*blocks), cell + rng.uniform(0.1, 0.9, 2), rng


@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 3]), st.sampled_from([STRAIGHT, TURNED]))
@settings(max_examples=16)
def test_scores_are_those_of_the_definition(seed: int, stride: int, frame) -> None:
    p, zones, start, rng = random_case(seed)
    goal_cell = tuple(rng.integers(0, SIZE, 2))
    goal = at(goal_cell[0] + 0.4, goal_cell[1] + 0.6, frame)
    position, weight, depleted = at(*start, frame), rng.uniform(0, 0.3), rng.uniform(0.01, 0.5)
    belief = believe(p, np.asarray(position), frame)
    p = np.asarray(belief.grid.probability, np.float64)
    oracle, targets = Oracle(p, stride), targets_of(zones, goal_cell)
    expected = np.array([oracle.distance(*start, target) for target in targets])
    choice = by_remains(zones, goal, weight, depleted, required_clearance=REQUIRED, stride=stride)
    scores, found = judge(choice, belief, position)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)

    remaining = np.array([(4 * p * (1 - p))[target].mean() for target in targets[:-1]])
    remains = remaining >= depleted
    score = np.where(remains, remaining - weight * expected[:-1], -np.inf)
    score = np.append(score, -np.inf if remains.any() else -weight * expected[-1])
    np.testing.assert_allclose(scores.score, score, rtol=1e-4, atol=1e-4)
    if np.isfinite(score).any():
        assert score[scores.index] >= score.max() - 1e-4
    centre = [np.argwhere(target).mean(axis=0) + 0.5 for target in targets[:-1]]
    places = [*(at(*one, frame) for one in centre), goal]
    np.testing.assert_allclose(scores.position, places[int(scores.index)], atol=1e-4)


@eqx.filter_jit
def fields_of(targets: Targets, belief: Belief) -> GuidanceField:
    return jax.vmap(lambda mask: targets.cost_to(belief, mask))(targets.masks(belief.grid))


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=4)
def test_costs_to_go_are_those_of_the_definition(seed: int) -> None:
    p, zones, _, rng = random_case(seed)
    goal_cell = tuple(rng.integers(0, SIZE, 2))
    targets = Targets(
        zones, at(goal_cell[0] + 0.5, goal_cell[1] + 0.5), required_clearance=REQUIRED
    )
    belief = believe(p)
    fields, oracle = fields_of(targets, belief), Oracle(belief.grid.probability)
    assert np.isfinite(fields.values).all()
    for values, target in zip(fields.values, targets_of(zones, goal_cell), strict=True):
        expected = oracle.cost_to(target)
        is_reached = np.isfinite(expected)
        np.testing.assert_allclose(values[is_reached], expected[is_reached], rtol=1e-4, atol=1e-4)
        if is_reached.any():
            assert (values[~is_reached] > 0.0).all()


def test_distances_in_the_open_are_metres() -> None:
    """Where there is room nothing counts double, and a way ends where the zone begins."""
    p = np.full((SIZE, SIZE), FREE)
    zones = zones_of((15, 28, 10, 3), (27, 27, 3, 3))
    p[np.asarray(zones.member[:2]).any(axis=0)] = DIM
    choice = by_remains(zones, [2.05, 2.05], 0.1, required_clearance=0.1)
    scores = choose(choice, believe(p), at(20.5, 10.5))
    lengths = 1.8, 1.0 + 0.7 * math.sqrt(2.0)
    expected = [0.64 - 0.1 * length for length in lengths]
    np.testing.assert_allclose(scores.score, [*expected, -np.inf, -np.inf], atol=1e-5)
    assert int(scores.index) == 0
    np.testing.assert_allclose(scores.position, [2.95, 2.0], atol=1e-5)


def wall_between() -> tuple[np.ndarray, Zones]:
    """Return a map on which zone 0 is 0.9 m away behind a wall, and zone 1 2 m away."""
    p = room()
    p[:32, 16] = WALL
    zones = zones_of((4, 19, 4, 4), (27, 8, 4, 4))
    p[np.asarray(zones.member[:2]).any(axis=0)] = DIM
    return p, zones


def test_a_wall_makes_the_nearest_zone_a_far_one() -> None:
    p, zones = wall_between()
    belief, position = believe(p, (1.2, 0.6)), at(6, 12)
    by_map, by_line = (
        choose(
            by_remains(zones, [2.0, 3.8], 0.1, required_clearance=REQUIRED, straight=straight),
            belief,
            position,
        )
        for straight in (False, True)
    )
    assert (int(by_map.index), int(by_line.index)) == (1, 0)
    line = [math.hypot(0.0, 0.9), math.hypot(2.3, 0.2)]
    np.testing.assert_allclose(by_line.score[:2], 0.64 - 0.1 * np.array(line), atol=1e-5)
    oracle = Oracle(p)
    way = [oracle.distance(6, 12, np.asarray(one)) for one in zones.member]
    assert 9.0 > way[0] > 5.0 > 4.0 > way[1]


def closed() -> tuple[np.ndarray, Zones]:
    """Return a map on which no way leads to zone 0, of which most remains."""
    p = room()
    p[20:, 22] = p[20, 22:] = WALL
    zones = zones_of((24, 26, 10, 10), (4, 30, 5, 5), (5, 5, 5, 5))
    p[24:34, 26:36] = 0.24
    p[4:9, 30:35] = DIM
    return p, zones


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_no_zone_without_a_way_is_chosen_while_another_remains(weight: float) -> None:
    p, zones = closed()
    choice = by_remains(zones, [1.0, 2.0], weight, required_clearance=REQUIRED)
    scores = choose(choice, believe(p), at(20, 15))
    assert np.isneginf(scores.score).tolist() == [True, False, True, True]
    assert int(scores.index) == 1
    # Without the second: what remains is not given up for the goal.
    p[4:9, 30:35] = FREE
    belief = believe(p)
    scores = choose(choice, belief, at(20, 15))
    assert np.isneginf(scores.score).all()
    assert int(scores.index) == 0
    # It goes where a way may be found.
    start = jnp.asarray([1.5, 2.0, 1.0])
    path = refer(TargetReference(choice, WALK), belief, start)
    np.testing.assert_allclose(path, walk_down(belief.guidance, WALK, belief, start), atol=1e-5)
    assert float(jnp.linalg.norm(path[-1] - start)) > 0.3


@eqx.filter_jit
def walk_down(field, walk, belief, start):
    return descend(walk, field, belief, standing(start))


def test_of_many_zones_without_a_way_the_one_of_which_most_remains() -> None:
    p, _ = closed()
    zones = zones_of((24, 26, 4, 4), (29, 30, 4, 4), (5, 5, 4, 4))
    p[29:33, 30:34] = 0.245
    choice = by_remains(zones, [1.0, 2.0], required_clearance=REQUIRED)
    assert int(choose(choice, believe(p), at(20, 15)).index) == 1


def test_depleted_zones_are_left_out_and_the_goal_comes_when_none_remains() -> None:
    p, zones = room(), zones_of((18, 24, 4, 4), (30, 5, 4, 4))
    p[np.asarray(zones.member[0])], p[np.asarray(zones.member[1])] = 0.05, DIM  # 0.19, 0.64 remain
    belief, position = believe(p, (1.2, 1.2)), at(20, 20)

    def scores(depleted: float):
        choice = by_remains(zones, (0.6, 1.2), 0.5, depleted, required_clearance=REQUIRED)
        return choose(choice, belief, position)

    both, one, none = scores(0.18), scores(0.2), scores(0.65)
    assert [int(each.index) for each in (both, one, none)] == [0, 1, 3]
    assert np.isfinite(both.score).tolist() == [True, True, False, False]
    assert np.isfinite(one.score).tolist() == [False, True, False, False]
    assert np.isfinite(none.score).tolist() == [False, False, False, True]
    np.testing.assert_array_equal(both.score[1], one.score[1])
    np.testing.assert_allclose(none.position, [0.6, 1.2])
    way = Oracle(p).distance(20, 20, targets_of(zones, (12, 6))[-1])
    assert float(none.score[-1]) == pytest.approx(-0.5 * way, rel=1e-4)
    # Even if no way leads there.
    p[:, 12] = WALL
    choice = by_remains(zones, [0.6, 1.2], 0.5, 0.65, required_clearance=REQUIRED)
    lost = choose(choice, believe(p, (3.0, 3.0)), position)
    assert int(lost.index) == 3
    assert np.isneginf(lost.score).all()


def test_the_goal_comes_when_all_worthwhile_is_explored_whatever_remains() -> None:
    p = room()
    p[10:20, 20:30] = UNKNOWN
    choice = by_remains(zones_of((10, 20, 10, 10)), (0.6, 1.2), required_clearance=REQUIRED)
    belief = believe(p, (1.0, 1.0))
    explored = eqx.tree_at(lambda known: known.is_explored, belief, jnp.array(True))
    place = jnp.asarray([1.0, 1.0])
    assert int(choose(choice, belief, place).index) == 0
    found = choose(choice, explored, place)
    assert int(found.index) == 3
    np.testing.assert_array_equal(np.isfinite(found.score), [False, False, False, True])
    np.testing.assert_allclose(found.position, (0.6, 1.2))


@pytest.mark.parametrize(
    ("goal", "cell"), [((9.0, 2.04), (20, 39)), ((-3.0, -7.0), (0, 0)), ((1.64, 0.44), (4, 16))]
)
def test_a_goal_off_the_map_or_in_a_wall_is_approached(goal, cell) -> None:
    p, zones = wall_between()
    choice = by_remains(zones, goal, required_clearance=REQUIRED)
    expected = Oracle(p).distance(30, 24, targets_of(zones, cell)[-1])
    _, found = judge(choice, believe(p, (3.0, 3.0)), at(30, 24))
    assert float(found[-1]) == pytest.approx(expected, rel=1e-4)
    assert np.isfinite(expected)


INFORMATION = {
    method: TrajectoryInformation(
        PoseInformation(Lidar(num_beams=6, max_range=0.5, field_of_view=2.0)), method, every=2
    )
    for method in METHODS
}


@eqx.filter_jit
def per_pose(grid: OccupancyGrid, paths: jax.Array) -> dict[str, jax.Array]:
    """Return what each pose of each path adds, by each method."""
    return {
        method: jax.vmap(lambda path, given=given: given.per_pose(grid, path))(paths)
        for method, given in INFORMATION.items()
    }


@eqx.filter_jit
def worths(choice: TrajectoryChoice, grid: OccupancyGrid, start, paths) -> dict[str, jax.Array]:
    """Return the choice's values of paths, by each method."""
    choices = {
        method: eqx.tree_at(lambda c: c.information, choice, given)
        for method, given in INFORMATION.items()
    }
    return {
        method: jax.vmap(lambda path, each=each: each.worth(grid, start, path))(paths)
        for method, each in choices.items()
    }


@eqx.filter_jit
def paths_to(fields: GuidanceField, walk: GradientReference, belief: Belief, start: jax.Array):
    return jax.vmap(lambda field: descend(walk, field, belief, standing(start)))(fields)


def trajectory_case(method: str, weight: float = 2.0) -> tuple[Belief, TrajectoryChoice]:
    """Return zones round a wall, behind what is unknown and nearby."""
    p, _ = wall_between()
    zones = zones_of((4, 19, 4, 4), (27, 8, 4, 4), (12, 5, 4, 4))
    p[22:36, 3:10] = UNKNOWN
    p[np.asarray(zones.member).any(axis=0)] = DIM
    choice = by_trajectory(
        zones,
        [2.0, 3.6],
        INFORMATION[method],
        GradientReference(1.0, 24, 0.2),
        weight,
        required_clearance=REQUIRED,
    )
    return believe(p, (1.2, 0.6)), choice


def enumerated(belief: Belief, choice: TrajectoryChoice, start: jax.Array):
    """Return the paths to all targets, their lengths, and what is learned along each by method."""
    fields = fields_of(choice.targets, belief)
    paths = paths_to(fields, choice.gradient_reference, belief, jnp.append(start, 0.0))[..., :2]
    gains = per_pose(belief.grid, paths)
    steps = np.linalg.norm(np.diff(np.insert(paths, 0, start, axis=1), axis=1), axis=-1)
    # What a pose adds depends on those before it only: what comes after arrival is cut off.
    arrivals = [np.flatnonzero(each)[-1] + 1 for each in steps]
    for each, arrival in zip(steps, arrivals, strict=True):
        assert (each[:arrival] > 0).all()
    rows = [math.ceil(arrival / 2) for arrival in arrivals]
    learned = {
        method: np.array([gain[:count].sum() for gain, count in zip(each, rows, strict=True)])
        for method, each in gains.items()
    }
    return paths, steps.sum(axis=1), learned


def test_paths_are_worth_what_is_learned_less_their_length() -> None:
    belief, choice = trajectory_case("direct", 2.0)
    start = jnp.asarray([1.2, 0.6])
    paths, lengths, learned = enumerated(belief, choice, start)
    found = worths(choice, belief.grid, start, paths)
    assert found.keys() == set(METHODS)
    for method in METHODS:
        assert learned[method].max() > 1.0
        np.testing.assert_allclose(found[method], learned[method] - 2.0 * lengths, rtol=1e-4)
    # The methods differ: none is taken for another.
    totals = np.array([learned[method] for method in METHODS])
    assert all(abs(a - b).max() > 1e-2 for i, a in enumerate(totals) for b in totals[:i])


@pytest.mark.parametrize("method", ["direct", "occlusion"])
def test_the_least_cost_of_all_trajectories_wins(method: str) -> None:
    belief, choice = trajectory_case(method)
    start = jnp.asarray([1.2, 0.6])
    _, lengths, learned = enumerated(belief, choice, start)
    assert lengths[2] < 0.9 < 2.0 < lengths[1]
    chosen = []
    for weight in (0.0, 2.0, 50.0):
        cost = weight * lengths - learned[method]
        choice = eqx.tree_at(lambda c: c.weight, choice, jnp.float32(weight))
        scores = choose(choice, belief, start)
        np.testing.assert_allclose(scores.score[:-1], -cost[:-1], rtol=1e-4, atol=1e-4)
        assert np.isneginf(scores.score[-1])
        assert int(scores.index) == np.argmin(cost[:-1])
        chosen.append(int(scores.index))
    assert chosen[0] != chosen[-1]
    # Done with all zones: the goal, by the same rule.
    done = eqx.tree_at(lambda c: c.targets.depleted, choice, jnp.float32(1.0))
    scores = choose(done, belief, start)
    assert int(scores.index) == 3
    assert float(scores.score[-1]) == pytest.approx(-cost[-1], rel=1e-4)


def test_trajectories_leave_out_depleted_zones_and_those_without_a_way() -> None:
    belief, choice = trajectory_case("direct")
    p = np.array(belief.grid.probability)
    p[12:16, 5:9] = FREE
    p[:, 16] = WALL
    scores = choose(choice, believe(p, (1.2, 0.6)), at(6, 12))
    assert np.isfinite(scores.score).tolist() == [False, True, False, False]
    assert int(scores.index) == 1


def test_who_has_arrived_looks_once_and_no_more() -> None:
    """In the zone the path has no length: what counts is the scan from where the robot stands."""
    belief, choice = trajectory_case("direct")
    here = at(13.5, 6.5)
    scores = choose(choice, belief, here)
    once = per_pose(belief.grid, jnp.tile(here, (4, 24, 1)))["direct"][0, 0]
    assert float(once) > 0.1
    assert float(scores.score[2]) == pytest.approx(float(once), rel=1e-4)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=16)
def test_the_reference_keeps_out_of_walls_and_comes_nearer(seed: int) -> None:
    p, zones, origin, _ = random_case(seed)
    choice = by_remains(zones, at(20, 20), 0.1, required_clearance=REQUIRED)
    position = at(*origin)
    belief = believe(p, np.asarray(position))
    start = jnp.append(position, -2.0)
    path = np.asarray(refer(TargetReference(choice, WALK), belief, start))
    assert path.shape == (WALK.num_steps, 3)
    np.testing.assert_array_equal(path[:, 2], -2.0)
    path = np.concatenate([start[None], path])[:, :2]
    assert (np.linalg.norm(np.diff(path, axis=0), axis=1) <= 0.1 + 1e-5).all()
    p = np.asarray(belief.grid.probability)
    rows, columns = np.floor(path.T[::-1] / RESOLUTION).astype(int)
    assert (p[rows, columns] <= 0.65).all()
    scores, lengths = judge(choice, belief, position)
    before = float(lengths[scores.index])
    if np.isfinite(before):
        _, lengths = judge(choice, belief, jnp.asarray(path[-1]))
        after = float(lengths[scores.index])
        assert after < 0.35 or after < before - 0.5


def test_the_reference_ends_at_the_goal_when_all_is_known() -> None:
    p, zones = wall_between()
    belief = believe(np.where(p == np.float32(DIM), FREE, p), (1.2, 0.6))
    choice = by_remains(zones, [2.55, 0.85], required_clearance=REQUIRED)
    reference = TargetReference(choice, GradientReference(2.0, WALK.num_steps, 0.1))
    path = np.asarray(refer(reference, belief, jnp.asarray([1.2, 0.6, 0.0])))
    np.testing.assert_allclose(path[-1, :2], [2.55, 0.85], atol=0.1)
    assert path[:, 1].max() > 3.2  # round the wall


@pytest.mark.parametrize("start", [(NAN, NAN, NAN), (NAN, 1.0, 0.0), (math.inf, 1.0, 0.0)])
def test_nowhere_is_contained(start) -> None:
    belief, trajectory = trajectory_case("direct")
    zones = trajectory.targets.zones
    by_map = by_remains(zones, [1.0, 1.0])
    straight = by_remains(zones, [1.0, 1.0], straight=True)
    for choice in (by_map, straight, trajectory):
        scores = choose(choice, belief, jnp.asarray(start[:2], jnp.float32))
        assert np.isneginf(scores.score).all()
        assert int(scores.index) == 0
        assert np.isfinite(scores.position).all()
    path = refer(TargetReference(by_map, WALK), belief, jnp.asarray(start, jnp.float32))
    np.testing.assert_array_equal(path, np.tile(np.float32(start), (WALK.num_steps, 1)))


def test_a_map_without_room_is_contained() -> None:
    zones = zones_of((4, 4, 4, 4), (20, 20, 4, 4))
    choice = by_remains(zones, [1.0, 1.0], required_clearance=0.9)
    belief, start = believe(np.full((SIZE, SIZE), UNKNOWN)), jnp.asarray([2.0, 2.0, 0.0])
    assert int(choose(choice, belief, start[:2]).index) == 0
    assert np.isfinite(refer(TargetReference(choice, WALK), belief, start)).all()


def test_many_robots_at_once() -> None:
    belief, trajectory = trajectory_case("occlusion")
    zones = trajectory.targets.zones
    choice = by_remains(zones, [2.0, 3.6], 0.1, required_clearance=REQUIRED)
    starts = jnp.asarray([[1.2, 0.6, 0.0], [2.0, 3.5, 1.0], [3.0, 0.8, 2.0]])
    many = eqx.filter_jit(jax.vmap(lambda belief, at: choice(belief, standing(at)), (None, 0)))
    together = many(belief, starts[:, :2])
    for row, start in enumerate(starts):
        alone = choose(choice, belief, start[:2])
        np.testing.assert_allclose(together.score[row], alone.score, atol=1e-4)
        assert int(together.index[row]) == int(alone.index)
        np.testing.assert_allclose(together.position[row], alone.position)
    assert len(set(np.asarray(together.index).tolist())) > 1
    reference = TargetReference(trajectory, WALK)
    shape = jax.eval_shape(jax.vmap(lambda at: reference(belief, FLAT, standing(at))), starts).shape
    assert shape == (3, WALK.num_steps, 3)


def test_weights_zones_and_goal_are_data() -> None:
    p, zones = wall_between()
    belief, start = believe(p, (1.2, 0.6)), jnp.asarray([1.2, 0.6, 0.0])
    found, traces = [], []
    for chosen, goal, weight, depleted, required in (
        (zones, (2.0, 3.6), 0.1, 0.1, 0.21),
        (zones, (2.0, 3.6), 0.3, 0.1, 0.15),
        (zones, (1.0, 3.0), 0.0, 0.9, 0.21),
        (zones_of((1, 1, 3, 3), (4, 19, 2, 2)), (1.0, 3.0), 0.01, 0.05, 0.2),
    ):
        choice = by_remains(chosen, goal, weight, depleted, required_clearance=required)
        reference = TargetReference(choice, GradientReference(0.5 + weight, WALK.num_steps, 0.1))
        refer(reference, belief, start)
        found.append(int(choose(choice, belief, start[:2]).index))
        traces.append(len(TRACES))
    assert found == [1, 1, 3, 1]
    assert len(set(traces)) == 1


ZONES = zones_of((4, 4, 4, 4))


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"zones": Zones(jnp.zeros((0, SIZE, SIZE), bool))}, "zones has members of shape"),
        ({"goal": (1.0, 2.0, 3.0)}, "goal is .*; accepted: 2 finite numbers"),
    ],
)
def test_wrong_arguments_are_named(wrong, named: str) -> None:
    given = {"zones": ZONES, "goal": (1.0, 1.0)} | wrong
    with pytest.raises(ValueError, match=named):
        by_remains(**given)
    with pytest.raises(ValueError, match=named):
        by_trajectory(**given, information=INFORMATION["direct"])


def test_a_map_of_another_shape_is_named() -> None:
    belief = believe(room())
    small = eqx.tree_at(lambda b: b.grid.probability, belief, belief.grid.probability[:30])
    for choice in (
        by_remains(ZONES, (1.0, 1.0)),
        by_remains(ZONES, (1.0, 1.0), straight=True),
        by_trajectory(ZONES, (1.0, 1.0), INFORMATION["direct"]),
    ):
        with pytest.raises(ValueError, match=r"grid has shape .30, 40.; accepted: .40, 40."):
            jax.eval_shape(choice, small, standing(jnp.ones(2)))
    with pytest.raises(ValueError, match=r"target has shape .40, 40.; accepted: .30, 40."):
        Targets(ZONES, (1.0, 1.0)).cost_to(small, ZONES.member[0])
