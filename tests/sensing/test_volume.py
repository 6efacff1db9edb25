"""Sensors of a volume against a plain ray caster, and the update of voxels by their scans."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel
from jaxplore.sensing.volume import DepthCamera, RingLidar

SIDE, SHAPE, ORIGIN = 0.25, (10, 14, 18), (-1.0, 2.0, -0.5)
CAMERA = DepthCamera(12, 9, max_range=3.0, quadratic_noise=0.0)
TILTED = DepthCamera(10, 10, max_range=3.0, quadratic_noise=0.0, tilt=-0.6)
RINGS = RingLidar(5, 24, max_range=3.0, range_noise=0.0)
MODEL = InverseSensorModel()
scan = eqx.filter_jit(lambda sensor, world, at, turn, key: sensor.scan(world, at, turn, key=key))
sees = eqx.filter_jit(lambda sensor, world, at, turn, points: sensor.sees(world, at, turn, points))
update = eqx.filter_jit(
    lambda sensor, grid, at, turn, found: sensor.update(grid, at, turn, found, MODEL)
)


def world(seed: int, share: float = 0.05) -> VoxelGrid:
    solid = np.random.default_rng(seed).random(SHAPE) < share
    return VoxelGrid.solid(solid, SIDE, ORIGIN)


def pose(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a position in the box and a rotation."""
    rng = np.random.default_rng(seed)
    size = SIDE * np.array(SHAPE[::-1])
    at = np.array(ORIGIN) + rng.uniform(0.2, 0.8, 3) * size
    return at.astype(np.float32), Rotation.random(rng=rng).as_matrix().astype(np.float32)


def plain(solid: np.ndarray, at: np.ndarray, way: np.ndarray, limit: float) -> float:
    """Return the range at which a ray enters the first solid voxel, by slabs of each voxel."""
    best = math.inf
    for k, j, i in np.argwhere(solid):
        low = np.array(ORIGIN) + SIDE * np.array([i, j, k])
        with np.errstate(divide="ignore", invalid="ignore"):
            one, two = (low - at) / way, (low + SIDE - at) / way
        enter, leave = np.minimum(one, two).max(), np.maximum(one, two).min()
        # A voxel of which the ray touches an edge does not count.
        if leave - max(enter, 0.0) > 1e-3 * SIDE and enter < best:
            best = max(float(enter), 0.0)
    return min(best, limit)


@settings(max_examples=12)
@given(st.integers(0, 2**31), st.sampled_from([CAMERA, RINGS]))
def test_ranges_are_those_of_a_plain_ray_caster(seed: int, sensor) -> None:
    given, (at, turn) = world(seed), pose(seed)
    solid = np.asarray(given.is_occupied)
    found = scan(sensor, given, jnp.asarray(at), jnp.asarray(turn), jax.random.key(0))
    ways = (turn.astype(np.float64) @ sensor.directions.astype(np.float64)).T
    wanted = [plain(solid, at.astype(np.float64), way, 3.0) for way in ways]
    off = np.abs(np.asarray(found.ranges) - wanted)
    # A ray along an edge meets one of two voxels, whichever rounding says.
    assert (off > 2e-3).mean() < 0.01
    np.testing.assert_array_equal(found.is_return, np.asarray(found.ranges) < 3.0)


def view_margin(sensor, way: np.ndarray) -> float:
    """Return how far a direction in the frame of the body is inside the view, as tangents."""
    if isinstance(sensor, RingLidar):
        low, high = sensor.elevations
        elevation = math.atan2(way[2], math.hypot(way[0], way[1]))
        return min(elevation - low, high - elevation)
    cos, sin = math.cos(sensor.tilt), math.sin(sensor.tilt)
    ahead = cos * way[0] + sin * way[2]
    if ahead <= 0.0:
        return -1.0
    right, up = abs(way[1]) / ahead, abs(-sin * way[0] + cos * way[2]) / ahead
    halves = math.tan(0.5 * sensor.field_of_view), math.tan(0.5 * sensor.vertical_view)
    return min(halves[0] - right, halves[1] - up)


@settings(max_examples=12)
@given(st.integers(0, 2**31), st.sampled_from([CAMERA, TILTED, RINGS]))
def test_points_in_sight_are_those_that_a_plain_ray_caster_reaches(seed: int, sensor) -> None:
    given, (at, turn) = world(seed, 0.02), pose(seed)
    solid, place = np.asarray(given.is_occupied), at.astype(np.float64)
    rng = np.random.default_rng(seed)
    # Half of them are along rays of the sensor, so that some are in view.
    ways = turn.astype(np.float64) @ sensor.directions[:, rng.integers(100, size=20)]
    along = place + (ways * rng.uniform(0.1, 3.3, 20)).T
    points = np.concatenate([along, place + rng.uniform(-3.0, 3.0, (20, 3))]).astype(np.float32)
    found = np.asarray(sees(sensor, given, jnp.asarray(at), jnp.asarray(turn), points))
    checked = 0
    for point, is_seen in zip(points.astype(np.float64), found, strict=True):
        away = point - place
        distance = float(np.linalg.norm(away))
        margin = view_margin(sensor, turn.astype(np.float64).T @ away / distance)
        free = plain(solid, place, away / distance, 9.0) - distance
        # At an edge of the view or of a voxel rounding decides.
        if min(abs(margin), abs(free), abs(distance - 3.0)) < 5e-3:
            continue
        checked += 1
        assert is_seen == (margin > 0.0 and free > 0.0 and distance < 3.0)
    assert checked > 20


def test_a_scan_makes_known_what_it_crossed() -> None:
    given, (at, turn) = world(3), pose(3)
    blank = VoxelGrid.unknown(SIDE * np.array(SHAPE[::-1]), SIDE, ORIGIN)
    assert blank.shape == SHAPE
    found = scan(RINGS, given, jnp.asarray(at), jnp.asarray(turn), jax.random.key(0))
    known = update(RINGS, blank, jnp.asarray(at), jnp.asarray(turn), found)
    free, hit = np.asarray(known.is_free), np.asarray(known.is_occupied)
    solid = np.asarray(given.is_occupied)
    # Without noise nothing is wrong: what is solid is hit, what is free is passed.
    assert not (free & solid).any()
    assert not (hit & ~solid).any()
    assert free.sum() > 100
    # Each return is in a voxel that is known to be occupied now.
    returns = np.asarray(found.is_return)
    ways = turn @ RINGS.directions
    points = at[:, None] + (np.asarray(found.ranges) + 0.02 * SIDE) * ways
    voxels = np.floor(np.asarray(known.to_grid(jnp.asarray(points)))).astype(int)
    inside = returns & np.asarray(known.contains(jnp.asarray(voxels)))
    assert inside.sum() > 20
    k, j, i = voxels[:, inside]
    assert hit[k, j, i].mean() > 0.98
    np.testing.assert_allclose(np.asarray(known.log_odds)[hit], 2.0)
    np.testing.assert_allclose(np.asarray(known.log_odds)[free], -2.0)
    # A second look adds up, and stays within the bounds of the model.
    for _ in range(4):
        known = update(RINGS, known, jnp.asarray(at), jnp.asarray(turn), found)
    np.testing.assert_allclose(np.asarray(known.log_odds)[hit], 5.0)
    np.testing.assert_allclose(np.asarray(known.log_odds)[free], -7.0)


def test_what_is_no_measurement_changes_nothing() -> None:
    blank = VoxelGrid.unknown(SIDE * np.array(SHAPE[::-1]), SIDE, ORIGIN)
    at, turn = pose(1)
    found = scan(RINGS, world(1), jnp.asarray(at), jnp.asarray(turn), jax.random.key(0))
    for wrong in (math.nan, -1.0, 0.0, math.inf):
        bad = found._replace(ranges=jnp.full_like(found.ranges, wrong))
        known = update(RINGS, blank, jnp.asarray(at), jnp.asarray(turn), bad)
        assert not np.asarray(known.log_odds).any()
    lost = update(RINGS, blank, jnp.full(3, jnp.nan), jnp.asarray(turn), found)
    assert not np.asarray(lost.log_odds).any()


def test_a_quarter_turn_of_the_world_turns_what_is_known() -> None:
    cube = np.random.default_rng(5).random((8, 8, 8)) < 0.1
    cube[3:5, 3:5, 3:5] = False
    at = jnp.asarray([1.0, 1.0, 1.0])
    quarter = jnp.asarray([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    known = []
    for solid, turn in ((cube, jnp.eye(3)), (np.rot90(cube, 1, (2, 1)), quarter)):
        given, blank = VoxelGrid.solid(solid, SIDE), VoxelGrid.unknown((2, 2, 2), SIDE)
        found = scan(RINGS, given, at, turn, jax.random.key(0))
        known.append(np.asarray(update(RINGS, blank, at, turn, found).log_odds))
    turned = np.rot90(known[0], 1, (2, 1))
    # Rays along the axes meet the edges of voxels.
    assert (turned != known[1]).mean() < 0.01


def test_noise_grows_with_the_square_of_the_range() -> None:
    room = np.ones((8, 8, 40), bool)
    room[1:-1, 1:-1, 1:-1] = False
    given = VoxelGrid.solid(room, SIDE)
    sensor = DepthCamera(1, 1, max_range=9.0, quadratic_noise=0.01)
    keys = jax.random.split(jax.random.key(0), 2000)
    for near in (2.0, 6.0):
        at = jnp.asarray([9.75 - near, 1.0, 1.0])
        ranges = jax.vmap(lambda key, at=at: sensor.scan(given, at, jnp.eye(3), key=key).ranges)(
            keys
        )
        assert float(ranges.mean()) == pytest.approx(near, abs=0.02)
        assert float(ranges.std()) == pytest.approx(0.01 * near**2, rel=0.1)


def test_directions_are_those_of_a_pinhole_and_of_rings() -> None:
    camera = DepthCamera(64, 48)
    ways = camera.directions.reshape(3, 48, 64)
    np.testing.assert_allclose(np.linalg.norm(ways, axis=0), 1.0, atol=1e-6)
    # The outermost pixels are half a pixel within the view.
    across = math.atan(math.tan(math.radians(40.0)) * 63 / 64)
    assert math.atan2(ways[1, 0, 0], ways[0, 0, 0]) == pytest.approx(across, abs=1e-5)
    assert ways[2, 0, 0] > 0.0 > ways[2, -1, 0]
    down = DepthCamera(1, 1, tilt=-0.3).directions[:, 0]
    np.testing.assert_allclose(down, [math.cos(0.3), 0.0, -math.sin(0.3)], atol=1e-6)
    rings = RingLidar(16, 360).directions.reshape(3, 16, 360)
    np.testing.assert_allclose(
        np.arcsin(rings[2, :, 0]), np.radians(np.linspace(-15, 15, 16)), atol=1e-5
    )
