import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore import Lidar, OccupancyGrid
from jaxplore.belief.zones import Zones, entropy_proxy, unknown_fraction, visible

SHAPE, RESOLUTION, ORIGIN = (14, 18), 0.25, (1.0, -2.0, 0.6)
LIDAR = Lidar(num_beams=9, max_range=2.1, field_of_view=2.0)
visible_jit = jax.jit(lambda grid, pose: visible(grid, pose[:2], pose[2], LIDAR))


def random_map(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    levels, share = [0.0, 0.02, 0.3, 0.5, 0.64, 0.7, 1.0], [0.2, 0.2, 0.2, 0.2, 0.1, 0.05, 0.05]
    return rng.choice(levels, SHAPE, p=share).astype(np.float32)


def centre(row: int, column: int, origin=ORIGIN) -> tuple[float, float]:
    u, v = (column + 0.5) * RESOLUTION, (row + 0.5) * RESOLUTION
    c, s = math.cos(origin[2]), math.sin(origin[2])
    return origin[0] + c * u - s * v, origin[1] + s * u + c * v


def seen_by(p: np.ndarray, pose: np.ndarray) -> tuple[set, set]:
    """Amanatides and Woo along each beam in double precision: the cells that must be visible, and
    those that may be, where a cell is only grazed or entered at the very end of the range."""
    x, y, yaw = (float(v) for v in np.asarray(pose, np.float32))
    origin = [float(v) for v in np.asarray(ORIGIN, np.float32)]
    c, s = math.cos(origin[2]), math.sin(origin[2])
    dx, dy = x - origin[0], y - origin[1]
    start = [(c * dy - s * dx) / RESOLUTION, (c * dx + s * dy) / RESOLUTION]
    must: set[tuple[int, int]] = set()
    may: set[tuple[int, int]] = set()
    reach = LIDAR.max_range / RESOLUTION
    for beam in LIDAR.beam_angles.astype(float):
        angle = yaw - origin[2] + beam
        direction = [math.sin(angle), math.cos(angle)]
        cell, entry, is_sure = [math.floor(start[0]), math.floor(start[1])], 0.0, True
        while entry < reach + 1e-3 and all(0 <= cell[a] < SHAPE[a] for a in (0, 1)):
            is_wall = p[tuple(cell)] > 0.65
            if is_wall and entry == 0.0:
                break
            edge = [cell[a] + (direction[a] > 0) for a in (0, 1)]
            leave = [(edge[a] - start[a]) / direction[a] for a in (0, 1)]
            axis = int(leave[1] < leave[0])
            is_grazed = leave[axis] - entry < 1e-3
            may.add((cell[0], cell[1]))
            if is_sure and not is_grazed and entry < reach - 1e-3:
                must.add((cell[0], cell[1]))
            if is_wall and not is_grazed:
                break
            is_sure = is_sure and not is_wall
            entry = leave[axis]
            cell[axis] += 1 if direction[axis] > 0 else -1
    return must, may


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_visible_is_a_walk_along_each_beam(seed: int) -> None:
    p, rng = random_map(seed), np.random.default_rng(seed)
    grid = OccupancyGrid(p, RESOLUTION, ORIGIN)
    node = jnp.asarray(rng.uniform([-0.5, -0.5], [SHAPE[0] + 0.5, SHAPE[1] + 0.5]), jnp.float32)
    pose = np.array([*np.asarray(grid.frame.to_world(node)), rng.uniform(-7, 7)])
    found = visible_jit(grid, jnp.asarray(pose, jnp.float32))
    cells = {(int(r), int(c)) for r, c in np.argwhere(np.asarray(found))}
    must, may = seen_by(p, pose)
    assert must <= cells <= may
    assert len(may - must) <= 8


def test_a_wall_is_visible_and_nothing_behind_it() -> None:
    p = np.zeros(SHAPE, np.float32)
    p[:, 9] = 0.66
    grid = OccupancyGrid(p, RESOLUTION)
    found = np.asarray(visible_jit(grid, jnp.asarray([1.1, 1.7, 0.05])))
    assert found[:, 9].sum() >= 3
    assert not found[:, 10:].any()
    assert found[6, 4]  # where the pose is
    p[:, 9] = 0.65  # not known to be occupied
    found = np.asarray(visible_jit(OccupancyGrid(p, RESOLUTION), jnp.asarray([1.1, 1.7, 0.05])))
    assert found[:, 10:].any()


def test_a_cell_touched_at_its_corner_is_not_seen_and_hides_nothing() -> None:
    p = np.full(SHAPE, 0.5, np.float32)
    p[4, 5] = p[7, 6] = 1.0
    beam = Lidar(num_beams=1, max_range=1.5)
    middle = jnp.asarray([3.5 * RESOLUTION, 3.5 * RESOLUTION])
    look = jax.jit(lambda grid: visible(grid, middle, jnp.float32(math.pi / 4), beam))
    found = look(OccupancyGrid(p, RESOLUTION))
    assert np.argwhere(np.asarray(found)).tolist() == [[n, n] for n in range(3, 8)]


def test_nothing_is_visible_from_nowhere() -> None:
    p = np.full(SHAPE, 0.5, np.float32)
    p[4, 4] = 1.0
    grid = OccupancyGrid(p, RESOLUTION)
    nan, inf = math.nan, math.inf
    nowhere = [[-0.1, 1.0, 0.0], [1.0, 3.6, -1.6], [1.1, 1.1, 0.0], [nan, 1.0, 0.0]]
    nowhere += [[1.0, 1.0, nan], [1.0, inf, 0.0], [1.0, 1.0, -inf], [1e30, 0.0, 0.0]]
    for pose in nowhere:
        assert not np.asarray(visible_jit(grid, jnp.asarray(pose))).any()
    assert np.asarray(visible_jit(grid, jnp.asarray([1.6, 1.6, 0.0]))).any()


@given(
    st.floats(-1, 4, width=32),
    st.floats(-3, 1, width=32),
    st.floats(0.25, 4, width=32),
    st.floats(0.25, 4, width=32),
)
def test_zones_hold_the_cells_whose_centres_they_hold(
    x: float, y: float, width: float, height: float
) -> None:
    grid = OccupancyGrid(np.full(SHAPE, 0.5), RESOLUTION, ORIGIN)
    # The second one covers the map, whatever the first is.
    first, second = (x, y, x + width, y + height), (-20.0, -20.0, 20.0, 20.0)
    depth = np.empty(SHAPE)  # how far inside each centre is [m]
    for row in range(SHAPE[0]):
        for column in range(SHAPE[1]):
            u, v = centre(row, column)
            depth[row, column] = min(u - first[0], first[2] - u, v - first[1], first[3] - v)
    if depth.max() < 1e-5:
        return
    member = np.asarray(Zones.from_rectangles([first, second], grid).member)
    assert member[1].all()
    assert member[0][depth > 1e-5].all()
    assert not member[0][depth < -1e-5].any()


def test_zones_that_share_an_edge_share_no_cell() -> None:
    grid = OccupancyGrid(np.full((4, 6), 0.5), 1.0)
    # The edge at x = 2.5 goes through centres.
    zones = Zones.from_rectangles(np.array([[0, 0, 2.5, 4], [2.5, 0, 6, 4]]), grid)
    np.testing.assert_array_equal(zones.member.sum(axis=0), 1)
    np.testing.assert_array_equal(zones.num_cells, [8, 16])


RECTANGLES = [(-1.0, -1.0, 1.5, 1.0), (1.0, -1.0, 3.0, 2.0), (1.2, -2.0, 1.6, 0.5)]


def test_remaining_and_centres_are_means_over_cells() -> None:
    p = random_map(0)
    grid = OccupancyGrid(p, RESOLUTION, ORIGIN)
    zones = Zones.from_rectangles(RECTANGLES, grid)
    values, places = jax.jit(lambda z, g: (z.uncertainty(g), z.centres(g.frame)))(zones, grid)
    assert values.shape == (3,)
    assert places.shape == (3, 2)
    for z in range(3):
        cells = [
            (row, column)
            for row in range(SHAPE[0])
            for column in range(SHAPE[1])
            if zones.member[z, row, column]
        ]
        left = sum(4 * float(p[cell]) * (1 - float(p[cell])) for cell in cells) / len(cells)
        assert float(values[z]) == pytest.approx(left, rel=1e-5)
        mean = np.mean([centre(*cell) for cell in cells], axis=0)
        np.testing.assert_allclose(places[z], mean, atol=1e-5)


def test_remaining_is_one_for_unknown_and_zero_for_known() -> None:
    p = np.full(SHAPE, 0.5, np.float32)
    zones = Zones.from_rectangles(RECTANGLES, OccupancyGrid(p, RESOLUTION, ORIGIN))
    np.testing.assert_array_equal(zones.uncertainty(OccupancyGrid(p, RESOLUTION)), 1.0)
    known = np.where(np.arange(SHAPE[1]) % 2 == 0, 0.0, 1.0) * np.ones(SHAPE)
    np.testing.assert_array_equal(zones.uncertainty(OccupancyGrid(known, RESOLUTION)), 0.0)


@given(st.integers(0, 2**32 - 1), st.floats(0, 1, width=32))
@settings(max_examples=15)
def test_depletion_by_coverage(seed: int, rate: float) -> None:
    grid = OccupancyGrid(np.full(SHAPE, 0.5), RESOLUTION, ORIGIN)
    zones = Zones.from_rectangles(RECTANGLES, grid)
    rng = np.random.default_rng(seed)
    seen, levels = rng.random(SHAPE) < 0.4, rng.uniform(0, 2, 3)
    after = deplete_jit(
        zones, jnp.asarray(levels, jnp.float32), jnp.asarray(seen), jnp.float32(rate)
    )
    for z in range(3):
        member = np.asarray(zones.member[z])
        covered = (member & seen).sum() / member.sum()
        assert float(after[z]) == pytest.approx(levels[z] * (1 - rate * covered), rel=1e-5)


deplete_jit = jax.jit(lambda zones, levels, seen, rate: zones.deplete(levels, seen, rate))


def test_a_zone_behind_a_wall_is_not_depleted() -> None:
    p = np.full(SHAPE, 0.01, np.float32)
    p[:, 9] = 1.0
    walled = OccupancyGrid(p, RESOLUTION)
    p[:, 9] = 0.01
    opened = OccupancyGrid(p, RESOLUTION)
    # One zone in front of the wall, one behind it and within range.
    zones = Zones.from_rectangles([(1.25, 1.25, 2.0, 2.25), (2.5, 1.25, 3.0, 2.25)], walled)
    pose, levels = jnp.asarray([1.1, 1.7, 0.05]), jnp.ones(2)
    front, behind = deplete_jit(zones, levels, visible_jit(walled, pose), jnp.float32(0.5))
    assert 0.5 <= float(front) < 0.8
    assert float(behind) == 1.0
    assert float(deplete_jit(zones, levels, visible_jit(opened, pose), jnp.float32(0.5))[1]) < 0.9
    everything = jnp.ones(SHAPE, bool)
    np.testing.assert_allclose(zones.deplete(levels, everything, 1.0), 0.0, atol=1e-6)


def test_unknown_fraction() -> None:
    grid = OccupancyGrid(np.array([[0.5, 0.14, 0.15], [0.86, 0.85, 0.0]]), 1.0)
    assert float(unknown_fraction(grid)) == pytest.approx(3 / 6)
    assert float(unknown_fraction(grid, 0.9)) == pytest.approx(1 / 6)
    assert float(unknown_fraction(grid, jnp.float32(0.0))) == pytest.approx(5 / 6)


def test_proxy_bounds_the_entropy_in_bits_from_below() -> None:
    p = np.linspace(0, 1, 201)
    inner = p[1:-1]
    bits = -inner * np.log2(inner) - (1 - inner) * np.log2(1 - inner)
    found = np.asarray(entropy_proxy(jnp.asarray(p, jnp.float32)), float)
    assert (found[1:-1] <= bits + 1e-6).all()
    np.testing.assert_allclose(found[[0, 100, 200]], [0, 1, 0], atol=1e-6)


GRID = OccupancyGrid(np.full((4, 6), 0.5), 1.0)
GOOD = Zones.from_rectangles([[0.0, 0.0, 2.0, 2.0]], GRID)


@pytest.mark.parametrize(
    ("rectangles", "message"),
    [
        (np.zeros((0, 4)), r"rectangles has shape \(0, 4\)"),
        (np.array([0.0, 0.0, 1.0, 1.0]), r"rectangles has shape \(4,\)"),
        ([[0.0, 0.0, 1.0]], r"rectangles has shape \(1, 3\)"),
        ([[0.0, 0.0, 1.0, math.nan]], r"rectangles\[0\] is \[0.0, 0.0, 1.0, nan\]"),
        ([[-math.inf, 0.0, 1.0, 1.0]], r"rectangles\[0\] is \[-inf"),
        ([[0.0, 0.0, 1.0, 1.0], [2.0, 0.0, 2.0, 1.0]], r"rectangles\[1\] is \[2.0, 0.0, 2.0"),
        (np.array([["a", "b", "c", "d"]]), r"rectangles is array\(\[\['a'"),
        ([[0.0, 3.0, 1.0, 1.0]], r"rectangles\[0\] is \[0.0, 3.0"),
        (
            [[7.0, 0.0, 9.0, 1.0]],
            r"rectangles\[0\] is \[7.0, 0.0, 9.0, 1.0\]; accepted: a rec",
        ),
        (
            [[0.6, 0.0, 1.4, 1.0]],
            r"rectangles\[0\] is \[0.6, 0.0, 1.4, 1.0\]; accepted: a rec",
        ),
    ],
)
def test_bad_rectangles_are_named(rectangles, message: str) -> None:
    with pytest.raises(ValueError, match=message) as raised:
        Zones.from_rectangles(rectangles, GRID)
    assert "; accepted: " in str(raised.value)


def test_other_bad_input_is_named() -> None:
    other, seen = OccupancyGrid(np.zeros((4, 5)), 1.0), jnp.ones((4, 6), bool)
    cases = {
        r"grid has shape \(4, 5\)": lambda: GOOD.uncertainty(other),
        r"visible_cells has shape \(6, 4\)": lambda: GOOD.deplete(jnp.ones(1), seen.T, 0.5),
        "rate is 1.5": lambda: GOOD.deplete(jnp.ones(1), seen, 1.5),
        "rate is -0.5": lambda: GOOD.deplete(jnp.ones(1), seen, jnp.float32(-0.5)),
    }
    for message, call in cases.items():
        with pytest.raises(ValueError, match=f"{message}; accepted: "):
            call()
