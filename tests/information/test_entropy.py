import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore import Lidar, OccupancyGrid
from jaxplore.information.batches import BATCH
from jaxplore.information.entropy import EntropyFan, pose_table

pytestmark = pytest.mark.long

SHAPE, RESOLUTION, ORIGIN = (14, 18), 0.25, (1.0, -2.0, 0.6)
LIDAR = Lidar(num_beams=7, max_range=2.1, field_of_view=2.0)
SEEING = EntropyFan(LIDAR, num_ranges=9, decay_length=1.5)
THROUGH_WALLS = EntropyFan(LIDAR, num_ranges=9, decay_length=1.5, line_of_sight=False)
BLUR = 1e-4  # [cells]: how close to a border single precision may take either side


@eqx.filter_jit
def value_jit(fan, grid, position, heading):
    return fan(grid, position, heading)


def value(fan: EntropyFan, grid: OccupancyGrid, pose: np.ndarray) -> float:
    pose = jnp.asarray(pose, jnp.float32)
    return float(value_jit(fan, grid, pose[:2], pose[2]))


def random_map(seed: int, shape: tuple[int, int] = SHAPE) -> np.ndarray:
    rng = np.random.default_rng(seed)
    levels, share = [0.0, 0.02, 0.3, 0.5, 0.64, 0.7, 1.0], [0.2, 0.2, 0.2, 0.2, 0.1, 0.05, 0.05]
    return rng.choice(levels, shape, p=share).astype(np.float32)


def entropy(p: float) -> float:
    return -sum(q * math.log(q) for q in (p, 1 - p) if q > 0)


def at(p: np.ndarray, row: int, column: int) -> float:
    inside = 0 <= row < p.shape[0] and 0 <= column < p.shape[1]
    return float(p[row, column]) if inside else 1.0


def sight(p: np.ndarray, start: list[float], angle: float, reach: float) -> tuple[float, float]:
    """Amanatides and Woo in double precision: where the beam leaves the first occupied cell, if
    cells count that are only grazed, and if they do not [cells]."""
    direction = [math.sin(angle), math.cos(angle)]
    cell, entry, least = [math.floor(start[0]), math.floor(start[1])], 0.0, math.inf
    while entry < reach:
        leave = [
            (cell[a] + (direction[a] > 0) - start[a]) / direction[a] if direction[a] else math.inf
            for a in (0, 1)
        ]
        axis = int(leave[1] < leave[0])
        if at(p, *cell) > 0.65:
            least = min(least, leave[axis])
            if leave[axis] - entry > 1e-3:
                return least, leave[axis]
        entry = leave[axis]
        cell[axis] += 1 if direction[axis] > 0 else -1
    return least, math.inf


def bounds(p: np.ndarray, origin, pose: np.ndarray, fan: EntropyFan) -> tuple[float, float]:
    """The gain by a loop over samples, least and greatest where rounding decides on a sample."""
    p = p.astype(float)
    x, y, yaw = (float(v) for v in np.asarray(pose, np.float32))
    c, s = math.cos(origin[2]), math.sin(origin[2])
    dx, dy = x - origin[0], y - origin[1]
    start = [(c * dy - s * dx) / RESOLUTION, (c * dx + s * dy) / RESOLUTION]
    if at(p, math.floor(start[0]), math.floor(start[1])) > 0.65:
        return 0.0, 0.0
    low = high = 0.0
    reach = fan.lidar.max_range
    for b in fan.lidar.beam_angles.astype(float):
        near, far = math.inf, math.inf
        if fan.line_of_sight:
            near, far = sight(p, start, yaw + b - origin[2], reach / RESOLUTION)
        for i in range(fan.num_ranges):
            r = reach * i / max(1, fan.num_ranges - 1)
            px, py = x + r * math.cos(yaw + b) - origin[0], y + r * math.sin(yaw + b) - origin[1]
            row, column = (c * py - s * px) / RESOLUTION, (c * px + s * py) / RESOLUTION
            values = []
            for shift_row in (-BLUR, BLUR):
                for shift_column in (-BLUR, BLUR):
                    cell = math.floor(row + shift_row), math.floor(column + shift_column)
                    inside = 0 <= cell[0] < p.shape[0] and 0 <= cell[1] < p.shape[1]
                    values.append(entropy(p[cell]) if inside else 0.0)
            if r / RESOLUTION > near - BLUR:
                values.append(0.0)
            if r / RESOLUTION > far + BLUR:
                values = [0.0]
            decay = math.exp(-r / float(fan.decay_length))
            low, high = low + min(values) * decay, high + max(values) * decay
    return low, high


def clear_pose(p: np.ndarray, fan: EntropyFan, seed: int) -> np.ndarray:
    """A pose in the frame of the world's origin at which no sample is near a border."""
    rng = np.random.default_rng(seed)
    while True:
        size = np.array([p.shape[1], p.shape[0]]) * RESOLUTION
        pose = np.array([*(rng.uniform(0.1, 0.9, 2) * size), rng.uniform(-3, 3)])
        low, high = bounds(p, (0.0, 0.0, 0.0), pose, fan)
        if low == high > 0:
            return pose


@pytest.mark.parametrize("fan", [SEEING, THROUGH_WALLS], ids=["seeing", "through_walls"])
@given(st.integers(0, 2**32 - 1))
@settings(max_examples=40)
def test_gain_is_a_sum_over_samples(fan: EntropyFan, seed: int) -> None:
    p, rng = random_map(seed), np.random.default_rng(seed)
    grid = OccupancyGrid(p, RESOLUTION, ORIGIN)
    # Up to a cell beyond the border, so that samples, and now and then the pose, are off the map.
    node = jnp.asarray(rng.uniform([-1, -1], [SHAPE[0] + 1, SHAPE[1] + 1]), jnp.float32)
    pose = np.array([*np.asarray(grid.frame.to_world(node)), rng.uniform(-7, 7)])
    low, high = bounds(p, np.asarray(grid.frame.origin, float), pose, fan)
    assert low - 1e-4 <= value(fan, grid, pose) <= high + 1e-4
    # Rounding is to decide on a sample or two at most.
    assert high - low < 1.5


def test_a_wall_is_seen_and_hides_what_is_behind_it() -> None:
    p = np.full((1, 12), 0.5, np.float32)
    p[0, 6] = 0.7
    grid = OccupancyGrid(p, 1.0)
    fan = EntropyFan(Lidar(num_beams=1, max_range=10.0), num_ranges=21, decay_length=1e6)
    through = dataclasses.replace(fan, line_of_sight=False)
    # Samples every half metre from x = 0.75: 11 in front of the wall, 2 in it, 8 behind.
    pose = np.array([0.75, 0.5, 0.0])
    seen = 11 * entropy(0.5) + 2 * entropy(0.7)
    assert value(fan, grid, pose) == pytest.approx(seen, rel=1e-4)
    assert value(through, grid, pose) == pytest.approx(seen + 8 * entropy(0.5), rel=1e-4)


def test_no_wall_is_stepped_over() -> None:
    p = np.full((1, 60), 0.5, np.float32)
    p[0, 7] = 1.0
    fan = EntropyFan(Lidar(num_beams=1, max_range=10.0), num_ranges=3, decay_length=1e6)
    # Samples at 0, 5 and 10 m, none of them in the wall at 0.7 to 0.8 m.
    assert value(fan, OccupancyGrid(p, 0.1), np.array([0.05, 0.05, 0.0])) == pytest.approx(
        math.log(2), rel=1e-4
    )


def test_distance_decay() -> None:
    grid = OccupancyGrid(np.full((3, 40), 0.5, np.float32), 1.0)
    fan = EntropyFan(Lidar(num_beams=1, max_range=20.0), num_ranges=5)
    expected = math.log(2) * sum(math.exp(-r / 20.0) for r in (0, 5, 10, 15, 20))
    assert value(fan, grid, np.array([1.5, 1.5, 0.0])) == pytest.approx(expected, rel=1e-5)


def test_over_a_full_circle_no_beam_counts_twice() -> None:
    quarter = EntropyFan(Lidar(num_beams=4, max_range=2.1), num_ranges=9)
    single = EntropyFan(Lidar(num_beams=1, max_range=2.1), num_ranges=9)
    p = random_map(1, (15, 15))
    p[7, 7] = 0.5
    grid = OccupancyGrid(p, RESOLUTION)
    pose = clear_pose(p, quarter, 0)
    turned = [pose + np.array([0, 0, n * math.pi / 2]) for n in range(4)]
    expected = sum(value(single, grid, each) for each in turned)
    assert value(quarter, grid, pose) == pytest.approx(expected, rel=1e-5)
    # On a map that is the same after a quarter turn all four are worth the same.
    symmetric = np.max([np.rot90(p, k) for k in range(4)], axis=0)
    middle = np.array([7.5 * RESOLUTION, 7.5 * RESOLUTION, 0.3])
    assert symmetric[7, 7] == 0.5
    grid = OccupancyGrid(symmetric, RESOLUTION)
    one = value(single, grid, middle)
    assert one > 0.5
    assert value(quarter, grid, middle) == pytest.approx(4 * one, rel=1e-5)


def test_a_batch_is_its_poses_one_by_one() -> None:
    p = random_map(2)
    grid = OccupancyGrid(p, RESOLUTION)
    rng = np.random.default_rng(0)
    count = BATCH + 5
    poses = rng.uniform([0, 0, -4], [4.5, 3.5, 4], (count, 3))
    poses[3, 0] = math.nan
    arrays = jnp.asarray(poses, jnp.float32)
    expected = [value(SEEING, grid, pose) for pose in poses]
    assert expected[3] == 0.0
    many = value_jit(SEEING, grid, arrays[:, :2], arrays[:, 2])
    assert many.shape == (count,)
    np.testing.assert_allclose(many, expected, rtol=1e-5, atol=1e-5)
    few = value_jit(SEEING, grid, arrays[:6, :2], arrays[:6, 2])
    np.testing.assert_allclose(few, expected[:6], rtol=1e-5, atol=1e-5)
    mapped = jax.jit(jax.vmap(lambda pose: SEEING(grid, pose[:2], pose[2])))(arrays[:6])
    np.testing.assert_allclose(mapped, expected[:6], rtol=1e-5, atol=1e-5)


def test_a_change_of_decay_map_or_pose_does_not_retrace() -> None:
    traces = []

    @eqx.filter_jit
    def look(fan, grid, pose):
        traces.append(1)
        return fan(grid, pose[:2], pose[2])

    found = set()
    for seed, decay in enumerate((0.5, 1.0, 4.0)):
        fan = EntropyFan(LIDAR, num_ranges=9, decay_length=decay)
        grid = OccupancyGrid(np.full(SHAPE, 0.5), RESOLUTION, (0.1 * seed, 0.0, 0.0))
        found.add(float(look(fan, grid, jnp.asarray([1.6, 1.5, 0.1 * seed]))))
    assert len(traces) == 1
    assert len(found) == 3


def test_worthless_poses_and_their_gradients() -> None:
    p = np.full(SHAPE, 0.5, np.float32)
    p[4, 4] = 1.0
    grid = OccupancyGrid(p, RESOLUTION)
    nan, inf = math.nan, math.inf
    worthless = [[-0.1, 1.0, 0.0], [1.0, 3.6, 0.0], [1.1, 1.1, 0.0], [nan, 1.0, 0.0]]
    worthless += [[1.0, 1.0, nan], [1.0, inf, 0.0], [1.0, 1.0, -inf], [1e30, 0.0, 0.0]]
    poses = [[1.6, 1.6, 0.4], *worthless]
    for fan in (SEEING, THROUGH_WALLS):
        look = jax.jit(jax.value_and_grad(lambda pose, fan=fan: fan(grid, pose[:2], pose[2])))
        for pose in poses:
            found, slope = look(jnp.asarray(pose))
            assert np.isfinite(slope).all()
            assert (float(found) > 0) == (pose is poses[0])


@pytest.mark.parametrize("fan", [SEEING, THROUGH_WALLS], ids=["seeing", "through_walls"])
@pytest.mark.parametrize("seed", range(5))
def test_turning_map_and_pose_by_a_quarter_changes_nothing(fan: EntropyFan, seed: int) -> None:
    p = random_map(seed, (16, 16))
    pose = clear_pose(p, fan, seed)
    before = value(fan, OccupancyGrid(p, RESOLUTION), pose)
    side = 16 * RESOLUTION
    turned = np.array([side - pose[1], pose[0], pose[2] + math.pi / 2])
    by_cells = OccupancyGrid(np.rot90(p, -1).copy(), RESOLUTION)
    by_frame = OccupancyGrid(p, RESOLUTION, (side, 0.0, math.pi / 2))
    assert value(fan, by_cells, turned) == pytest.approx(before, rel=1e-5)
    assert value(fan, by_frame, turned) == pytest.approx(before, rel=1e-5)


def test_camera() -> None:
    camera = EntropyFan.camera()
    assert camera.line_of_sight
    assert (camera.lidar.num_beams, camera.num_ranges) == (30, 20)
    assert float(camera.decay_length) == camera.lidar.max_range == 20.0
    np.testing.assert_allclose(
        camera.lidar.beam_angles, np.linspace(-math.pi / 6, math.pi / 6, 30), atol=1e-6
    )
    small = EntropyFan.camera(2.0, 2.1, num_columns=7, num_ranges=9, decay_length=1.5)
    grid = OccupancyGrid(random_map(4), RESOLUTION)
    pose = clear_pose(random_map(4), SEEING, 1)
    assert value(small, grid, pose) == value(SEEING, grid, pose) > 0


TABLE_FAN = EntropyFan(Lidar(num_beams=4, max_range=1.9, field_of_view=1.1), num_ranges=7)
table_jit = jax.jit(lambda grid: pose_table(TABLE_FAN, grid, 8, batch_size=100))


def test_table_is_the_gain_at_its_nodes() -> None:
    grid = OccupancyGrid(random_map(5, (7, 9)), RESOLUTION, ORIGIN)
    table = table_jit(grid)
    assert table.values.shape == (7, 9, 8)
    rows, columns, headings = (v.reshape(-1) for v in np.mgrid[:7, :9, :8])
    centres = grid.frame.cell_centre(jnp.asarray(np.stack([rows, columns], axis=-1)))
    yaws = jnp.asarray(ORIGIN[2] + headings * 2 * math.pi / 8, jnp.float32)
    expected = np.asarray(value_jit(TABLE_FAN, grid, centres, yaws))
    np.testing.assert_allclose(table.values, expected.reshape(7, 9, 8), rtol=1e-4, atol=1e-5)
    assert float(table.values.max()) > 2.0
    np.testing.assert_allclose(jax.jit(jax.vmap(table))(centres, yaws), expected, atol=2e-4)
    np.testing.assert_allclose(table.headings, 0.6 + np.arange(8) * 2 * math.pi / 8, rtol=1e-6)


def test_table_of_any_function_and_outside() -> None:
    grid = OccupancyGrid(np.zeros((3, 4)), 0.5, ORIGIN)

    def gain(grid: OccupancyGrid, position: jax.Array, heading: jax.Array) -> jax.Array:
        return 10.0 + position[0] + 10.0 * position[1] + 100.0 * heading + grid.probability[0, 0]

    table = pose_table(gain, grid, 5)
    for row, column, n in ((0, 0, 0), (2, 3, 4), (1, 2, 3)):
        # The frame written out: a turn by 0.6 rad, then the shift.
        u, v = (column + 0.5) * 0.5, (row + 0.5) * 0.5
        x = ORIGIN[0] + math.cos(0.6) * u - math.sin(0.6) * v
        y = ORIGIN[1] + math.sin(0.6) * u + math.cos(0.6) * v
        heading = 0.6 + n * 2 * math.pi / 5
        expected = 10.0 + x + 10.0 * y + 100.0 * heading
        assert float(table.values[row, column, n]) == pytest.approx(expected, rel=1e-5)
        found = table(jnp.asarray([x, y]), jnp.float32(heading))
        assert float(found) == pytest.approx(expected, rel=1e-4)
    # Behind the outermost centres, and off the map.
    for node in ([0.5, 0.3], [2.7, 2.0], [-4.0, 1.0]):
        assert float(table(grid.frame.to_world(jnp.asarray(node)), jnp.float32(0.0))) == 0.0


def test_bad_input_is_named() -> None:
    grid = OccupancyGrid(np.zeros((3, 4)), 0.5)
    cases = {
        "horizontal_field_of_view is 7.0": lambda: EntropyFan.camera(7.0),
        "max_range is -1.0": lambda: EntropyFan.camera(max_range=-1.0),
        "num_columns is 0": lambda: EntropyFan.camera(num_columns=0),
        "num_headings is 0": lambda: pose_table(SEEING, grid, 0),
        "batch_size is 0": lambda: pose_table(SEEING, grid, batch_size=0),
    }
    for message, build in cases.items():
        with pytest.raises(ValueError, match=f"{message}; accepted: "):
            build()
