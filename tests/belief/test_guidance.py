import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_dilation, distance_transform_edt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from jaxplore.belief.descent import descent, extend
from jaxplore.belief.guidance import descent_field as to_go
from jaxplore.belief.perception_checks import narrowest, safe_stride
from jaxplore.belief.roadmap import NARROW_PRICE, TurnsOnTheSpot, _relax, geodesic
from jaxplore.belief.tiles import Outline, Tiling, relax_by_tiles, relax_everywhere
from jaxplore.maps.clearance import clearance_field
from jaxplore.maps.frame import GridFrame

pytestmark = pytest.mark.long

geodesic_jit = jax.jit(geodesic)
OUTLINE = Outline((np.inf, np.inf), (1, 1))
TILING = Tiling()


def by_dijkstra(
    initial: np.ndarray,
    slowness: np.ndarray,
    is_open: np.ndarray,
    blocked: np.ndarray | None = None,
    corners: np.ndarray | None = None,
) -> np.ndarray:
    """Return the cost-to-go; both cells beside a diagonal step must not be `blocked`.

    `corners` are the corners after each node that a diagonal step may pass.
    """
    height, width = initial.shape
    blocked = np.zeros(initial.shape, bool) if blocked is None else blocked
    edges = []
    for row in range(height):
        for column in range(width):
            for down, right in ((0, 1), (1, 0), (1, 1), (1, -1)):
                r, c = row + down, column + right
                if not (r < height and 0 <= c < width and is_open[row, column] and is_open[r, c]):
                    continue
                if blocked[row, c] or blocked[r, column]:
                    continue
                if corners is not None and down and right and not corners[row, min(column, c)]:
                    continue
                length = np.hypot(down, right) * (slowness[row, column] + slowness[r, c]) / 2
                edges.append((row * width + column, r * width + c, length))
    hub = height * width
    for row, column in np.argwhere(np.isfinite(initial) & is_open):
        edges.append((hub, row * width + column, initial[row, column]))
    if not edges:
        return np.full(initial.shape, np.inf)
    i, j, length = np.array(edges).T
    graph = coo_matrix((length, (i.astype(int), j.astype(int))), shape=(hub + 1, hub + 1)).tocsr()
    reached = dijkstra(graph + cells_only(graph).T, directed=True, indices=hub)
    return reached[:hub].reshape(height, width)


def cells_only(graph):
    """Drop the hub's edges: a source is where paths begin, not a short cut."""
    edges = graph.tocoo()
    kept = edges.row < graph.shape[0] - 1
    return coo_matrix(
        (edges.data[kept], (edges.row[kept], edges.col[kept])), shape=graph.shape
    ).tocsr()


@given(st.integers(0, 2**32 - 1))
def test_equals_dijkstra(seed: int) -> None:
    rng = np.random.default_rng(seed)
    is_open = rng.random((17, 13)) > 0.3
    slowness = rng.uniform(0.1, 2.0, (17, 13)).astype(np.float32)
    initial = np.where(rng.random((17, 13)) < 0.03, rng.uniform(1, 9, (17, 13)), np.inf)
    found = geodesic_jit(initial.astype(np.float32), slowness, is_open)
    np.testing.assert_allclose(found, by_dijkstra(initial, slowness, is_open), rtol=1e-5)


SIZE = 20


def random_walls(rng: np.random.Generator) -> np.ndarray:
    """Return blocked cells: diagonal walls one cell thick, with gaps, among single cells."""
    blocked = rng.random((SIZE, SIZE)) < 0.05
    for _ in range(rng.integers(1, 5)):
        row, column, slope = rng.integers(0, SIZE), rng.integers(0, SIZE), rng.choice([-1, 1])
        for step in range(rng.integers(3, SIZE)):
            if row + step < SIZE and 0 <= column + slope * step < SIZE and rng.random() < 0.95:
                blocked[row + step, column + slope * step] = True
    return blocked


@jax.jit
def around_walls(blocked, required, slowness_factor, source, point):
    """Return the lattice, the lengths and the field of a robot that turns on the spot."""
    clearance = clearance_field(blocked, GridFrame(0.5), 3.0)
    roads = TurnsOnTheSpot().roadmap(clearance, required, 1, jnp.ones_like, slowness_factor)
    return roads, roads.lengths(source), roads.field(source), roads.sources_at(point)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.1, 0.25, 0.3, 0.45, 0.7]))
def test_no_diagonal_step_passes_a_wall(seed: int, required: float) -> None:
    rng = np.random.default_rng(seed)
    blocked = random_walls(rng)
    factor = rng.uniform(0.5, 2.0, blocked.shape).astype(np.float32)
    source = np.where(rng.random(blocked.shape) < 0.01, rng.uniform(1, 9, blocked.shape), np.inf)
    point = rng.uniform(0.0, 0.5 * SIZE, 2).astype(np.float32)
    roads, found, field, at_point = around_walls(
        blocked, np.float32(required), factor, source.astype(np.float32), point
    )
    room = (distance_transform_edt(np.pad(~blocked, 1))[1:-1, 1:-1] - 0.5) * 0.5
    is_open = room >= required - 1e-4
    np.testing.assert_array_equal(roads.is_open, is_open)
    expected = by_dijkstra(source, 0.5 * factor, is_open, blocked)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    # The descent at a node leads to lower nodes to which a step leads.
    down = np.asarray(field.descent)  # (x, y)
    for row, column in np.argwhere(np.isfinite(expected)):
        steps = [
            (r, c)
            for r, c in itertools.product((-1, 0, 1), repeat=2)
            if (r, c) != (0, 0)
            and 0 <= row + r < SIZE
            and 0 <= column + c < SIZE
            and expected[row + r, column + c] < expected[row, column]
            and not (blocked[row + r, column] or blocked[row, column + c])
        ]
        x, y = down[:, row, column]
        if not steps:
            assert (x, y) == (0.0, 0.0)
        else:
            assert max(r * y + c * x for r, c in steps) >= -1e-5
    # A point in an open cell has no source on the other side of a wall.
    column, row = np.floor(point / 0.5).astype(int)
    if is_open[row, column]:
        at_cell = np.full(blocked.shape, np.inf)
        at_cell[row, column] = 1.0
        reached = by_dijkstra(at_cell, np.ones(blocked.shape), is_open, blocked)
        sources = np.isfinite(at_point)
        assert sources[row, column]
        assert np.isfinite(reached[sources]).all()


@pytest.mark.parametrize("turn", range(4))
def test_a_descent_goes_around_a_diagonal_wall(turn: int) -> None:
    blocked = np.zeros((SIZE, SIZE), bool)
    blocked[range(SIZE - 4), range(SIZE - 4)] = True
    ends = np.array([[5.5, 8.5], [8.5, 5.5]])  # row, column, on the two sides of the wall
    for _ in range(turn):
        blocked = np.rot90(blocked).copy()
        ends = np.stack([SIZE - ends[:, 1], ends[:, 0]], axis=1)
    (row, column), (to_row, to_column) = ends
    source = np.full(blocked.shape, np.inf, np.float32)
    source[int(to_row), int(to_column)] = 0.0
    _, found, field, _ = around_walls(
        blocked,
        np.float32(0.25),
        np.ones(blocked.shape, np.float32),
        source,
        np.zeros(2, np.float32),
    )
    assert found[int(row), int(column)] > 8.0  # around the end, and not 2.1 m through the wall
    # Straight through the wall the cost rises first.
    way = np.linspace((row, column), (to_row, to_column), 41)
    values = np.asarray(jax.vmap(field)(jnp.asarray(0.5 * way[:, ::-1], jnp.float32)))
    assert np.diff(values[:21]).max() > 0.1
    # The steepest descent of the lattice reaches the source, and passes no corner of the wall.
    place, value = (int(row), int(column)), np.asarray(found)
    for _ in range(200):
        steps = [
            (place[0] + r, place[1] + c)
            for r, c in itertools.product((-1, 0, 1), repeat=2)
            if 0 <= place[0] + r < SIZE
            and 0 <= place[1] + c < SIZE
            and not (blocked[place[0] + r, place[1]] or blocked[place[0], place[1] + c])
        ]
        place = min(steps, key=lambda cell: value[cell])
        if value[place] == 0.0:
            break
    assert place == (int(to_row), int(to_column))


@pytest.mark.parametrize("seed", range(3))
def test_tiles_and_the_whole_map_at_once_are_the_same_to_the_bit(seed: int) -> None:
    rng = np.random.default_rng(seed)
    shape = (2 * TILING.side + 5, 3 * TILING.side - 1)
    is_open = rng.random(shape) > 0.35  # ways wind through several tiles and back
    slowness = rng.uniform(0.1, 2.0, shape).astype(np.float32)
    initial = np.where(rng.random(shape) < 0.002, rng.uniform(-9, 9, shape), np.inf)
    start = np.where(is_open, initial, np.inf).astype(np.float32)
    half = np.where(is_open, 0.5 * slowness, np.inf).astype(np.float32)
    tiles, whole = (
        np.asarray(
            jax.jit(lambda *each, find=find: find(each, OUTLINE, _relax, TILING))(start, half)
        )
        for find in (relax_by_tiles, relax_everywhere)
    )
    np.testing.assert_array_equal(tiles, whole)
    least = initial[np.isfinite(initial)].min()  # Dijkstra's lengths are not negative
    expected = by_dijkstra(initial - least, slowness, is_open) + least
    np.testing.assert_allclose(tiles, expected, rtol=1e-4, atol=1e-4)
    assert np.isfinite(tiles).mean() > 0.3


@pytest.mark.parametrize("source", [(23, 23), (23, 24), (24, 23), (24, 24), (23, 10), (30, 24)])
def test_a_source_at_the_edge_of_a_tile_is_left_into_the_next(source: tuple[int, int]) -> None:
    # Nothing else of the source's own tile is open: its first step leads into another one.
    assert TILING.side == 24
    is_open = np.ones((50, 50), bool)
    top, left = (24 * (each // 24) for each in source)
    is_open[top : top + 24, left : left + 24] = False
    is_open[source] = True
    initial = np.full((50, 50), np.inf, np.float32)
    initial[source] = 0.5
    slowness = np.ones((50, 50), np.float32)
    found = geodesic_jit(initial, slowness, is_open)
    expected = by_dijkstra(initial, slowness, is_open)
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert np.isfinite(expected).sum() > 1000


def test_descends_around_a_u_shaped_wall() -> None:
    is_open = np.ones((30, 30), bool)
    is_open[8:22, 20] = is_open[8, 8:21] = is_open[21, 8:21] = False
    initial = np.full((30, 30), np.inf, np.float32)
    initial[15, 27] = 0.0
    value = np.asarray(geodesic_jit(initial, np.ones((30, 30), np.float32), is_open))
    row, column, path = 15, 15, [(15, 15)]
    while (row, column) != (15, 27):
        around = [(row + i, column + j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        row, column = min(around, key=lambda cell: value[cell])
        assert is_open[row, column]
        assert (row, column) not in path
        path.append((row, column))
    assert min(c for _, c in path) < 8  # out of the U first


def test_without_sources_everything_is_flat_and_finite() -> None:
    nothing = jnp.full((6, 6), jnp.inf)
    value = geodesic_jit(nothing, jnp.ones((6, 6)), jnp.ones((6, 6), bool))
    assert not np.isfinite(value).any()
    np.testing.assert_array_equal(extend(value, 3, jnp.float32(1.0)), 0.0)


def test_extension_makes_a_ridge_of_an_obstacle_and_leaves_the_rest() -> None:
    value = jnp.asarray([[1.0, 2.0, jnp.inf, jnp.inf, jnp.inf, jnp.inf, 9.0]])
    found = extend(value, 2, jnp.float32(0.5))
    # Two layers from the left, two from the right.
    np.testing.assert_allclose(found[0], [1.0, 2.0, 2.5, 3.0, 10.0, 9.5, 9.0])
    far = extend(jnp.asarray([[1.0, jnp.inf, jnp.inf, jnp.inf]]), 2, jnp.float32(0.5))
    np.testing.assert_allclose(far[0], [1.0, 1.5, 2.0, 2.0])
    thin = extend(jnp.asarray([[-4.0, jnp.inf, -12.0]]), 2, jnp.float32(0.5))
    np.testing.assert_allclose(thin[0], [-4.0, -3.5, -12.0])


@pytest.mark.parametrize("turn", range(4))
def test_a_field_falls_all_the_way_through_a_diagonal_gap(turn: int) -> None:
    # Two rooms that touch at a corner, as a doorway between posts looks on a lattice.
    is_open = np.zeros((12, 12), bool)
    is_open[1:6, 1:6] = is_open[6:11, 6:11] = True
    initial = np.full((12, 12), np.inf, np.float32)
    initial[9, 9] = 0.0
    way = np.linspace((2.5, 2.5), (9.5, 9.5), 57)  # row, column
    for _ in range(turn):
        is_open, initial = np.rot90(is_open).copy(), np.rot90(initial).copy()
        way = np.stack([12.0 - way[:, 1], way[:, 0]], axis=1)
    distance = geodesic_jit(initial, np.ones((12, 12), np.float32), is_open)
    field = to_go(distance, GridFrame(1.0), 4)
    values = np.asarray(jax.vmap(field)(jnp.asarray(way[:, ::-1], jnp.float32)))
    assert values[0] > 9.0
    assert np.diff(values).max() < 0.0


downhill = jax.jit(descent, static_argnums=1)


@given(st.floats(0, 6.28))
def test_descent_is_the_gradient_s_direction(angle: float) -> None:
    rows, columns = np.mgrid[:9, :9].astype(np.float32)
    falls = np.array([math.sin(angle), math.cos(angle)])
    value = jnp.asarray(-falls[0] * rows - falls[1] * columns, jnp.float32)
    found = np.asarray(downhill(value, 2))[:, 1:-1, 1:-1]
    np.testing.assert_allclose((found**2).sum(axis=0), 1.0, rtol=1e-4)
    # 8 neighbours: within a few degrees of the true direction.
    assert np.einsum("c,cij->ij", falls, found).min() > math.cos(math.radians(6))


def test_descent_is_zero_at_a_minimum_and_continued_into_what_is_closed() -> None:
    value = jnp.asarray([[2.0, 1.0, 0.0, 1.0, jnp.inf, jnp.inf, jnp.inf]])
    found = np.asarray(downhill(value, 2))
    np.testing.assert_array_equal(found[0], 0.0)
    np.testing.assert_allclose(found[1, 0], [1, 1, 0, -1, -1, -1, 0], atol=1e-6)
    assert np.isfinite(np.asarray(downhill(jnp.full((3, 3), jnp.inf), 2))).all()


@given(
    wanted=st.floats(1e-3, 10.0),
    resolution=st.floats(1e-3, 1.0),
    radius=st.floats(0.01, 3.0),
    margin=st.floats(0.0, 0.5),
)
def test_the_stride_is_the_largest_one_that_is_safe(wanted, resolution, radius, margin) -> None:
    """By counting down from the wanted one."""
    nearest = (radius + margin) / resolution + 0.5
    apart = 2.0 * math.sqrt(max(0.0, nearest**2 - 0.5)) - 1e-6
    apart = min(2.0 * radius / resolution + 1.0, apart)
    expected = max(1, round(wanted / resolution))
    while expected > 1 and math.sqrt(2.0) * (2 * expected - 1) >= apart:
        expected -= 1
    assert safe_stride(wanted, resolution, radius, radius + margin) == expected


def test_the_stride_of_tiny_cells_is_found_at_once() -> None:
    assert safe_stride(0.2, 1e-12, 0.2) == pytest.approx(1.4e11, rel=0.02)


@given(st.floats(0, math.pi), st.floats(-1, 1), st.sampled_from([0.05, 0.1]), st.floats(0.15, 0.5))
def test_no_path_jumps_a_wall(
    angle: float, offset: float, resolution: float, radius: float
) -> None:
    """Blocks that touch never lie on two sides of a wall one cell thick."""
    stride = safe_stride(10 * resolution, resolution, radius)
    size = 48 // stride * stride
    rows, columns = np.mgrid[:size, :size] - size / 2
    across = rows * math.sin(angle) + columns * math.cos(angle) - offset
    wall = np.abs(across) < 0.75
    fits = (distance_transform_edt(~wall) - 0.5) * resolution >= radius

    def blocks(cells: np.ndarray) -> np.ndarray:
        return cells.reshape(size // stride, stride, size // stride, stride).any(axis=(1, 3))

    left, right = blocks(fits & (across > 0)), blocks(fits & (across < 0))
    assert not (binary_dilation(left, np.ones((3, 3))) & right).any()


@given(
    st.floats(0, math.pi),
    st.floats(-1, 1),
    st.sampled_from([0.05, 0.1, 0.5]),
    st.floats(0.1, 0.6),
)
def test_no_block_is_beside_one_on_the_other_side_of_a_thin_wall(
    angle: float, offset: float, resolution: float, radius: float
) -> None:
    """The same for walls whose cells touch at corners; steps between cells have `clear_corners`."""
    stride = safe_stride(10 * resolution, resolution, radius)
    if stride == 1:
        return
    size = 48 // stride * stride
    rows, columns = np.mgrid[:size, :size] - size / 2
    across = rows * math.sin(angle) + columns * math.cos(angle) - offset
    # One cell in each row, or in each column: the line of Bresenham.
    steep = max(abs(math.sin(angle)), abs(math.cos(angle)))
    wall = np.abs(across) <= 0.5 * steep
    fits = (distance_transform_edt(~wall) - 0.5) * resolution >= radius - 1e-9

    def blocks(cells: np.ndarray) -> np.ndarray:
        return cells.reshape(size // stride, stride, size // stride, stride).any(axis=(1, 3))

    left, right = blocks(fits & (across > 0)), blocks(fits & (across < 0))
    assert not (binary_dilation(left, np.ones((3, 3))) & right).any()


@given(
    st.one_of(st.sampled_from([math.pi / 4, 3 * math.pi / 4]), st.floats(0, math.pi)),
    st.one_of(st.sampled_from([0.0, math.sqrt(0.125), math.sqrt(0.5)]), st.floats(-4, 4)),
    st.integers(2, 6),
    st.booleans(),
    st.floats(0.0, 1.0),
    st.booleans(),
)
def test_no_narrow_block_is_beside_one_on_the_other_side_of_a_wall(
    angle: float, offset: float, stride: int, is_thick: bool, more: float, has_corners: bool
) -> None:
    """With free cells at the corner of a diagonal step, a smaller clearance is safe."""
    size = 8 * stride
    rows, columns = np.mgrid[:size, :size] + 0.5 - size / 2
    across = rows * math.sin(angle) + columns * math.cos(angle) - offset
    steep = max(abs(math.sin(angle)), abs(math.cos(angle)))
    wall = np.abs(across) <= (0.75 if is_thick else 0.5 * steep + 1e-9)
    least = narrowest(stride, 1.0, has_corners=has_corners)
    fits = distance_transform_edt(~wall) - 0.5 >= least + more - 1e-4

    def blocks(cells: np.ndarray) -> np.ndarray:
        return cells.reshape(8, stride, 8, stride).any(axis=(1, 3))

    left, right = blocks(fits & (across > 0)), blocks(fits & (across < 0))
    for row, column in np.argwhere(left):
        for down, over in itertools.product((-1, 0, 1), repeat=2):
            r, c = row + down, column + over
            if 0 <= r < 8 and 0 <= c < 8 and right[r, c]:
                # Only a diagonal step may lead there, and a cell at its corner is in the wall.
                assert has_corners
                assert down
                assert over
                y, x = max(row, r) * stride, max(column, c) * stride
                assert wall[y - 1 : y + 1, x - 1 : x + 1].any()


@jax.jit
def narrow_roads(blocked, source):
    """Return the lattice of a robot that takes narrow passages, its lengths and its fields."""
    clearance = clearance_field(blocked, GridFrame(0.1), 2.0)
    required = jnp.float32(WIDE)
    roads = TurnsOnTheSpot(jnp.float32(NARROW)).roadmap(clearance, required, 2)
    wide = TurnsOnTheSpot().roadmap(clearance, required, 2)
    return roads, roads.lengths(source), roads.field(source), wide.field(source)


WIDE, NARROW = 0.25, 0.15


def beside_bottleneck(cells: np.ndarray) -> np.ndarray:
    """Return the blocks of 2 x 2 cells that have cells, and beside, above or below them a block
    with cells, of which none touches one of theirs."""
    found = np.zeros((12, 12), bool)
    for row, column in itertools.product(range(12), repeat=2):
        own = [(2 * row + i, 2 * column + j) for i in (0, 1) for j in (0, 1)]
        own = [each for each in own if cells[each]]
        for down, right in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            r, c = row + down, column + right
            if not (0 <= r < 12 and 0 <= c < 12 and own):
                continue
            others = [(2 * r + i, 2 * c + j) for i in (0, 1) for j in (0, 1)]
            others = [each for each in others if cells[each]]
            gaps = [max(abs(a - p), abs(b - q)) for a, b in own for p, q in others]
            found[row, column] |= bool(gaps) and min(gaps) > 1
    return found


@given(st.integers(0, 2**32 - 1))
def test_narrow_passages_cost_more_and_no_path_ends_in_them(seed: int) -> None:
    rng = np.random.default_rng(seed)
    size = 24
    blocked = rng.random((size, size)) < 0.02
    for _ in range(2):
        line, first, last = rng.integers(0, size), *np.sort(rng.integers(0, size, 2))
        blocked[line, first:last] = True
        blocked[first:last, rng.integers(0, size)] = True
    source = np.where(rng.random((12, 12)) < 0.05, rng.uniform(1, 9, (12, 12)), np.inf)
    roads, found, *_ = narrow_roads(blocked, source.astype(np.float32))
    room = (distance_transform_edt(np.pad(~blocked, 1))[1:-1, 1:-1] - 0.5) * 0.1
    cells = room >= NARROW - 1e-4
    room = np.minimum(room, 2.0).reshape(12, 2, 12, 2).max(axis=(1, 3))
    is_open = room >= WIDE - 1e-4
    fits = is_open | ((room >= NARROW - 1e-4) & ~beside_bottleneck(cells))
    tight = np.clip(1.0 - (room - WIDE) / WIDE / 2.0, 0.0, 1.0)
    slowness = 0.2 * np.where(is_open, 1.0 + tight, NARROW_PRICE)
    corners = np.zeros((12, 12), bool)
    for row, column in itertools.product(range(11), repeat=2):
        (a, b), (c, d) = cells[2 * row + 1 : 2 * row + 3, 2 * column + 1 : 2 * column + 3]
        is_wide = (is_open | ~fits)[row : row + 2, column : column + 2].all()
        corners[row, column] = is_wide or (a and d) or (b and c)
    expected = by_dijkstra(np.where(is_open, source, np.inf), slowness, fits, corners=corners)
    np.testing.assert_array_equal(roads.is_narrow, fits & ~is_open)
    np.testing.assert_allclose(found, expected, rtol=1e-4)


@jax.jit
def descended(field, place):
    """Return where 400 steps downhill end, and the costs on the way."""

    def step(at, _):
        return at + 0.05 * field.direction(at), field(at)

    end, costs = jax.lax.scan(step, place, None, 401)
    return end, costs


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("length", [2, 12])
def test_a_field_falls_through_a_narrow_passage_and_is_else_as_without(turn, length) -> None:
    # Two rooms, a passage four cells wide between them, and a source in the second room.
    blocked = np.zeros((48, 48), bool)
    blocked[:, 20 : 20 + length] = True
    blocked[22:26, :] = False
    source = np.full((24, 24), np.inf, np.float32)
    source[4, 20] = 0.0
    blocked, source = np.rot90(blocked, turn), np.rot90(source, turn)
    _, lengths, field, wide = narrow_roads(blocked, source)
    start = np.rot90(np.eye(1, 576, 18 * 24 + 3).reshape(24, 24), turn)
    (node,) = np.argwhere(start)
    assert np.isfinite(lengths[tuple(node)])
    place = (node[::-1] + 0.5) * 0.2
    place, costs = descended(field, place.astype(np.float32))
    target = (np.argwhere(source == 0.0)[0][::-1] + 0.5) * 0.2
    assert np.hypot(*(place - target)) < 0.15
    assert np.diff(costs).max() < 0.3
    # In the room with the source nothing has changed, its walls included.
    far = np.rot90(np.arange(24)[None, :] >= (20 + length) // 2 + 4, turn) & np.ones((24, 24), bool)
    np.testing.assert_allclose(field.values[far], wide.values[far], rtol=1e-5)
    np.testing.assert_allclose(field.descent[:, far], wide.descent[:, far], atol=1e-5)


@jax.jit
def roads_from(blocked, source, start):
    """Return the lattice of a robot, its field from a start, and that without one."""
    clearance = clearance_field(blocked, GridFrame(0.1), 2.0)
    roads = TurnsOnTheSpot(jnp.float32(NARROW)).roadmap(clearance, jnp.float32(WIDE), 2)
    return roads, roads.field(source, start), roads.field(source)


@pytest.mark.parametrize("turn", range(4))
def test_the_passage_that_the_robot_is_in_is_not_closed(turn: int) -> None:
    # Two rooms with a source each, and a passage between them. From its middle it is as far to the
    # one as to the other, so no path from a room leads through it.
    blocked = np.zeros((48, 48), bool)
    blocked[:, 18:30] = True
    blocked[22:26, :] = False
    source = np.full((24, 24), np.inf, np.float32)
    source[12, 3] = source[12, 20] = 0.0
    inside = np.zeros((24, 24), bool)
    inside[11, 11] = True
    blocked, source, inside = (np.rot90(each, turn) for each in (blocked, source, inside))
    (node,) = np.argwhere(inside)
    point = jnp.asarray((node[::-1] + 0.5) * 0.2, jnp.float32)
    roads, field, without = roads_from(blocked, source, point)
    assert roads.is_narrow[tuple(node)]
    lengths = np.asarray(roads.lengths(jnp.asarray(source)))
    # Its value is its cost-to-go, and a ridge where nothing says that the robot is there.
    assert field.values[tuple(node)] == lengths[tuple(node)]
    assert without.values[tuple(node)] != lengths[tuple(node)]
    # An open node as the start changes nothing.
    place = jnp.asarray((np.argwhere(source == 0.0)[0][::-1] + 0.5) * 0.2, jnp.float32)
    _, outside, _ = roads_from(blocked, source, place)
    np.testing.assert_array_equal(outside.values, without.values)


@pytest.mark.parametrize("turn", range(4))
def test_no_path_leads_through_a_bottleneck_between_two_nodes(turn: int) -> None:
    # A passage three cells wide that is shifted by a cell at the common edge of two blocks: each of
    # them has a cell in which the robot fits, and between these cells it does not.
    source = np.full((24, 24), np.inf, np.float32)
    source[11, 3] = 0.0
    far = np.zeros((24, 24), bool)
    far[11, 20] = True
    for shift in (0, 1):
        cells = np.zeros((48, 48), bool)
        cells[:, 16:34] = True
        cells[21:24, 16:24] = cells[21 + shift : 24 + shift, 24:34] = False
        room = (distance_transform_edt(~cells) - 0.5) * 0.1
        fits = (room >= NARROW - 1e-4)[:, 16:34]
        assert fits.reshape(24, 2, 9, 2).any(axis=(1, 3))[11].all()
        given, ends, node = (np.rot90(each, turn) for each in (cells, source, far))
        roads, *_ = roads_from(given, ends, jnp.zeros(2))
        assert np.isfinite(np.asarray(roads.lengths(jnp.asarray(ends)))[node][0]) == (shift == 0)


def test_a_diagonal_wall_bounds_the_stride() -> None:
    # Cells (0, 0) and (3, 3) are 1.736 cells from the faces of the wall r + c = 3 between them.
    assert safe_stride(0.2, 0.1, 0.1736) == 1
    assert safe_stride(0.2, 0.1, 0.18) == 2


@pytest.mark.parametrize(("spacing", "expected"), [(0.05, 1), (0.1, 1), (0.2, 2), (5.0, 2)])
def test_stride_is_bounded_by_the_robot(spacing: float, expected: int) -> None:
    assert safe_stride(spacing, 0.1, 0.2) == expected
