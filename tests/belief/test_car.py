"""Costs to go of a car, against Dijkstra's algorithm and Reeds and Shepp's lengths."""

import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from ompl import base as ompl
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

import jaxplore as jx
from jaxplore.belief import CarMotion
from jaxplore.belief.car import car_motion, in_passage
from jaxplore.belief.car_paths import (
    CHANNEL_LENGTH,
    CHANNEL_WIDTH,
    STRAYING,
    DrivenPath,
    find_join,
    without_shortcuts,
)
from jaxplore.belief.roadmap import NARROW_PRICE, TurnsOnTheSpot
from jaxplore.geometry import Rectangle
from jaxplore.geometry.state_lattice import HEADINGS, NUM_HEADINGS, motions
from jaxplore.maps.clearance import clearance_field

pytestmark = pytest.mark.long

CELL, STRIDE, SPACING = 0.1, 2, 0.2
REQUIRED = 0.25
BODY = Rectangle(0.6, 0.1, 0.3, 2)
REVERSAL, PENALTY = 0.7, 1.6
SHAPE = (60, 80)


def lattice_of(radius=0.7, **options):
    prices = {"reversal_cost": REVERSAL, "reverse_penalty": PENALTY}
    return CarMotion(radius, BODY, **(prices | options)).lattice(SPACING)


@eqx.filter_jit
def roads_of(blocked, lattice, required=REQUIRED):
    grid = jx.OccupancyGrid(blocked.astype(jnp.float32), CELL)
    return lattice.roadmap(clearance_field(blocked, grid.frame, 1.0), jnp.asarray(required), STRIDE)


@eqx.filter_jit
def costs_of(roads, source, is_from_source=False):
    return roads.costs(source, is_from_source=is_from_source)


@eqx.filter_jit
def field_of(roads, source):
    return roads.field(source)


@eqx.filter_jit
def costs_at(field, poses, speeds):
    """Return the cost-to-go from poses [m]; infinite without a way."""

    def cost(pose, speed):
        way = find_join(field.tree, field.frame, pose, speed)
        turns_back = (way.direction == 1) != (speed < 0.0)
        return way.beyond + way.price * way.pieces.sum() + jnp.where(turns_back, REVERSAL, 0.0)

    return jax.vmap(cost)(poses, speeds)


def poses_near(field, starts):
    """Return the poses at starts (direction, heading, row, column), and speeds of +-1 m/s."""
    centres = np.asarray(field.frame.cell_centre(jnp.asarray(starts[:, 2:])))
    poses = np.column_stack([centres, np.array(HEADINGS)[starts[:, 1]]]).astype(np.float32)
    return poses, np.where(starts[:, 0] == 0, 1.0, -1.0).astype(np.float32)


@eqx.filter_jit
def drive(field, poses, speeds, step, num_steps):
    """Return the poses after each step from several starts."""
    steps = jnp.stack([step, step])
    return eqx.filter_vmap(lambda *at: field.trace_path(*at, steps, num_steps))(poses, speeds)


def rooms() -> np.ndarray:
    """Return a hall with a wall that has a gap, a room with a door, and a narrow dead end."""
    blocked = np.pad(np.zeros((SHAPE[0] - 2, SHAPE[1] - 2), bool), 1, constant_values=True)
    blocked[30, :50] = True
    blocked[30, 20:28] = False
    blocked[40:, 55] = True
    blocked[48:54, 55] = False
    blocked[8:14, 60:] = True
    blocked[8, 60:] = blocked[14, 60:] = True
    return blocked


def graph_of(roads, radius, can_reverse):
    """Return the edges between the states (direction, heading, row, column), one by one."""
    is_open, slowness = np.asarray(roads.is_open_at), np.asarray(roads.slowness_at, np.float64)
    _, rows, columns = is_open.shape
    ends: list[tuple[int, int]] = []
    costs: list[float] = []

    def state(direction, heading, row, column) -> int:
        return ((direction * NUM_HEADINGS + heading) * rows + row) * columns + column

    for direction in range(1 + can_reverse):
        turn = direction * NUM_HEADINGS // 2
        for each in motions(radius):
            first, last = (each.start + turn) % NUM_HEADINGS, (each.end + turn) % NUM_HEADINGS
            for row, column in np.argwhere(is_open[first]):
                poses = [(each.down, each.right, each.end), *(at[:3] for at in each.via)]
                inside = [
                    (0 <= row + down < rows and 0 <= column + right < columns)
                    and is_open[(heading + turn) % NUM_HEADINGS, row + down, column + right]
                    for down, right, heading in poses
                ]
                if not all(inside):
                    continue
                there = (row + each.down, column + each.right)
                ends.append((state(direction, first, row, column), state(direction, last, *there)))
                mean = 0.5 * (slowness[first, row, column] + slowness[(last, *there)])
                costs.append(each.length * mean * (PENALTY if direction else 1.0))
    if can_reverse:
        for heading, row, column in np.argwhere(is_open):
            for direction in (0, 1):
                pose = (heading, row, column)
                ends.append((state(direction, *pose), state(1 - direction, *pose)))
                costs.append(REVERSAL)
    return np.array(ends), np.array(costs)


def dijkstra_costs(roads, source, radius, can_reverse, is_from_source):
    """Return the cost (D, N, H, W) to or from the sources by SciPy."""
    ends, costs = graph_of(roads, radius, can_reverse)
    shape = (1 + can_reverse, *source.shape)
    number = math.prod(shape)
    at = np.broadcast_to(np.where(np.asarray(roads.is_open_at), source, np.inf), shape).reshape(-1)
    sources = np.flatnonzero(np.isfinite(at))
    # One more node, from which all sources are reached at their cost.
    tails = np.concatenate([ends[:, 0 if is_from_source else 1], np.full(sources.size, number)])
    heads = np.concatenate([ends[:, 1 if is_from_source else 0], sources])
    lengths = np.concatenate([costs, at[sources] + 1e-9])
    graph = coo_array((lengths, (tails, heads)), shape=(number + 1, number + 1)).tocsr()
    return np.asarray(dijkstra(graph, indices=number))[:number].reshape(shape)


@pytest.mark.parametrize(
    ("can_reverse", "is_from_source"), [*itertools.product((True, False), repeat=2)]
)
def test_costs_are_those_of_dijkstra(can_reverse: bool, is_from_source: bool) -> None:
    lattice = lattice_of(can_reverse=can_reverse)
    roads = roads_of(jnp.asarray(rooms()), lattice)
    source = np.full(roads.is_open_at.shape, np.inf, np.float32)
    source[:, 22, 10], source[3, 5, 20] = 0.0, 1.5
    found = np.asarray(costs_of(roads, jnp.asarray(source), is_from_source))
    expected = dijkstra_costs(roads, source, lattice.radius, can_reverse, is_from_source)
    assert 0.2 < np.isfinite(expected).mean() < 0.9
    np.testing.assert_allclose(found, expected, atol=1e-4)


def test_lengths_in_free_space_are_near_those_of_reeds_and_shepp() -> None:
    size, radius = 40, 0.75
    lattice = lattice_of(radius, reversal_cost=0.0, reverse_penalty=1.0)
    roads = roads_of(jnp.zeros((2 * STRIDE * size, 2 * STRIDE * size), bool), lattice)
    is_open = np.asarray(roads.is_open_at)
    slowness = jnp.full(is_open.shape, SPACING)
    roads = eqx.tree_at(lambda each: each.slowness_at, roads, slowness)
    source = jnp.full(is_open.shape, jnp.inf).at[:, size, size].set(0.0)
    found = np.asarray(costs_of(roads, source)).min(axis=0)
    space = ompl.ReedsSheppStateSpace(radius)
    start, end = space.allocState(), space.allocState()
    end.setXY(0.0, 0.0)
    ratios = []
    for heading in (0, 1, 2):
        for row, column in np.random.default_rng(0).integers(-24, 25, (150, 2)).tolist():
            start.setXY(column * SPACING, row * SPACING)
            start.setYaw((HEADINGS[heading] + math.pi) % math.tau - math.pi)
            least = math.inf
            for yaw in np.linspace(-math.pi, math.pi, 64, endpoint=False):
                end.setYaw(float(yaw))
                least = min(least, space.distance(start, end))
            if least > 4.0 * radius:
                ratios.append(found[heading, size + row, size + column] / least)
    assert len(ratios) > 150
    # The end has any heading. Beyond four radii no path of the lattice is shorter, nor much longer.
    assert min(ratios) > 0.999
    assert np.mean(ratios) < 1.025
    assert max(ratios) < 1.085


def test_a_dead_end_is_left_backwards_and_turned_around_in_three_moves() -> None:
    lattice, forwards = lattice_of(reverse_penalty=1.0), lattice_of(can_reverse=False)
    blocked = np.ones(SHAPE, bool)
    blocked[1:31, 1:40] = False
    blocked[12:20, 40:70] = False  # 0.8 m wide
    roads, one_way = (roads_of(jnp.asarray(blocked), each) for each in (lattice, forwards))
    source = jnp.full(roads.is_open_at.shape, jnp.inf).at[:, 8, 8].set(0.0)
    both, single = (np.asarray(costs_of(each, source)) for each in (roads, one_way))
    into_it, out_of_it = 0, NUM_HEADINGS // 2
    node = (8, 29)
    assert np.asarray(roads.is_open_at)[into_it][node]
    # With its front to the end it backs out, which costs a reversal at most, and cannot turn.
    assert both[1, into_it][node] < both[0, out_of_it][node] + 3.0
    assert both[0, into_it][node] == pytest.approx(both[1, into_it][node] + REVERSAL, abs=1e-4)
    assert np.isinf(single[0, into_it][node])
    assert np.isfinite(single[0, out_of_it][node])


def test_a_gap_is_open_for_the_heading_that_fits() -> None:
    blocked = np.zeros(SHAPE, bool)
    blocked[:26, 38:42] = blocked[33:, 38:42] = True  # a gap 0.7 m wide, in a wall 0.4 m thick
    roads = roads_of(jnp.asarray(blocked), lattice_of())
    at_gap = np.asarray(roads.is_open_at)[:, 14:16, 18:21].any(axis=(1, 2))
    assert at_gap[0]
    assert not at_gap[NUM_HEADINGS // 4]


STEP, NUM_STEPS = 0.0125, 1120


def test_a_car_drives_down_the_cost_as_far_as_it_says() -> None:
    """The way to the source, with its reversals, is as long as the cost-to-go at the car. A car can
    drive it from its own pose: by arcs no tighter than its circle, along its heading, where it
    fits."""
    roads = roads_of(jnp.asarray(rooms()), lattice_of())
    # A metre costs a metre, however tight it is.
    roads = eqx.tree_at(
        lambda each: each.slowness_at, roads, jnp.full(roads.is_open_at.shape, SPACING)
    )
    source = jnp.full(roads.is_open.shape, jnp.inf).at[22, 10].set(0.0)
    field = field_of(roads, source)
    costs = np.asarray(field.at_nodes)
    starts = np.argwhere((costs > 2.0) & (costs < 12.0))
    starts = np.random.default_rng(0).permutation(starts)[:70]
    poses, speeds = poses_near(field, starts)
    # A half begins beside the poses of the lattice.
    aside = np.random.default_rng(1).uniform(-1.0, 1.0, (35, 3)) * [0.08, 0.08, 0.1]
    poses[35:] += aside.astype(np.float32)
    driven = np.asarray(
        drive(field, jnp.asarray(poses), jnp.asarray(speeds), jnp.asarray(STEP), NUM_STEPS), float
    )
    begin = np.asarray(costs_at(field, poses, speeds))
    # At a pose of the lattice no way there is needed.
    is_clear = np.asarray(roads.is_clear_at)[tuple(starts[:35, 1:].T)]
    assert is_clear.sum() > 10
    assert (begin[:35] < costs[tuple(starts[:35].T)] + 1e-4)[is_clear].all()
    end = np.asarray(field.frame.cell_centre(jnp.asarray([22, 10])))
    num_reversed, errors = 0, []
    for speed, expected, first, path in zip(speeds, begin, poses, driven, strict=True):
        path = np.concatenate([first[None], path])
        move, turn = np.diff(path[:, :2], axis=0), np.diff(path[:, 2])
        turn = np.mod(turn + math.pi, math.tau) - math.pi
        length = np.linalg.norm(move, axis=1)
        moves = length > 1e-5
        middle = path[:-1, 2] + 0.5 * turn
        along = move[:, 0] * np.cos(middle) + move[:, 1] * np.sin(middle)
        travel = np.sign(np.concatenate([[speed], along[moves]]))
        reversals = int((np.diff(travel) != 0.0).sum())
        num_reversed += reversals
        prices = np.where(along < 0.0, PENALTY, 1.0)
        errors.append((prices * length).sum() + REVERSAL * reversals - expected)
        np.testing.assert_allclose(path[-1, :2], end, atol=1e-4)
        # It begins at the car, not at a pose of the lattice near it.
        assert length[0] < 1.01 * STEP
        is_whole = moves & (length > 0.99 * STEP)
        assert (np.abs(along[is_whole]) > 0.999 * length[is_whole]).all()
        assert (np.abs(turn) <= STEP / (SPACING * roads.radius) + 1e-4).all()
        rows, columns = np.floor(path[:, 1::-1].T / SPACING).astype(int)
        assert np.asarray(roads.is_open)[rows, columns].all()
    assert num_reversed > 10
    # Less than two steps: the last one, and one in which the car turns back, are counted short.
    np.testing.assert_allclose(errors, 0.0, atol=2.0 * STEP * PENALTY)


@eqx.filter_jit
def ahead_of(field, pose, speed):
    """Return the path ahead of a car, the field with its channel, and its costs along the path."""
    steps = jnp.full(2, field.frame.resolution)
    path = field._path(pose, speed, steps, CHANNEL_LENGTH)
    channel = field.from_pose(pose)

    def along(each, towards):
        return jax.vmap(lambda at, v: each.at_pose(at[:2], at[2], v)[0])(path.poses, towards)

    towards = jnp.where(path.directions == 1, -1.0, 1.0)
    return path, channel, along(field, towards), along(channel, towards)


def test_the_channel_leads_a_car_along_its_path() -> None:
    """Along the path the cost is that of the rest of the path, where it was a ridge without."""
    roads = roads_of(jnp.asarray(rooms()), lattice_of())
    source = jnp.full(roads.is_open.shape, jnp.inf).at[22, 10].set(0.0)
    field = field_of(roads, source)
    costs = np.asarray(field.at_nodes)
    begins = np.argwhere(np.isfinite(costs) & (costs > 4.0))
    ridges, rises, shares = [], [], []
    for direction, heading, row, column in np.random.default_rng(3).permutation(begins)[:150]:
        place = field.frame.cell_centre(jnp.asarray([row, column]))
        pose = jnp.append(place, jnp.asarray(HEADINGS[heading], jnp.float32))
        path, _, before, after = ahead_of(field, pose, jnp.asarray(1.0 - 2.0 * direction))
        rest = np.asarray(path.costs)
        assert (np.diff(rest) <= 1e-4).all()
        ridges.append((np.asarray(before) - rest).max())
        prices = (roads.radius * SPACING, roads.reversal_cost)
        kept = np.isfinite(without_shortcuts(path, pose, jnp.asarray(direction), *prices).costs)
        rises.append((np.asarray(after) - rest)[kept].max())
        shares.append(kept.mean())
        # Only what comes after a reversal may be left out.
        turns = np.flatnonzero(np.diff(np.asarray(path.directions)))
        assert kept[: turns[0] + 1 if len(turns) else None].all()
    # The cost is interpolated over a node and a heading, at whose ends the car strays by half.
    node, turn = SPACING / 2.0, roads.radius * SPACING * math.radians(14.0)
    assert max(rises) < STRAYING * (2.0 * node**2 + turn**2)
    # What no rollout crosses: a rise on the way of more than two metres.
    assert max(ridges) > 2.0
    # Few ways have a shortcut, and they are led along most of their length.
    assert np.mean(shares) > 0.97
    assert min(shares) >= 0.5


def test_no_channel_makes_the_place_of_a_car_cheaper_than_its_path() -> None:
    """Back by 0.8 m, and then forwards past the place where the car is: it would stand there."""
    back, on = np.linspace(-0.2, -0.8, 4), np.linspace(-0.6, 1.0, 9)
    places = np.column_stack([np.append(back, on), [0.0] * 4 + [0.2] * 9, np.zeros(13)])
    directions = np.array([1] * 4 + [0] * 9, np.int32)
    costs = 10.0 - 0.2 * np.arange(13)
    path = DrivenPath(
        *(jnp.asarray(each) for each in (places.astype(np.float32), directions)),
        jnp.asarray(costs, jnp.float32),
    )
    kept = without_shortcuts(path, jnp.zeros(3), jnp.asarray(1), 0.75, jnp.asarray(REVERSAL))
    strays = STRAYING * (places[:, 0] ** 2 + places[:, 1] ** 2)
    is_shortcut = (directions == 0) & (costs + REVERSAL + strays < 10.0)
    assert 2 <= is_shortcut.sum() < 9
    np.testing.assert_array_equal(np.isinf(np.asarray(kept.costs)), is_shortcut)


@pytest.mark.parametrize("can_reverse", [True, False])
def test_the_channel_is_the_cost_of_straying_from_the_path(can_reverse: bool) -> None:
    lattice = lattice_of(can_reverse=can_reverse)
    roads = roads_of(jnp.asarray(rooms()), lattice)
    field = field_of(roads, jnp.full(roads.is_open.shape, jnp.inf).at[22, 10].set(0.0))
    lowered = []
    # The last pose is beside the edge of the map, where a part of the channel would be off it.
    for x, y, yaw in ((5.3, 4.4, 0.4), (1.1, 5.2, -2.9), (7.0, 0.9, 3.0), (0.35, 4.0, 1.6)):
        pose = jnp.asarray([x, y, yaw])
        expected = np.asarray(field.by_heading, np.float64).copy()
        count, _, height, width = expected.shape
        rows, columns = np.mgrid[:height, :width]
        for speed in (1.0, -1.0)[:count]:
            path, channel, _, _ = ahead_of(field, pose, jnp.asarray(speed))
            own = jnp.asarray(0 if speed > 0.0 else 1)
            path = without_shortcuts(path, pose, own, roads.radius * SPACING, roads.reversal_cost)
            for point, way, rest in zip(*(np.asarray(each) for each in path), strict=True):
                # Nodes are the centres of the cells of the lattice.
                down, right = point[1] / SPACING - 0.5, point[0] / SPACING - 0.5
                squared = SPACING**2 * ((rows - down) ** 2 + (columns - right) ** 2)
                is_beside = np.maximum(
                    np.abs(rows - np.floor(down + 0.5)), np.abs(columns - np.floor(right + 0.5))
                )
                for direction, heading in np.ndindex(count, NUM_HEADINGS):
                    turn = (HEADINGS[heading] - point[2] + math.pi) % math.tau - math.pi
                    bound = rest + STRAYING * (squared + (roads.radius * SPACING * turn) ** 2)
                    bound = bound + REVERSAL * (direction != way)
                    at = expected[direction, heading]
                    is_lower = (is_beside <= CHANNEL_WIDTH) & (bound < at)
                    at[is_lower] = bound[is_lower]
        lowered.append((np.asarray(field.by_heading) - expected).max())
        np.testing.assert_allclose(np.asarray(channel.channelled), expected, atol=2e-3)
        # What the path follows is the cost-to-go itself.
        np.testing.assert_array_equal(channel.by_heading, field.by_heading)
    assert max(lowered) > 0.1


def test_a_car_that_is_lost_or_shut_in_has_no_channel() -> None:
    roads = roads_of(jnp.asarray(rooms()), lattice_of())
    field = field_of(roads, jnp.full(roads.is_open.shape, jnp.inf).at[22, 10].set(0.0))
    shut_in = field_of(roads, jnp.full(roads.is_open.shape, jnp.inf))
    pose = jnp.asarray([5.3, 4.4, 0.4])
    for each, at in ((field, jnp.asarray([jnp.nan, 4.4, 0.0])), (shut_in, pose)):
        channel = ahead_of(each, at, jnp.asarray(1.0))[1]
        np.testing.assert_array_equal(channel.channelled, each.by_heading)


def test_a_car_that_is_nowhere_or_at_its_end_stands() -> None:
    roads = roads_of(jnp.asarray(rooms()), lattice_of())
    source = jnp.full(roads.is_open.shape, jnp.inf).at[22, 10].set(0.0)
    field = field_of(roads, source)
    x, y = np.asarray(field.frame.cell_centre(jnp.asarray([22, 10])))
    poses = np.array([[x, y, 0.3], [math.nan, y, 0.0]], np.float32)
    stand = drive(field, jnp.asarray(poses), jnp.zeros(2), jnp.asarray(STEP), NUM_STEPS)
    np.testing.assert_array_equal(stand, np.repeat(poses[:, None], NUM_STEPS, axis=1))


def test_a_field_is_read_at_its_nodes_and_between_headings() -> None:
    roads = roads_of(jnp.asarray(rooms()), lattice_of())
    source = jnp.full(roads.is_open.shape, jnp.inf).at[22, 10].set(0.0)
    field = field_of(roads, source)
    node = field.frame.cell_centre(jnp.asarray([8, 12]))
    for direction, speed in ((0, 1.0), (0, 0.0), (1, -1.0)):
        values = np.asarray(field.by_heading)[direction, :, 8, 12]
        for k, heading in enumerate(HEADINGS):
            gap = (HEADINGS[(k + 1) % NUM_HEADINGS] - heading) % math.tau
            for share in (0.0, 0.25):
                angle = jnp.asarray(heading + share * gap - math.tau, jnp.float32)
                cost, facing, most = field.at_pose(node, angle, jnp.asarray(speed))
                expected = values[k] + share * (values[(k + 1) % NUM_HEADINGS] - values[k])
                assert float(cost) == pytest.approx(expected, abs=2e-3)
                assert float(facing) == float(most) == 1.0
    lost = field.at_pose(node, jnp.asarray(jnp.nan), jnp.asarray(1.0))[0]
    assert float(lost) == float(field.outside)


def test_robots_that_turn_on_the_spot_have_no_car_motion() -> None:
    assert car_motion(jx.DifferentialDrive()) is None
    car = car_motion(jx.Ackermann(wheelbase=0.5, max_steering=0.6))
    assert car is not None
    assert float(car.turning_radius) == pytest.approx(0.5 / math.tan(0.6))
    assert not car.can_reverse
    reversing = jx.Ackermann(min_speed=-1.0)
    assert car_motion(reversing).can_reverse
    lidar = jx.Lidar(num_beams=8, max_range=2.0)
    assert isinstance(jx.Perception(lidar, 0.1, 0.2).locomotion, TurnsOnTheSpot)


def rooms_with_passage(width: int) -> np.ndarray:
    """Return two rooms with a wall between them, and a passage of a metre with a width [cells]."""
    blocked = np.pad(np.zeros((SHAPE[0] - 2, SHAPE[1] - 2), bool), 1, constant_values=True)
    blocked[:, 35:45] = True
    blocked[30 : 30 + width, 35:45] = False
    return blocked


def test_a_car_takes_a_passage_without_its_margin() -> None:
    """A passage with 0.25 m beside its middle is none for a car that keeps 0.3 m, and 0.21 m is."""
    wide, narrow = 0.3, 0.21
    with_margin = lattice_of()
    without = CarMotion(0.7, BODY, reversal_cost=REVERSAL, reverse_penalty=PENALTY).lattice(
        SPACING, jnp.asarray(narrow)
    )
    for width, is_wide, is_open in ((4, False, False), (5, False, True), (7, True, True)):
        blocked = jnp.asarray(rooms_with_passage(width))
        costs = []
        for lattice in (with_margin, without):
            roads = roads_of(blocked, lattice, wide)
            source = jnp.full(roads.is_open_at.shape, jnp.inf).at[:, 15, 10].set(0.0)
            costs.append(np.asarray(costs_of(roads, source)))
        left, right = np.s_[:, :, :, :12], np.s_[:, :, :, 24:]
        assert [np.isfinite(each[right]).any() for each in costs] == [is_wide, is_open]
        # A pose beside a wall is in no passage, and another way never costs more.
        np.testing.assert_allclose(costs[1][left], costs[0][left], atol=1e-4)
        assert (costs[1] <= costs[0] + 1e-4).all()
        if is_open and not is_wide:
            # A metre of it has the price of narrow places.
            assert 0.7 * NARROW_PRICE < costs[1][right].min() < 2.0 * NARROW_PRICE


def test_passages_are_those_of_their_definition() -> None:
    rng = np.random.default_rng(5)
    shape = (NUM_HEADINGS, 9, 11)
    fits = rng.random(shape) < 0.7
    is_open = fits & (rng.random(shape) < 0.4)
    found = np.asarray(jax.jit(in_passage)(jnp.asarray(is_open), jnp.asarray(fits)))

    def at(poses, heading, row, column) -> bool:
        return 0 <= row < shape[1] and 0 <= column < shape[2] and bool(poses[heading, row, column])

    inside = np.zeros(shape, bool)
    for k, row, column in np.ndindex(shape):
        down, right = round(math.sin(HEADINGS[k])), round(math.cos(HEADINGS[k]))

        def leads_on(r, c, k=k, down=down, right=right) -> bool:
            return at(fits, k, r + down, c + right) and at(fits, k, r - down, c - right)

        sides = [(row - right, column + down), (row + right, column - down)]
        has_room = any(at(is_open, k, *side) and leads_on(*side) for side in sides)
        is_tight = at(fits, k, row, column) and not at(is_open, k, row, column)
        inside[k, row, column] = is_tight and leads_on(row, column) and not has_room
    expected = np.zeros(shape, bool)
    for k, row, column in np.argwhere(inside):
        for turn, down, right in itertools.product((-1, 0, 1), repeat=3):
            if 0 <= row + down < shape[1] and 0 <= column + right < shape[2]:
                expected[(k + turn) % NUM_HEADINGS, row + down, column + right] = True
    expected &= fits & ~is_open
    assert inside.mean() > 0.02
    assert expected.mean() < (fits & ~is_open).mean()
    np.testing.assert_array_equal(found, expected)


def test_a_turning_radius_beyond_the_lattice_is_refused() -> None:
    with pytest.raises(ValueError, match=r"turning_radius is 50 m; accepted: .* at most 8 m"):
        CarMotion(50.0, BODY).lattice(SPACING)
