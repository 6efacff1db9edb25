import math
from collections.abc import Iterator
from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore import Lidar, OccupancyGrid, PoseInformation, TrajectoryInformation
from jaxplore.information import path_headings

pytestmark = pytest.mark.long

METHODS = ("direct", "discount", "filtered", "temporal", "occlusion")
SHAPE, RESOLUTION, LENGTH = (13, 16), 0.1, 7
FRAMES = [(0.0, 0.0, 0.0), (2.0, -1.0, 0.7), (-0.3, 4.0, -2.5)]
NARROW, WIDE, FULL = (
    PoseInformation(Lidar(num_beams=24, max_range=0.57, field_of_view=view))
    for view in (2.0, 4.0, 2.0 * math.pi)
)
NAN = math.nan


def methods_of(pose: PoseInformation, every: int = 1) -> list[TrajectoryInformation]:
    return [TrajectoryInformation(pose, method, every=every) for method in METHODS]


@eqx.filter_jit
def all_per_pose(methods, grid, positions, headings):
    return jnp.stack([method.per_pose(grid, positions, headings) for method in methods])


scan_jit = eqx.filter_jit(lambda pose, *given: (pose(*given), pose.view(*given)))
headings_jit = jax.jit(path_headings)


def evaluate(
    pose: PoseInformation, grid: OccupancyGrid, positions, headings, every: int = 1
) -> dict[str, np.ndarray]:
    """Return what each pose adds (N,), by method.

    Fewer poses than LENGTH are followed by lost ones: another number would be another program.
    """
    count = len(positions)
    padded = np.full((LENGTH, 2), NAN, np.float32)
    padded[:count] = positions
    if headings is not None:
        given = np.zeros(LENGTH, np.float32)
        given[:count] = headings
        headings = jnp.asarray(given)
    found = all_per_pose(methods_of(pose, every), grid, jnp.asarray(padded), headings)
    assert found.dtype == jnp.float32
    values = np.asarray(found, float)
    np.testing.assert_array_equal(values[:, count:], 0.0)
    return dict(zip(METHODS, values[:, :count], strict=True))


# The definitions, in double precision, cell by cell.


def grid_point(grid: OccupancyGrid, position: np.ndarray) -> tuple[float, float]:
    x0, y0, yaw = np.asarray(grid.frame.origin, float)
    x, y = float(position[0]) - x0, float(position[1]) - y0
    cos, sin = math.cos(yaw), math.sin(yaw)
    return (cos * y - sin * x) / RESOLUTION, (cos * x + sin * y) / RESOLUTION


def bearings(
    grid: OccupancyGrid, position: np.ndarray, heading: float
) -> Iterator[tuple[tuple[int, int], float, float]]:
    """Yield each cell of the map, how far its centre is [cells] and how far off the heading."""
    row, column = grid_point(grid, position)
    ahead = float(heading) - float(grid.frame.origin[2])
    for i in range(grid.shape[0]):
        for j in range(grid.shape[1]):
            down, right = i + 0.5 - row, j + 0.5 - column
            off = math.remainder(math.atan2(down, right) - ahead, 2.0 * math.pi)
            yield (i, j), math.hypot(down, right), abs(off)


def can_see(grid: OccupancyGrid, position: np.ndarray, heading: float) -> bool:
    if not (np.isfinite(position).all() and math.isfinite(heading)):
        return False
    row, column = (math.floor(value) for value in grid_point(grid, position))
    on_map = 0 <= row < grid.shape[0] and 0 <= column < grid.shape[1]
    return on_map and float(grid.probability[row, column]) <= 0.65


def cells_in_view(
    grid: OccupancyGrid, lidar: Lidar, position: np.ndarray, heading: float
) -> set[tuple[int, int]]:
    if not can_see(grid, position, heading):
        return set()
    return {
        cell
        for cell, distance, off in bearings(grid, position, heading)
        if distance * RESOLUTION <= lidar.max_range and off <= lidar.field_of_view / 2.0
    }


def is_clear_cut(grid: OccupancyGrid, lidar: Lidar, position: np.ndarray, heading: float) -> bool:
    """Say whether no cell's centre is on the edge of range or view, and the pose on no cell's."""
    for value in grid_point(grid, position):
        if abs(value - round(value)) < 1e-3:
            return False
    for _, distance, off in bearings(grid, position, heading):
        if abs(distance - lidar.max_range / RESOLUTION) < 1e-4 or distance < 1e-2:
            return False
        if abs(off - lidar.field_of_view / 2.0) * distance < 1e-4:
            return False
    # A view that holds no cell's centre has a test of its own.
    return bool(cells_in_view(grid, lidar, position, heading)) or not can_see(
        grid, position, heading
    )


def by_definition(
    pose: PoseInformation, grid: OccupancyGrid, positions, headings, every: int
) -> dict[str, np.ndarray]:
    """Return what each pose adds, by method."""
    expected: dict[str, list[float]] = {method: [] for method in METHODS}
    views = np.zeros(grid.shape, int)
    best: dict[tuple[int, int], float] = {}
    cells_of_map = set(np.ndindex(grid.shape))
    for index in range(0, len(positions), every):
        at, yaw = positions[index], headings[index]
        value, view = scan_jit(pose, grid, jnp.asarray(at), jnp.asarray(yaw))
        value = float(value)
        expected["direct"].append(value)
        expected["temporal"].append(value * 0.95**index)

        seen = cells_in_view(grid, pose.lidar, at, yaw)
        earlier = [int(views[cell]) for cell in seen]
        mean = sum(earlier) / len(earlier) if earlier else 0.0
        fresh = earlier.count(0) / len(earlier) if earlier else 1.0
        expected["discount"].append(value * math.exp(-0.7 * mean))
        expected["filtered"].append(value * fresh)
        for cell in seen:
            views[cell] += 1

        contribution: dict[tuple[int, int], float] = {}
        cells, values = np.asarray(view.cell), np.asarray(view.value, float)
        for beam in range(len(cells)):
            for (row, column), share in zip(cells[beam], values[beam], strict=True):
                if share > 0.0:
                    assert (row, column) in cells_of_map
                    known = contribution.get((row, column), 0.0)
                    contribution[row, column] = known + share
        gain = 0.0
        for cell, share in contribution.items():
            gain += max(0.0, share - best.get(cell, 0.0))
            best[cell] = max(share, best.get(cell, 0.0))
        expected["occlusion"].append(gain)
    # Summed up pose by pose it is the best view of every cell.
    assert sum(expected["occlusion"]) == pytest.approx(sum(best.values()), rel=1e-9)
    return {method: np.asarray(values) for method, values in expected.items()}


def headings_by_loop(positions: np.ndarray) -> np.ndarray:
    """Return where a robot looks that keeps its heading while it stands still."""
    steps = [positions[i + 1] - positions[i] for i in range(len(positions) - 1)]
    angles = [math.atan2(s[1], s[0]) if math.hypot(*s) > 1e-6 else None for s in steps]
    last = next((angle for angle in angles if angle is not None), 0.0)
    headings = []
    for angle in angles:
        last = last if angle is None else angle
        headings.append(last)
    return np.asarray([*headings, last])


def random_grid(seed: int, frame: tuple[float, float, float]) -> OccupancyGrid:
    rng = np.random.default_rng(seed)
    p = rng.choice([0.001, 0.1, 0.3, 0.5, 0.9, 0.993], SHAPE, p=[0.3, 0.2, 0.15, 0.25, 0.05, 0.05])
    return OccupancyGrid(p, RESOLUTION, frame)


def random_positions(rng: np.random.Generator, grid: OccupancyGrid, count: int) -> np.ndarray:
    """Return positions on the map and shortly beside it."""
    points = rng.uniform(-1.5, np.asarray(SHAPE) + 1.5, (count, 2))
    return np.array(grid.frame.to_world(jnp.asarray(points, jnp.float32)))


def random_trajectory(
    seed: int, grid: OccupancyGrid, lidar: Lidar
) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and headings, one of them twice, one of them lost, all clear-cut."""
    rng = np.random.default_rng(seed)
    positions, headings = [], []
    while len(positions) < LENGTH:
        at = random_positions(rng, grid, 1)[0]
        yaw = np.float32(rng.uniform(-7.0, 7.0))
        if is_clear_cut(grid, lidar, at, yaw) and (positions or can_see(grid, at, yaw)):
            positions.append(at)
            headings.append(yaw)
    positions[3], headings[3] = positions[0], headings[0]
    lost = rng.choice([1, 2, 4, 5, 6])
    positions[lost] = np.asarray([NAN, positions[lost][1]], np.float32)
    return np.asarray(positions), np.asarray(headings)


def random_path(seed: int, grid: OccupancyGrid, lidar: Lidar) -> np.ndarray:
    """Return positions along a path of two straight stretches, all clear-cut."""
    for attempt in range(1000):
        rng = np.random.default_rng([seed, attempt])
        corners = np.asarray(random_positions(rng, grid, 3), float)
        stretch = LENGTH // 2
        share = np.arange(stretch)[:, None] / stretch
        first, second = (a + share * (b - a) for a, b in pairwise(corners))
        path = np.concatenate([first, second, corners[2:]]).astype(np.float32)
        poses = zip(path, headings_by_loop(path.astype(float)), strict=True)
        if all(is_clear_cut(grid, lidar, *pose) for pose in poses):
            return path
    raise AssertionError("no path without a cell on the edge of a view")


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("pose", [NARROW, WIDE, FULL], ids=["narrow", "wide", "full circle"])
def test_every_method_is_its_definition(pose: PoseInformation, seed: int) -> None:
    grid = random_grid(seed, FRAMES[seed])
    positions, headings = random_trajectory(seed, grid, pose.lidar)
    found = evaluate(pose, grid, positions, headings)
    expected = by_definition(pose, grid, positions, headings, every=1)
    for method in METHODS:
        np.testing.assert_allclose(
            found[method], expected[method], rtol=2e-5, atol=2e-5, err_msg=method
        )
    assert all(expected[m].sum() < expected["direct"].sum() - 0.05 for m in METHODS[1:])


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_looks_along_the_path_without_headings(seed: int) -> None:
    """And at every third pose of it."""
    every, grid = 3, random_grid(seed, FRAMES[seed])
    positions = random_path(seed, grid, NARROW.lidar)
    headings = headings_by_loop(positions.astype(float)).astype(np.float32)
    found = evaluate(NARROW, grid, positions, None, every)
    expected = by_definition(NARROW, grid, positions, headings, every)
    for method in METHODS:
        np.testing.assert_allclose(
            found[method], expected[method], rtol=2e-5, atol=2e-5, err_msg=method
        )
    assert expected["direct"].sum() > 0.5


seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.sampled_from(FRAMES), st.sampled_from([NARROW, WIDE, FULL]))
@settings(max_examples=40)
def test_bounds_hold_for_any_trajectory(
    seed: int, frame: tuple[float, float, float], pose: PoseInformation
) -> None:
    rng = np.random.default_rng(seed)
    grid = random_grid(seed, frame)
    positions = random_positions(rng, grid, LENGTH)
    headings = rng.uniform(-7.0, 7.0, LENGTH)
    positions[rng.random(LENGTH) < 0.1, rng.integers(2)] = rng.choice([NAN, math.inf])
    found = evaluate(pose, grid, positions, headings)
    direct = found["direct"]
    for method, values in found.items():
        assert np.isfinite(values).all(), method
        assert (values >= 0.0).all(), method
        assert (values <= direct * (1.0 + 1e-5) + 1e-6).all(), method
    # Together the poses are worth no less than the best of them.
    assert found["occlusion"].sum() >= direct.max() * (1.0 - 1e-5)
    backwards = evaluate(pose, grid, positions[::-1], headings[::-1])
    np.testing.assert_allclose(backwards["direct"], direct[::-1], rtol=1e-5)
    assert backwards["occlusion"].sum() == pytest.approx(found["occlusion"].sum(), rel=1e-5)


@given(seeds)
@settings(max_examples=20)
def test_one_pose_is_worth_the_same_by_every_method(seed: int) -> None:
    grid = random_grid(seed, FRAMES[seed % 3])
    positions, headings = random_trajectory(seed, grid, NARROW.lidar)
    found = evaluate(NARROW, grid, positions[:1], headings[:1])
    for method in METHODS:
        np.testing.assert_allclose(found[method], found["direct"], rtol=1e-5, err_msg=method)


@given(seeds)
@settings(max_examples=20)
def test_looking_twice_from_the_same_pose(seed: int) -> None:
    grid = random_grid(seed, FRAMES[seed % 3])
    positions, headings = random_trajectory(seed, grid, NARROW.lidar)
    positions[2:] = NAN  # they see nothing
    positions[1], headings[1] = positions[0], headings[0]
    found = {method: v[:2] for method, v in evaluate(NARROW, grid, positions, headings).items()}
    once = found["direct"][0]
    for method, again in {
        "direct": 1.0,
        "discount": math.exp(-0.7),
        "filtered": 0.0,
        "temporal": 0.95,
        "occlusion": 0.0,
    }.items():
        np.testing.assert_allclose(
            found[method], [once, again * once], rtol=1e-5, atol=1e-6, err_msg=method
        )


@pytest.mark.parametrize(
    ("points", "headings"),
    [
        ([(6.3, 2.4), (6.6, 14.7)], [0.3, 2.8]),  # more than two ranges apart
        ([(6.3, 8.2), (6.3, 7.7)], [0.0, math.pi]),  # back to back, in neighbouring cells
    ],
    ids=["far apart", "back to back"],
)
@pytest.mark.parametrize("frame", FRAMES)
def test_views_that_do_not_overlap_add_up(points, headings, frame) -> None:
    p = np.random.default_rng(4).choice([0.1, 0.3, 0.5], SHAPE)
    grid = OccupancyGrid(p, RESOLUTION, frame)
    positions = grid.frame.to_world(jnp.asarray(points))
    found = evaluate(NARROW, grid, positions, np.asarray(headings) + frame[2])
    assert (found["direct"] > 0.5).all()
    for method in ("discount", "filtered", "occlusion"):
        np.testing.assert_allclose(found[method], found["direct"], rtol=1e-5, err_msg=method)


def test_only_occlusion_knows_that_a_wall_has_hidden_what_is_behind() -> None:
    p = np.full(SHAPE, 0.5)
    p[:, 5] = 0.993
    grid = OccupancyGrid(p, RESOLUTION)
    # The first looks at the wall, which hides half of its field of view from it; the second looks
    # back from there.
    positions = np.asarray([[0.33, 0.66], [0.93, 0.66]])
    headings = np.asarray([0.0, math.pi])
    first, second = (
        cells_in_view(grid, NARROW.lidar, *pose) for pose in zip(positions, headings, strict=True)
    )
    behind = {cell for cell in first if cell[1] > 5}
    assert len(behind) > 0.5 * len(first)
    assert len(first & second) > 0.5 * len(second)
    found = evaluate(NARROW, grid, positions, headings)
    assert found["occlusion"][1] > 0.99 * found["direct"][1] > 0.5
    assert found["filtered"][1] < 0.5 * found["direct"][1]
    assert found["occlusion"].sum() > 1.3 * found["filtered"].sum()


@pytest.mark.parametrize("pose", [NARROW, FULL], ids=["narrow", "full"])
def test_a_trajectory_off_the_map_is_worth_nothing(pose: PoseInformation) -> None:
    grid = OccupancyGrid(np.full(SHAPE, 0.5), RESOLUTION, FRAMES[1])
    outside = np.asarray([(-0.4, 3.0), (3.0, -0.4), (13.4, 3.0), (3.0, 16.4), (-80.0, 400.0)])
    world = np.asarray(grid.frame.to_world(jnp.asarray(outside, jnp.float32)))
    positions = np.concatenate([world, [[NAN, NAN], [math.inf, 0.0]]])
    for method, values in evaluate(pose, grid, positions, np.zeros(LENGTH)).items():
        np.testing.assert_array_equal(values, 0.0, err_msg=method)
    for method, values in evaluate(NARROW, grid, positions, None, every=3).items():
        np.testing.assert_array_equal(values, 0.0, err_msg=method)


def test_who_sees_nothing_takes_nothing_from_the_others() -> None:
    """Poses off the map, in a wall or nowhere, though the same cells are in their range."""
    p = np.full(SHAPE, 0.5)
    p[6, 4] = 0.9
    grid = OccupancyGrid(p, RESOLUTION)
    blind = [[0.45, 0.65], [-0.01, 0.65], [NAN, 0.65], [0.45, math.inf], [0.45, 1.31], [9.0, 9.0]]
    found = evaluate(FULL, grid, [*blind, [0.53, 0.66]], np.zeros(LENGTH))
    for method in ("direct", "discount", "filtered", "occlusion"):
        np.testing.assert_array_equal(found[method][:-1], 0.0)
        assert found[method][-1] == pytest.approx(found["direct"][-1], rel=1e-5)
    assert found["direct"][-1] > 1.0


@pytest.mark.parametrize("pose", [NARROW, WIDE, FULL], ids=["narrow", "wide", "full circle"])
def test_a_heading_that_is_not_finite_sees_nothing(pose: PoseInformation) -> None:
    grid = OccupancyGrid(np.full(SHAPE, 0.5), RESOLUTION)
    positions, headings = np.full((LENGTH, 2), 0.63), np.zeros(LENGTH)
    lost = [0, 2, 5]
    headings[lost] = [NAN, math.inf, NAN]
    found = evaluate(pose, grid, positions, headings)
    positions[lost], headings[lost] = NAN, 0.0
    expected = evaluate(pose, grid, positions, headings)
    for method in METHODS:
        np.testing.assert_array_equal(found[method], expected[method], err_msg=method)
        np.testing.assert_array_equal(found[method][lost], 0.0, err_msg=method)
    assert found["filtered"].sum() == pytest.approx(found["direct"][1], rel=1e-5)


def test_one_narrow_beam_between_the_centres_of_cells_is_worth_something() -> None:
    """No centre is in so narrow a view: nothing in it has been seen before."""
    pose = PoseInformation(Lidar(num_beams=2, max_range=0.57, field_of_view=0.02))
    grid = OccupancyGrid(np.full(SHAPE, 0.5), RESOLUTION)
    given = grid, jnp.asarray([[0.53, 0.61]]), jnp.zeros(1)
    methods = [TrajectoryInformation(pose, method) for method in ("direct", "filtered")]
    direct, filtered = np.asarray(all_per_pose(methods, *given))[:, 0]
    assert cells_in_view(grid, pose.lidar, np.asarray([0.53, 0.61]), 0.0) == set()
    assert filtered == pytest.approx(direct, rel=1e-5)


def test_a_batch_of_trajectories_is_each_of_them() -> None:
    """Each as a whole, which is the sum over its poses."""
    grid = random_grid(5, FRAMES[1])
    batch = [random_trajectory(seed, grid, NARROW.lidar) for seed in range(3)]
    positions, headings = (jnp.asarray(np.stack(a)) for a in zip(*batch, strict=True))
    methods = methods_of(NARROW)[1:]

    @jax.jit
    @jax.vmap
    def together(positions, headings):
        return jnp.stack([method(grid, positions, headings) for method in methods])

    found = together(positions, headings)
    assert found.shape == (3, 4)
    for values, trajectory in zip(found, batch, strict=True):
        alone = evaluate(NARROW, grid, *trajectory)
        expected = [alone[method.method].sum() for method in methods]
        np.testing.assert_allclose(values, expected, rtol=1e-5)


def test_rates_are_data() -> None:
    """Other rates give other values and no other program."""
    traces = []

    @eqx.filter_jit
    def worth(method, grid, positions, headings):
        traces.append(method.method)
        return method.per_pose(grid, positions, headings)

    grid = OccupancyGrid(np.full(SHAPE, 0.5), RESOLUTION)
    positions, headings = jnp.full((3, 2), 0.63), jnp.zeros(3)
    for rate in (0.0, 0.3, 2.0):
        method = TrajectoryInformation(NARROW, "discount", decay=rate)
        values = np.asarray(worth(method, grid, positions, headings))
        np.testing.assert_allclose(values / values[0], np.exp(-rate * np.arange(3)), rtol=1e-5)
    for rate in (1.0, 0.5, 0.1):
        method = TrajectoryInformation(NARROW, "temporal", discount=rate)
        values = np.asarray(worth(method, grid, positions, headings))
        np.testing.assert_allclose(values / values[0], rate ** np.arange(3), rtol=1e-5)
    assert traces == ["discount", "temporal"]


def path_of(steps: list[tuple[float, float]]) -> np.ndarray:
    return (np.asarray([0.3, -0.2]) + np.cumsum([(0.0, 0.0), *steps], axis=0)).astype(np.float32)


def check_headings(steps: list[tuple[float, float]]) -> np.ndarray:
    path = path_of(steps)
    found = np.asarray(headings_jit(path), float)
    expected = headings_by_loop(path.astype(float))
    # Half a turn and minus half a turn are one.
    apart = [math.remainder(difference, 2.0 * math.pi) for difference in found - expected]
    np.testing.assert_allclose(apart, 0.0, atol=1e-4)
    return found


STILL, NORTH, WEST, BACK = (0.0, 0.0), (0.0, 0.1), (-0.1, 0.0), (-0.2, -0.1)
UP, BACKWARDS = math.pi / 2.0, math.atan2(-0.1, -0.2)


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ([BACK] * 8, [BACKWARDS] * 9),
        ([STILL] * 3 + [NORTH] * 3 + [BACK] * 2, [UP] * 6 + [BACKWARDS] * 3),
        ([NORTH] * 2 + [STILL] * 4 + [BACK] * 2, [UP] * 6 + [BACKWARDS] * 3),
        ([BACK] * 2 + [NORTH] * 2 + [STILL] * 4, [BACKWARDS] * 2 + [UP] * 7),
        ([STILL] * 8, [0.0] * 9),
    ],
    ids=["straight", "still at first", "still on the way", "still at last", "always still"],
)
def test_headings_follow_the_path_and_last_through_a_stop(steps, expected) -> None:
    np.testing.assert_allclose(check_headings(steps), expected, atol=1e-5)


def test_headings_on_a_circle_are_its_chords() -> None:
    angles = np.linspace(0.0, 1.5 * math.pi, 9)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    found = check_headings([tuple(step) for step in np.diff(circle, axis=0)])
    middle = 0.5 * (angles[1:] + angles[:-1]) + math.pi / 2.0
    np.testing.assert_allclose(np.unwrap(found[:-1]), middle, atol=1e-5)


def test_headings_of_a_single_point_and_past_a_lost_one() -> None:
    np.testing.assert_array_equal(path_headings(jnp.asarray([[3.0, 4.0]])), [0.0])
    path = path_of([NORTH] * 4 + [WEST] * 4)
    path[2, 1] = NAN
    found = np.asarray(headings_jit(path))
    np.testing.assert_allclose(found, [UP] * 4 + [math.pi] * 5, atol=1e-5)


@given(
    st.lists(
        st.one_of(
            st.just(STILL),
            st.tuples(st.integers(-40, 40), st.integers(-40, 40)).map(
                lambda step: (step[0] / 32.0, step[1] / 32.0)
            ),
        ),
        min_size=8,
        max_size=8,
    )
)
def test_headings_of_any_path(steps: list[tuple[float, float]]) -> None:
    check_headings(steps)
