import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import label

from jaxplore import Lidar, OccupancyGrid, PoseInformation
from jaxplore.information import LocalFieldSensor
from jaxplore.maps import ScalarField
from jaxplore.maps.frame import GridFrame
from jaxplore.planning import GradientReference

pytestmark = pytest.mark.long

SHAPE, RESOLUTION = (24, 30), 0.1  # 2.4 m x 3 m
STRAIGHT = (0.0, 0.0, 0.0)
FRAMES = [STRAIGHT, (1.0, -2.0, 0.7), (-0.5, 0.3, -2.4)]
ROWS, COLUMNS = np.meshgrid(np.arange(SHAPE[0]), np.arange(SHAPE[1]), indexing="ij")
FREE = np.full(SHAPE, 0.1)
NAN = math.nan

climb_jit = eqx.filter_jit(lambda reference, *given: reference(*given))
values_jit = eqx.filter_jit(lambda field, positions: jax.vmap(field)(positions))


def field_of(
    values: np.ndarray | float, frame: tuple[float, float, float] = STRAIGHT
) -> ScalarField:
    values = jnp.asarray(np.broadcast_to(values, SHAPE), jnp.float32)
    return ScalarField(values, GridFrame(RESOLUTION, frame), jnp.zeros(()))


def bump(row: float, column: float, width: float = 6.0) -> np.ndarray:
    """Return a hill with its top at grid coordinates."""
    square = (ROWS + 0.5 - row) ** 2 + (COLUMNS + 0.5 - column) ** 2
    return 3.0 * np.exp(-0.5 * square / width**2)


def climb(
    field: ScalarField,
    grid: OccupancyGrid,
    start,
    speed: float = 2.0,
    dt: float = 0.05,
    num_steps: int = 40,
) -> np.ndarray:
    """Return start and path, in the world."""
    start = jnp.asarray(start, jnp.float32)
    path = climb_jit(GradientReference(speed, num_steps, dt), field, grid, start)
    assert path.shape == (num_steps, 3)
    assert path.dtype == jnp.float32
    return np.concatenate([start[None], path])


def at(frame: tuple[float, float, float], row: float, column: float, z: float = 1.5) -> np.ndarray:
    """Return a start from grid coordinates."""
    return np.append(
        GridFrame(RESOLUTION, frame).to_world(jnp.asarray([row, column], jnp.float32)), z
    )


def in_grid(frame: tuple[float, float, float], path: np.ndarray) -> np.ndarray:
    return np.asarray(GridFrame(RESOLUTION, frame).to_grid(jnp.asarray(path[:, :2])))


def rooms(grid: OccupancyGrid, path: np.ndarray) -> np.ndarray:
    """Return which room each position is in, 0 in a wall or off the map.

    Rooms are cells that touch with a side: nobody squeezes through between two corners.
    """
    number, _ = label(np.asarray(grid.probability) <= 0.65)
    cells = np.asarray(grid.frame.to_cell(jnp.asarray(path[:, :2])))
    on_map = ((cells >= 0) & (cells < grid.shape)).all(axis=1)
    inside = np.where(on_map[:, None], cells, 0)
    return np.where(on_map, number[inside[:, 0], inside[:, 1]], 0)


def test_is_forty_positions_by_default() -> None:
    field, grid = field_of(COLUMNS), OccupancyGrid(FREE, RESOLUTION)
    path = climb_jit(GradientReference(), field, grid, jnp.asarray([0.5, 1.0, -7.0]))
    assert path.shape == (40, 3)
    np.testing.assert_allclose(path[0], [0.6, 1.0, -7.0], atol=1e-5)


@pytest.mark.parametrize(("speed", "steps"), [(0.2, 40), (0.6, 40), (2.6, 10)])
@pytest.mark.parametrize("frame", FRAMES)
def test_goes_straight_up_a_ramp_at_its_speed(frame, speed: float, steps: int) -> None:
    slope = np.asarray([2.0, -1.0])  # per row and per column
    field = field_of(slope[0] * ROWS + slope[1] * COLUMNS, frame)
    path = climb(field, OccupancyGrid(FREE, RESOLUTION, frame), at(frame, 4.0, 25.0), speed)
    ahead = math.atan2(slope[0], slope[1]) + frame[2]
    direction = [math.cos(ahead), math.sin(ahead), 0.0]
    moves = np.diff(path, axis=0)[:steps]
    np.testing.assert_allclose(moves, np.tile(direction, (steps, 1)) * speed * 0.05, atol=1e-5)
    np.testing.assert_array_equal(path[:, 2], 1.5)


@pytest.mark.parametrize("turn", [0.0, 0.7, 2.5])
def test_map_and_field_need_not_be_aligned(turn: float) -> None:
    """The field's axes say where up is, the map's where the walls are."""
    frame = (1.5, 1.2, turn)
    path = climb(field_of(COLUMNS, frame), OccupancyGrid(FREE, RESOLUTION), at(frame, 3, 3), 0.4)
    expected = 0.02 * np.asarray([math.cos(turn), math.sin(turn), 0.0])
    np.testing.assert_allclose(np.diff(path, axis=0)[:20], np.tile(expected, (20, 1)), atol=1e-5)


@pytest.mark.parametrize(
    "values", [0.0, 3.0, -1e4, 1e3 + 1e-3 * COLUMNS], ids=["0", "3", "-1e4", "rounding"]
)
def test_stands_still_where_it_is_flat(values) -> None:
    path = climb(field_of(values), OccupancyGrid(FREE, RESOLUTION), [1.0, 1.0, 1.0])
    np.testing.assert_array_equal(path, np.ones((41, 3)))


@given(st.integers(0, 2**32 - 1), st.sampled_from(FRAMES), st.sampled_from([0.3, 1.0, 2.0, 20.0]))
@settings(max_examples=40)
def test_climbs_a_hill_and_stays_on_top(seed: int, frame, speed: float) -> None:
    rng = np.random.default_rng(seed)
    top = rng.uniform([4, 4], [20, 26])
    field = field_of(bump(*top), frame)
    start = rng.uniform([2, 2], [22, 28])
    path = climb(field, OccupancyGrid(FREE, RESOLUTION, frame), at(frame, *start), speed)
    heights = np.asarray(values_jit(field, jnp.asarray(path[:, :2])))
    assert (np.diff(heights) >= 0.0).all()
    away = RESOLUTION * np.linalg.norm(in_grid(frame, path) - top, axis=1)
    length = speed * 0.05
    piece = length / max(1, math.ceil(length / (0.5 * RESOLUTION)))
    # At speed all the way up: at most a piece is lost at the top.
    on_top = np.arange(41) * length >= away[0] + piece
    # The top between nodes is lower than the hill's, and up to half a cell beside it.
    assert (away[on_top] <= piece + 0.5 * RESOLUTION).all()
    before = np.arange(41) * length < away[0] - 2 * piece
    np.testing.assert_allclose(
        away[before], away[0] - np.flatnonzero(before) * length, atol=0.03, rtol=0.1
    )
    np.testing.assert_allclose(path[:, 2], 1.5)


def test_a_top_between_two_steps_is_held() -> None:
    field, grid = field_of(bump(12.0, 15.0)), OccupancyGrid(FREE, RESOLUTION)
    path = climb(field, grid, [0.6, 1.2, 0.0], 1.7)
    np.testing.assert_array_equal(path[-10:], np.tile(path[-1], (10, 1)))


def test_stands_still_on_top_though_a_step_leads_as_high_on_the_other_side() -> None:
    """Powers of two, in which nothing is rounded."""
    values = 8.0 - np.abs(np.arange(17.0) - 8.0)
    field = ScalarField(
        jnp.asarray(np.tile(values, (17, 1)), jnp.float32), GridFrame(1.0), jnp.zeros(())
    )
    reference = GradientReference(0.25, 4, 1.0)
    grid = OccupancyGrid(np.zeros((17, 17)), 1.0)
    path = climb_jit(reference, field, grid, jnp.asarray([8.375, 8.5, 0.0]))
    np.testing.assert_array_equal(path[1:], path[:-1])


def gradient_by_definition(values: np.ndarray, row: float, column: float) -> tuple[float, float]:
    """Return the interpolated central differences inside a lattice, per row and per column."""
    i, j = math.floor(row - 0.5), math.floor(column - 0.5)
    v, u = row - 0.5 - i, column - 0.5 - j
    total = np.zeros(2)
    for a, b, weight in (
        (i, j, (1 - v) * (1 - u)),
        (i, j + 1, (1 - v) * u),
        (i + 1, j, v * (1 - u)),
        (i + 1, j + 1, v * u),
    ):
        down = 0.5 * (values[a + 1, b] - values[a - 1, b])
        right = 0.5 * (values[a, b + 1] - values[a, b - 1])
        total += weight * np.asarray([down, right])
    return float(total[0]), float(total[1])


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(("speed", "pieces"), [(0.4, 1), (1.7, 2)])
def test_is_the_integral_of_the_normalised_gradient(frame, speed: float, pieces: int) -> None:
    """A curved way up: two hills and a saddle."""
    values = bump(17.0, 24.0, 7.0) + 0.8 * bump(6.0, 16.0, 4.0)
    start = at(frame, 9.0, 5.0)
    path = climb(field_of(values, frame), OccupancyGrid(FREE, RESOLUTION, frame), start, speed)
    steps = 40 if pieces == 1 else 12
    row, column = 9.0, 5.0
    expected = [(row, column)]
    for _ in range(steps):
        for _ in range(pieces):
            down, right = gradient_by_definition(values, row, column)
            length = speed * 0.05 / RESOLUTION / pieces / math.hypot(down, right)
            row, column = row + length * down, column + length * right
        expected.append((row, column))
    np.testing.assert_allclose(in_grid(frame, path)[: steps + 1], expected, atol=1e-3)
    assert np.ptp(np.arctan2(*np.diff(expected, axis=0).T)) > 0.2


@pytest.mark.parametrize("speed", [0.5, 2.0, 20.0])
@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(
    "beyond", [(12.0, 36.0), (-6.0, 15.0), (28.0, -4.0)], ids=["right", "below", "corner"]
)
def test_stays_on_the_map_below_a_hill_beyond_its_border(beyond, frame, speed: float) -> None:
    grid = OccupancyGrid(FREE, RESOLUTION, frame)
    path = climb(field_of(bump(*beyond, width=12.0), frame), grid, at(frame, 12.0, 15.0), speed)
    assert (rooms(grid, path) > 0).all()
    if speed > 1.0:
        # As far as it gets: within a step of the border.
        margin = np.asarray([*in_grid(frame, path)[-1], *(SHAPE - in_grid(frame, path)[-1])])
        assert margin.min() < 0.8


def test_stays_on_the_map_where_the_field_goes_on() -> None:
    grid = OccupancyGrid(FREE, RESOLUTION)
    field = field_of(bump(8.0, 26.0), (1.0, 0.4, 0.0))  # its top at (3.6, 1.2): the map ends at 3
    path = climb(field, grid, [1.5, 1.0, 0.0])
    assert (rooms(grid, path) > 0).all()
    assert 2.9 < path[-1, 0] < 3.0
    assert path[-1, 1] == pytest.approx(1.2, abs=0.06)


def test_stands_still_off_the_field() -> None:
    field = field_of(COLUMNS, (1.0, 0.4, 0.0))
    path = climb(field, OccupancyGrid(FREE, RESOLUTION), [0.6, 1.0, 0.0])
    np.testing.assert_array_equal(path, np.tile(path[0], (41, 1)))


def straight_wall() -> np.ndarray:
    p = FREE.copy()
    p[:, 16] = 0.9
    return p


def diagonal_wall() -> np.ndarray:
    """Cells that touch with their corners only."""
    p = FREE.copy()
    for row in range(SHAPE[0]):
        p[row, 28 - row] = 0.9
    return p


@pytest.mark.parametrize("speed", [0.7, 2.0, 20.0])
@pytest.mark.parametrize(
    ("wall", "frame"),
    [
        (straight_wall(), FRAMES[0]),
        (straight_wall(), FRAMES[1]),
        (straight_wall(), FRAMES[2]),
        (diagonal_wall(), FRAMES[0]),
        (diagonal_wall(), FRAMES[1]),
        (diagonal_wall(), (0.0, 3.0, -math.pi / 2.0)),
    ],
    ids=["straight", "turned", "turned far", "diagonal", "diagonal, turned", "a quarter"],
)
@pytest.mark.parametrize("up", [(0.0, 1.0), (1.0, 1.0), (0.3, 1.0), (1.0, -0.2)])
def test_no_wall_is_stepped_into_or_over(up, wall: np.ndarray, frame, speed: float) -> None:
    grid = OccupancyGrid(wall, RESOLUTION, frame)
    field = field_of(up[0] * ROWS + up[1] * COLUMNS, frame)
    path = climb(field, grid, at(frame, 5.3, 6.2), speed)
    assert (rooms(grid, path) == rooms(grid, path)[0]).all()
    assert rooms(grid, path)[0] > 0
    assert np.linalg.norm(path[-1] - path[0]) > 0.3


def test_no_diagonal_wall_is_stepped_through_on_a_turned_map() -> None:
    frame = (0.0, 0.0, math.pi / 4.0)
    grid = OccupancyGrid(diagonal_wall(), RESOLUTION, frame)
    path = climb(field_of(ROWS + COLUMNS, frame), grid, at(frame, 10.2, 11.2), 1.0)
    assert (rooms(grid, path) == rooms(grid, path)[0]).all()


@given(st.integers(0, 2**32 - 1), st.sampled_from(FRAMES), st.sampled_from([0.6, 2.0, 20.0]))
@settings(max_examples=40)
def test_no_wall_of_any_map_is_passed(seed: int, frame, speed: float) -> None:
    rng = np.random.default_rng(seed)
    p = np.where(rng.random(SHAPE) < 0.3, 0.9, 0.3)
    # Unknown cells are no walls.
    p[rng.random(SHAPE) < 0.2] = 0.5
    grid = OccupancyGrid(p, RESOLUTION, frame)
    hills = rng.uniform([-5, -5], [29, 35], (3, 2))
    field = field_of(sum(bump(*hill, width=rng.uniform(2, 9)) for hill in hills), frame)
    start = rng.uniform([0, 0], SHAPE)
    path = climb(field, grid, at(frame, *start), speed)
    number = rooms(grid, path)
    if number[0] == 0:
        np.testing.assert_array_equal(path, np.tile(path[0], (41, 1)))
    assert (number == number[0]).all()
    if speed < 1.0:
        # Steps of less than half a cell: nor is a corner cut in between.
        share = np.linspace(0.0, 1.0, 21)[:, None, None]
        between = path[:-1] + share * np.diff(path, axis=0)
        assert (rooms(grid, between.reshape(-1, 3)) == number[0]).all()
    heights = np.asarray(values_jit(field, jnp.asarray(path[:, :2])))
    assert (np.diff(heights) >= 0.0).all()
    assert (np.linalg.norm(np.diff(path, axis=0), axis=1) <= speed * 0.05 * (1 + 1e-4)).all()


def test_what_is_not_known_to_be_occupied_is_no_wall() -> None:
    p = FREE.copy()
    p[:, 12:20] = 0.5
    p[:, 16] = 0.64
    path = climb(field_of(COLUMNS), OccupancyGrid(p, RESOLUTION), [0.6, 1.2, 0.0])
    assert path[-1, 0] > 2.9


@pytest.mark.parametrize("eighth", range(8))
def test_slides_along_a_wall_if_that_leads_up(eighth: int) -> None:
    """A wall across the steeper way up, of which it has to go along to get higher."""
    frame = (0.4, -0.3, eighth * math.pi / 4.0)
    p = FREE.copy()
    p[14, :] = 0.9
    grid = OccupancyGrid(p, RESOLUTION, frame)
    field = field_of(2.0 * ROWS + COLUMNS, frame)
    points = in_grid(frame, climb(field, grid, at(frame, 10.2, 5.2)))
    assert points[:, 0].max() < 14.0
    assert points[-1, 0] > 13.3
    assert points[-1, 1] > 29.0


def test_does_not_slide_down() -> None:
    p = FREE.copy()
    p[14, :] = 0.9
    field = field_of(ROWS - 0.01 * (COLUMNS - 15.0) ** 2)
    points = in_grid(STRAIGHT, climb(field, OccupancyGrid(p, RESOLUTION), at(STRAIGHT, 4.0, 8.0)))
    assert points[:, 0].max() < 14.0
    assert points[-1, 1] == pytest.approx(15.5, abs=0.6)


@pytest.mark.parametrize(
    "start",
    [
        (1.65, 1.0, 2.0),  # in a wall
        (-0.2, 1.0, 2.0),  # off the map
        (3.2, 1.0, 2.0),
        (1.0, 90.0, 2.0),
        (NAN, 1.0, 2.0),
        (1.0, NAN, 2.0),
        (NAN, NAN, NAN),
        (math.inf, 1.0, 2.0),
    ],
)
def test_nothing_moves_that_is_nowhere(start) -> None:
    field = field_of(COLUMNS)
    path = climb(field, OccupancyGrid(straight_wall(), RESOLUTION), start)
    np.testing.assert_array_equal(path, np.tile(np.float32(start), (41, 1)))


def test_an_unknown_height_is_no_obstacle() -> None:
    path = climb(field_of(COLUMNS), OccupancyGrid(FREE, RESOLUTION), [1.0, 1.0, NAN], 0.5)
    np.testing.assert_allclose(path[:, 0], 1.0 + 0.025 * np.arange(41), atol=1e-4)
    assert np.isnan(path[:, 2]).all()


def test_speed_and_time_step_are_data() -> None:
    traces = []

    @eqx.filter_jit
    def counted(reference, field, grid, start):
        traces.append(1)
        return reference(field, grid, start)

    field, grid = field_of(COLUMNS), OccupancyGrid(FREE, RESOLUTION)
    for speed, dt in ((2.0, 0.05), (0.1, 0.05), (0.1, 2.0), (12.0, 0.05)):
        path = counted(GradientReference(speed, 3, dt), field, grid, jnp.asarray([0.3, 1.0, 0.0]))
        assert float(path[0, 0]) == pytest.approx(0.3 + speed * dt, rel=1e-4)
    assert traces == [1]


def test_leads_to_the_unknown_part_of_a_map() -> None:
    pose = PoseInformation(Lidar(num_beams=16, max_range=0.8))
    sensor = LocalFieldSensor(pose, RESOLUTION, extent=0.8, spacing=0.2, num_headings=4)
    potential = eqx.filter_jit(lambda grid, at: sensor.field(grid, at).best)
    p = np.full(SHAPE, 0.001)
    p[:, 20:] = 0.5
    for values, side in ((p, 1.0), (p[:, ::-1], -1.0)):
        # 0.67 m before what is unknown.
        start = np.asarray([1.5 - side * 0.17, 1.25, 1.0])
        grid = OccupancyGrid(values, RESOLUTION)
        field = potential(grid, jnp.asarray(start[:2], jnp.float32))
        path = climb(field, grid, start, 0.5)
        assert side * (path[-1, 0] - start[0]) > 0.3
        assert (side * np.diff(path[:, 0]) > -1e-3).all()
        assert np.abs(path[:, 1] - start[1]).max() < 0.3
        assert float(field(jnp.asarray(path[-1, :2]))) == pytest.approx(
            float(field.values.max()), rel=0.1
        )
