import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import InverseSensorModel, Lidar, OccupancyGrid
from jaxplore.sensing.lidar import Scan

RESOLUTION, ORIGIN = 0.2, (-1.0, 2.0, 0.4)
LIDAR = Lidar(num_beams=24, max_range=2.5, range_noise=0.0)
MODEL = InverseSensorModel()
scan_jit = jax.jit(lambda lidar, world, pose, key: lidar.scan(world, pose, key=key))
update_jit = jax.jit(lambda lidar, belief, scan, pose: lidar.update(belief, scan, pose, MODEL))


def walk(world: np.ndarray, pose: np.ndarray, angle: float, reach: float):
    """March along one beam in double precision: (row, column, entry, exit) [cells, m, m]."""
    x, y = pose[0] - ORIGIN[0], pose[1] - ORIGIN[1]
    c, s = math.cos(ORIGIN[2]), math.sin(ORIGIN[2])
    position = [(c * y - s * x) / RESOLUTION, (c * x + s * y) / RESOLUTION]
    heading = pose[2] + angle - ORIGIN[2]
    direction = [math.sin(heading), math.cos(heading)]
    cell, entry = [math.floor(position[0]), math.floor(position[1])], 0.0
    while entry * RESOLUTION < reach:
        leave = []
        for axis in (0, 1):
            edge = cell[axis] + (direction[axis] > 0)
            leave.append((edge - position[axis]) / direction[axis] if direction[axis] else math.inf)
        axis = int(leave[1] < leave[0])
        yield cell[0], cell[1], entry * RESOLUTION, leave[axis] * RESOLUTION
        entry = leave[axis]
        cell[axis] += 1 if direction[axis] > 0 else -1


def solid(world: np.ndarray, row: int, column: int) -> bool:
    inside = 0 <= row < world.shape[0] and 0 <= column < world.shape[1]
    return not inside or world[row, column] >= 0.25


def random_world(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    world = rng.choice([0.0, 0.5, 1.0], (20, 25), p=[0.93, 0.03, 0.04]).astype(np.float32)
    grid = OccupancyGrid(world, RESOLUTION, ORIGIN)
    centre = np.asarray(
        grid.frame.to_world(jnp.asarray(rng.uniform([3, 3], [17, 22]), jnp.float32))
    )
    return world, np.array([*centre, rng.uniform(-4, 4)])


@given(st.integers(0, 2**32 - 1))
def test_scan_equals_a_march_along_each_beam(seed: int) -> None:
    world, pose = random_world(seed)
    grid = OccupancyGrid(world, RESOLUTION, ORIGIN)
    scan = scan_jit(LIDAR, grid, jnp.asarray(pose, jnp.float32), jax.random.key(0))
    for angle, found, is_return in zip(LIDAR.beam_angles, scan.ranges, scan.is_return, strict=True):
        hits, slivers = [], []
        for row, column, entry, leave in walk(world, pose, float(angle), 2.5):
            if solid(world, row, column):
                # A corner that is only grazed may or may not stop a beam in single precision.
                (hits if leave - entry > 1e-4 else slivers).append(entry)
                if hits:
                    break
        expected = [*hits, 2.5][:1] + slivers
        assert min(abs(float(found) - e) for e in expected) < 1e-3
        if float(found) < 2.499:
            assert bool(is_return)


def test_nothing_in_range_is_no_return() -> None:
    grid = OccupancyGrid(np.zeros((60, 60)), 0.1)
    scan = Lidar(8, 1.0, range_noise=0.0).scan(
        grid, jnp.asarray([3.0, 3.0, 0.0]), key=jax.random.key(0)
    )
    assert not scan.is_return.any()
    np.testing.assert_array_equal(scan.ranges, 1.0)


def test_noise_has_the_deviation_given_and_no_return_has_none() -> None:
    world = np.zeros((40, 40), np.float32)
    world[:, 30:] = 1.0
    grid = OccupancyGrid(world, 0.1)
    lidar = Lidar(400, 2.0, math.radians(20), range_noise=0.05)
    pose = jnp.asarray([2.0, 2.0, 0.0])
    noisy = lidar.scan(grid, pose, key=jax.random.key(1))
    exact = Lidar(400, 2.0, math.radians(20), range_noise=0.0).scan(
        grid, pose, key=jax.random.key(1)
    )
    error = np.asarray(noisy.ranges - exact.ranges)
    assert error.std() == pytest.approx(0.05, rel=0.1)
    assert abs(error.mean()) < 0.01
    away = lidar.scan(grid, jnp.asarray([1.0, 2.0, math.pi / 2]), key=jax.random.key(1))
    np.testing.assert_array_equal(away.ranges[~away.is_return], 2.0)


@given(st.integers(0, 2**32 - 1))
def test_update_is_the_inverse_sensor_model_once_per_cell(seed: int) -> None:
    world, pose = random_world(seed)
    rng = np.random.default_rng(seed)
    prior = rng.uniform(0.05, 0.95, world.shape).astype(np.float32)
    ranges = rng.uniform(0.2, 2.5, 24).astype(np.float32)
    is_return = rng.random(24) < 0.7
    ranges[~is_return] = 2.5
    belief = update_jit(
        LIDAR,
        OccupancyGrid(prior, RESOLUTION, ORIGIN),
        Scan(jnp.asarray(ranges), jnp.asarray(is_return)),
        jnp.asarray(pose, jnp.float32),
    )
    hits, passes, unsure = (np.zeros(world.shape, int) for _ in range(3))
    for angle, reading, returned in zip(LIDAR.beam_angles, ranges, is_return, strict=True):
        for row, column, entry, leave in walk(world, pose, float(angle), 3.0):
            if not (0 <= row < world.shape[0] and 0 <= column < world.shape[1]):
                continue
            edge = min(abs(entry - reading), abs(leave - reading)) < 2e-3
            if leave - entry < 1e-3 or edge:
                unsure[row, column] = 1
            elif returned and entry <= reading < leave:
                hits[row, column] += 1
            elif leave <= reading:
                passes[row, column] += 1
    occupied = (hits > 0) & (3 * hits >= hits + passes)
    change = np.where(occupied, 2.0, np.where(passes > 0, -2.0, 0.0))
    log_odds = np.log(prior / (1 - prior.astype(float)))
    expected = 1 / (1 + np.exp(-np.clip(log_odds + change, -7.0, 5.0)))
    sure = unsure == 0
    np.testing.assert_allclose(np.asarray(belief.probability)[sure], expected[sure], atol=1e-5)


def test_repeated_scans_saturate_at_the_clamp() -> None:
    world = np.zeros((30, 30), np.float32)
    world[:, 20] = 1.0
    grid, pose = OccupancyGrid(world, RESOLUTION), jnp.asarray([3.0, 3.0, 0.0])
    belief = OccupancyGrid.unknown((30, 30), grid.frame)
    for index in range(6):
        scan = scan_jit(LIDAR, grid, pose, jax.random.key(index))
        belief = update_jit(LIDAR, belief, scan, pose)
    assert float(belief.at(jnp.asarray([3.5, 3.0]))) == pytest.approx(1 / (1 + math.exp(7)))
    assert float(belief.at(jnp.asarray([4.1, 3.0]))) == pytest.approx(1 / (1 + math.exp(-5)))
    assert float(belief.at(jnp.asarray([5.0, 3.0]))) == 0.5  # behind the wall


def test_noise_does_not_thicken_a_wall_that_beams_graze() -> None:
    world = np.zeros((40, 60), np.float32)
    world[25] = 1.0
    grid = OccupancyGrid(world, 0.1)
    lidar = Lidar(num_beams=360, max_range=3.0, range_noise=0.03)

    @jax.jit
    def drive(key: jax.Array) -> jax.Array:
        def look(belief: OccupancyGrid, inputs: tuple[jax.Array, jax.Array]):
            key, x = inputs
            pose = jnp.stack([x, jnp.asarray(2.2), jnp.zeros(())])
            belief = lidar.update(belief, lidar.scan(grid, pose, key=key), pose, MODEL)
            return belief, belief.probability

        keys = jax.random.split(key, 60)
        start = OccupancyGrid.unknown((40, 60), grid.frame)
        return jax.lax.scan(look, start, (keys, jnp.linspace(2.0, 4.0, 60)))[1]

    seen = np.asarray(drive(jax.random.key(0)))[10:, :, 20:40]
    assert (seen[:, 25] > 0.65).mean() > 0.99  # the wall stays
    assert (seen[:, 23] < 0.25).all()
    assert (seen[:, 24] < 0.25).mean() > 0.99  # and so does the row of cells in front of it


def test_beams_cover_the_field_of_view_and_none_comes_twice() -> None:
    full = Lidar(8, 1.0).beam_angles
    np.testing.assert_allclose(np.diff(full), math.pi / 4, rtol=1e-6)
    assert full[-1] - full[0] < 2 * math.pi - 0.5
    half = Lidar(5, 1.0, math.pi).beam_angles
    np.testing.assert_allclose(half, np.linspace(-math.pi / 2, math.pi / 2, 5), atol=1e-6)
    np.testing.assert_array_equal(Lidar(1, 1.0, 0.5).beam_angles, [0.0])


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("num_beams", 0),
        ("max_range", 0.0),
        ("max_range", math.nan),
        ("field_of_view", 0.0),
        ("field_of_view", 7.0),
        ("range_noise", -0.1),
    ],
)
def test_bad_lidar_is_named(argument: str, value: object) -> None:
    with pytest.raises(ValueError, match=f"{argument} is .*accepted"):
        Lidar(**{argument: value})


@pytest.mark.parametrize(
    ("argument", "value"),
    [("occupied", 0.0), ("occupied", -1.0), ("free", 0.1), ("minimum", 1.0), ("maximum", math.nan)],
)
def test_bad_sensor_model_is_named(argument: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{argument} is .*accepted"):
        InverseSensorModel(**{argument: value})
