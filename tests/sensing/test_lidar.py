import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import InverseSensorModel, Lidar, OccupancyGrid
from jaxplore.maps.ground import Ground
from jaxplore.sensing.beams import Scan

pytestmark = pytest.mark.long

RESOLUTION, ORIGIN = 0.2, (-1.0, 2.0, 0.4)
LIDAR = Lidar(num_beams=24, max_range=2.5, range_noise=0.0)
SECTOR = Lidar(num_beams=19, max_range=2.5, field_of_view=math.radians(270), range_noise=0.0)
MODEL = InverseSensorModel()
scan_jit = jax.jit(lambda lidar, world, pose, key: lidar.scan(world, pose, key=key))
sight_jit = jax.jit(lambda lidar, grid, scan, pose, ground: lidar.sight(grid, scan, pose, ground))
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
    # Larger than what is within the range: a scan changes a window of the map.
    world = rng.choice([0.0, 0.5, 1.0], (36, 45), p=[0.93, 0.03, 0.04]).astype(np.float32)
    grid = OccupancyGrid(world, RESOLUTION, ORIGIN)
    centre = np.asarray(
        grid.frame.to_world(jnp.asarray(rng.uniform([3, 3], [33, 42]), jnp.float32))
    )
    return world, np.array([*centre, rng.uniform(-4, 4)])


@pytest.mark.parametrize(
    ("lidar", "angles"),
    [
        (LIDAR, np.arange(24) * math.pi / 12 - math.pi),
        (SECTOR, np.linspace(-0.75 * math.pi, 0.75 * math.pi, 19)),
    ],
)
@given(seed=st.integers(0, 2**32 - 1))
def test_scan_equals_a_march_along_each_beam(lidar: Lidar, angles: np.ndarray, seed: int) -> None:
    world, pose = random_world(seed)
    grid = OccupancyGrid(world, RESOLUTION, ORIGIN)
    scan = scan_jit(lidar, grid, jnp.asarray(pose, jnp.float32), jax.random.key(0))
    for angle, found, is_return in zip(angles, scan.ranges, scan.is_return, strict=True):
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
    lidar, pose = Lidar(8, 1.0, range_noise=0.0), jnp.asarray([3.0, 3.0, 0.0])
    scan = scan_jit(lidar, grid, pose, jax.random.key(0))
    assert not scan.is_return.any()
    np.testing.assert_array_equal(scan.ranges, 1.0)


def test_noise_has_the_deviation_given_and_no_return_has_none() -> None:
    world = np.zeros((40, 40), np.float32)
    world[:, 30:] = 1.0
    grid = OccupancyGrid(world, 0.1)
    lidar = Lidar(400, 2.0, math.radians(20), range_noise=0.05)
    pose = jnp.asarray([2.0, 2.0, 0.0])
    noisy = scan_jit(lidar, grid, pose, jax.random.key(1))
    still = Lidar(400, 2.0, math.radians(20), range_noise=0.0)
    exact = scan_jit(still, grid, pose, jax.random.key(1))
    error = np.asarray(noisy.ranges - exact.ranges)
    assert error.std() == pytest.approx(0.05, rel=0.1)
    assert abs(error.mean()) < 0.01
    away = scan_jit(lidar, grid, jnp.asarray([1.0, 2.0, math.pi / 2]), jax.random.key(1))
    np.testing.assert_array_equal(away.ranges[~away.is_return], 2.0)


@pytest.mark.parametrize("sigma", [0.0, 0.06])
@given(seed=st.integers(0, 2**32 - 1))
def test_update_is_the_inverse_sensor_model_once_per_cell(sigma: float, seed: int) -> None:
    world, pose = random_world(seed)
    rng = np.random.default_rng(seed)
    prior = rng.uniform(0.05, 0.95, world.shape).astype(np.float32)
    ranges = rng.uniform(0.2, 2.5, 24).astype(np.float32)
    is_return = rng.random(24) < 0.7
    ranges[~is_return] = 2.5
    belief = update_jit(
        Lidar(num_beams=24, max_range=2.5, range_noise=sigma),
        OccupancyGrid(prior, RESOLUTION, ORIGIN),
        Scan(jnp.asarray(ranges), jnp.asarray(is_return)),
        jnp.asarray(pose, jnp.float32),
    )
    hits, passes, unsure = (np.zeros(world.shape, int) for _ in range(3))
    for angle, reading, returned in zip(LIDAR.beam_angles, ranges, is_return, strict=True):
        for row, column, entry, leave in walk(world, pose, float(angle), 3.0):
            if not (0 <= row < world.shape[0] and 0 <= column < world.shape[1]):
                continue
            depth, chord = reading + min(2 * sigma, RESOLUTION / 2), leave - entry
            edges = (entry - depth, leave - depth, leave - reading, chord, chord - sigma)
            if min(abs(edge) for edge in edges) < 2e-3:
                unsure[row, column] = 1
            elif chord >= sigma and returned and entry <= depth < leave:
                hits[row, column] += 1
            elif chord >= sigma and leave <= reading:
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


def test_noise_does_not_wear_away_the_corners_of_obstacles() -> None:
    world = np.zeros((40, 60), np.float32)
    boxes = np.s_[18:22, 14:20], np.s_[17:23, 30:31], np.s_[19:20, 44:45]
    for box in boxes:
        world[box] = 1.0
    grid = OccupancyGrid(world, 0.1)
    lidar = Lidar(num_beams=180, max_range=4.0, range_noise=0.05)

    @jax.jit
    def look(keys: jax.Array, poses: jax.Array) -> jax.Array:
        def once(belief: OccupancyGrid, inputs: tuple[jax.Array, jax.Array]):
            key, pose = inputs
            return lidar.update(belief, lidar.scan(grid, pose, key=key), pose, MODEL), None

        return jax.lax.scan(once, OccupancyGrid.unknown((40, 60), grid.frame), (keys, poses))[0]

    # Around the boxes and between them, standing at each place for a while.
    rng = np.random.default_rng(0)
    places = np.stack([rng.uniform(0.3, 5.7, 60), rng.choice([0.6, 1.0, 3.0, 3.4], 60)], axis=1)
    poses = np.repeat(np.concatenate([places, np.zeros((60, 1))], axis=1), 10, axis=0)
    keys = jax.random.split(jax.random.key(0), len(poses))
    belief = look(keys, jnp.asarray(poses, jnp.float32))
    assert not np.asarray(belief.is_free)[world == 1.0].any()
    # Nor do they grow but by some of the cells that touch them.
    near = [world[1:-1, 2:], world[1:-1, :-2], world[2:, 1:-1], world[:-2, 1:-1]]
    outside, touches = world[1:-1, 1:-1] == 0.0, np.max(near, axis=0) == 1.0
    is_free = np.asarray(belief.is_free)[1:-1, 1:-1]
    assert is_free[outside & ~touches].mean() > 0.995
    assert is_free[outside & touches].mean() > 0.75


def test_beams_cover_the_field_of_view_and_none_comes_twice() -> None:
    full = Lidar(8, 1.0).beam_angles
    np.testing.assert_allclose(np.diff(full), math.pi / 4, rtol=1e-6)
    assert full[-1] - full[0] < 2 * math.pi - 0.5
    half = Lidar(5, 1.0, math.pi).beam_angles
    np.testing.assert_allclose(half, np.linspace(-math.pi / 2, math.pi / 2, 5), atol=1e-6)
    np.testing.assert_array_equal(Lidar(1, 1.0, 0.5).beam_angles, [0.0])


def test_defaults_are_those_of_a_small_indoor_robot() -> None:
    lidar = Lidar()
    assert (lidar.num_beams, lidar.max_range, lidar.is_full_circle) == (360, 5.0, True)
    assert float(lidar.range_noise) == pytest.approx(0.02)
    assert float(lidar.height) == pytest.approx(0.5)


def test_a_sector_says_nothing_of_what_is_behind() -> None:
    grid = OccupancyGrid(np.zeros((60, 60)), 0.1)
    pose = jnp.asarray([3.03, 3.04, 0.6])
    scan = scan_jit(SECTOR, grid, pose, jax.random.key(0))
    is_seen = np.asarray(sight_jit(SECTOR, grid, scan, pose, None).is_seen)
    rows, columns = np.mgrid[:60, :60]
    y, x = 0.1 * rows + 0.05 - 3.04, 0.1 * columns + 0.05 - 3.03
    bearing = np.abs((np.arctan2(y, x) - 0.6 + math.pi) % (2 * math.pi) - math.pi)
    far = np.hypot(x, y) > 0.5
    assert not is_seen[far & (bearing > 0.75 * math.pi + 0.2)].any()
    assert is_seen[(np.hypot(x, y) < 0.5) & (bearing < 2.2)].all()
    # A sector has no edge right where it stands.
    sees = jax.jit(lambda pose, points: SECTOR.sees(grid, pose, points))
    here = jnp.asarray([3.03, 3.04, math.pi])
    np.testing.assert_array_equal(sees(here, jnp.tile(here[:2], (6, 1))), True)
    turns = np.array([0.0, 2.34, -2.34, 2.37, -2.37, 3.1])
    offset = 2.0 * np.stack([np.cos(0.6 + turns), np.sin(0.6 + turns)], axis=-1)
    points = pose[:2] + jnp.asarray(offset, jnp.float32)
    np.testing.assert_array_equal(sees(pose, points), np.abs(turns) < 0.75 * math.pi)


# On hills

EYE = 0.3
HILLS = Lidar(24, 4.0, 2.0, 0.0, EYE)
PLACES, POINTS = 40, 30


@pytest.fixture(scope="module")
def hills(place, observed_from):
    places = [place(seed, 1.5) for seed in range(PLACES)]
    return observed_from(HILLS, places, POINTS, 7, 1.2, 0.1)


def test_level_beams_on_hills_equal_a_walk_along_each(hills, crossed, standing, value_at) -> None:
    places, _, (scans, sightings, _) = hills
    ended = {"wall": 0, "hill": 0, "nothing": 0}
    for index, (world, elevation, pose) in enumerate(places):
        z = value_at(elevation, standing(pose), 0.0) + EYE
        hits, passes, unsure = (np.zeros(world.shape, int) for _ in range(3))

        def count(into, cell):
            if value_at(into, cell, -1.0) >= 0.0:
                into[cell] += 1

        for beam, turn in enumerate(np.linspace(-1.0, 1.0, 24)):
            end, why, is_sure = 4.0, "nothing", True
            for stretch in crossed(pose, float(pose[2]) + turn, 4.0):
                is_wall = value_at(world, stretch.cell, 1.0) >= 0.25
                is_hill = value_at(elevation, stretch.cell, 0.0) > z
                if (
                    stretch.is_sliver
                    or min(abs(4.0 - stretch.entry), abs(4.0 - stretch.exit)) < 1e-3
                ):
                    count(unsure, stretch.cell)
                    is_sure &= not (is_wall or is_hill)
                elif not is_sure:
                    count(unsure, stretch.cell)
                elif is_wall or is_hill:
                    end, why = stretch.entry, "hill" if is_hill else "wall"
                    if not is_hill:
                        count(hits, stretch.cell)
                    break
                elif stretch.exit < 4.0:
                    count(passes, stretch.cell)
            if is_sure:
                assert scans.is_return[index, beam] == (why != "nothing")
                assert scans.ranges[index, beam] == pytest.approx(end, abs=1e-3)
                ended[why] += 1
        sure = unsure == 0
        np.testing.assert_array_equal(sightings.hits[index][sure], hits[sure])
        np.testing.assert_array_equal(sightings.passes[index][sure], passes[sure])
        assert (~sure).sum() < 60
    assert min(ended.values()) > 50


def test_sees_equals_a_walk_to_the_point(hills, crossed, standing, value_at) -> None:
    places, points, (_, _, found) = hills
    counts = {True: 0, False: 0}
    for (world, elevation, pose), targets, answers in zip(places, points, found, strict=True):
        z = value_at(elevation, standing(pose), 0.0) + EYE
        for target, answer in zip(targets, answers, strict=True):
            offset = target.astype(float) - pose[:2]
            angle, distance = math.atan2(offset[1], offset[0]), math.hypot(*offset)
            bearing = abs((angle - float(pose[2]) + math.pi) % (2 * math.pi) - math.pi)
            cell, is_open = standing(target), True
            slivers = min(abs(bearing - 1.0), abs(distance - 4.0)) < 1e-4
            for stretch in crossed(pose, angle, distance):
                slivers |= stretch.is_sliver
                if stretch.cell == cell:
                    break
                is_open &= value_at(world, stretch.cell, 1.0) < 0.25
                is_open &= value_at(elevation, stretch.cell, 0.0) <= z
            if not slivers:
                expected = is_open and bearing < 1.0 and distance < 4.0
                expected &= value_at(world, cell, -1.0) >= 0.0
                assert bool(answer) == expected
                counts[expected] += 1
    assert min(counts.values()) > 200


def test_a_steep_hill_is_no_obstacle_though_noise_moves_its_readings() -> None:
    elevation = np.zeros((60, 60), np.float32)
    elevation[:, 40:] = 2.0
    elevation[:, 42:] = 0.0  # a ridge, thinner than the noise
    world = np.zeros((60, 60), np.float32)
    world[:20, 30] = 1.0
    grid, ground = OccupancyGrid(world, 0.1), Ground(elevation, 0.1)
    lidar, pose = Lidar(240, 4.0), jnp.asarray([2.05, 3.05, 0.0])

    @jax.jit
    def watch(keys: jax.Array) -> jax.Array:
        def step(belief, key):
            scan = lidar.scan(grid, pose, key=key, ground=ground)
            belief = lidar.update(belief, scan, pose, MODEL, ground)
            return belief, belief.probability

        return jax.lax.scan(step, OccupancyGrid.unknown(grid.shape, grid.frame), keys)[1]

    seen = np.asarray(watch(jax.random.split(jax.random.key(2), 50)))
    assert (seen[:, :, 40:] == 0.5).all()  # neither the ridge nor what is behind
    assert (seen[:, 25:, 31:40] > 0.5).mean() < 2e-3
    assert (seen[5:, 25:36, 31:38] < 0.25).all()
    assert (seen[5:, 8:19, 30] > 0.65).mean() > 0.98  # and the wall is still one


# Among things that move

moving_jit = jax.jit(
    lambda lidar, world, pose, movers: lidar.scan(world, pose, key=jax.random.key(0), movers=movers)
)
BARE = OccupancyGrid(np.zeros((20, 25), np.float32), RESOLUTION)
MIDDLE = jnp.asarray([2.1, 2.1, 0.0])


@pytest.mark.parametrize(
    ("disc", "expected"),
    [
        ((2.0, 0.0, 0.5), 1.5),
        ((2.0, 0.3, 0.5), 2.0 - 0.4),
        ((0.0, 0.0, 0.3), 0.0),
        ((0.25, 0.0, 0.3), 0.0),
        ((-0.25, 0.0, 0.3), 0.0),
        ((-1.0, 0.0, 0.5), None),  # behind
        ((2.0, 0.55, 0.5), None),  # beside
        ((3.4, 0.0, 0.5), None),  # out of reach
        ((2.0, 0.0, 0.0), None),
        ((2.0, 0.0, -0.5), None),
        ((math.nan, 0.0, 0.5), None),
        ((2.0, 0.0, math.nan), None),
    ],
)
def test_a_disc_ends_a_beam_where_it_enters(disc: tuple, expected: float | None) -> None:
    discs = np.zeros((6, 3), np.float32)  # five have no extent
    discs[2] = np.add(disc, (2.1, 2.1, 0.0))
    scan = moving_jit(LIDAR, BARE, MIDDLE, jnp.asarray(discs))
    assert not scan.is_return[12]  # straight ahead
    assert float(scan.ranges[12]) == pytest.approx(2.5 if expected is None else expected, abs=1e-5)


def test_scans_among_discs_equal_a_march_in_small_steps() -> None:
    step = 2e-4
    along = np.arange(0.0, 2.5, step)
    num_movers = num_walls = 0
    for seed in range(12):
        world, pose = random_world(seed)
        rng = np.random.default_rng(seed)
        discs = np.concatenate(
            [pose[:2] + rng.uniform(-1.5, 1.5, (6, 2)), rng.uniform(0.1, 0.4, (6, 1))], axis=1
        ).astype(np.float32)
        grid = OccupancyGrid(world, RESOLUTION, ORIGIN)
        pose = pose.astype(np.float32)
        scan = moving_jit(LIDAR, grid, jnp.asarray(pose), jnp.asarray(discs))
        plain = scan_jit(LIDAR, grid, jnp.asarray(pose), jax.random.key(0))
        for beam, angle in enumerate(pose[2].astype(float) + LIDAR.beam_angles.astype(float)):
            points = pose[:2] + along[:, None] * np.array([math.cos(angle), math.sin(angle)])
            inside = np.linalg.norm(points[:, None] - discs[:, :2], axis=-1) <= discs[:, 2]
            first = along[inside.any(axis=1).argmax()] if inside.any() else math.inf
            wall = float(plain.ranges[beam])
            if abs(first - wall) < 2 * step:
                continue
            assert float(scan.ranges[beam]) == pytest.approx(min(first, wall), abs=2 * step)
            assert bool(scan.is_return[beam]) == (bool(plain.is_return[beam]) and wall < first)
            num_movers, num_walls = num_movers + (first < wall), num_walls + (first > wall)
    assert min(num_movers, num_walls) > 50


def test_what_moves_is_not_marked_and_what_is_before_it_is_free() -> None:
    lidar, grid = Lidar(180, 2.5, 1.0, 0.02), OccupancyGrid(np.zeros((80, 80), np.float32), 0.1)
    pose, disc = jnp.asarray([4.05, 4.05, 0.0]), jnp.asarray([[5.55, 4.05, 0.4]])
    scan = moving_jit(lidar, grid, pose, disc)
    belief = OccupancyGrid.unknown(grid.shape, grid.frame)
    found = np.asarray(update_jit(lidar, belief, scan, pose).probability)
    assert found.max() == 0.5
    assert (found[40, 41:50] < 0.25).all()
    assert (found[38:43, 54:] == 0.5).all()  # the disc and its shadow
    # Beside it nothing stands in the way: at 2 m the view is 1 m to either side.
    assert (found[48, 57:59] < 0.25).all()


def test_no_movers_are_as_none_at_all() -> None:
    world, pose = random_world(11)
    grid, pose = OccupancyGrid(world, RESOLUTION, ORIGIN), jnp.asarray(pose, jnp.float32)
    lidar = Lidar(24, 2.5)
    plain = scan_jit(lidar, grid, pose, jax.random.key(0))
    found = moving_jit(lidar, grid, pose, jnp.zeros((0, 3)))
    np.testing.assert_array_equal(found.ranges, plain.ranges)
    np.testing.assert_array_equal(found.is_return, plain.is_return)
