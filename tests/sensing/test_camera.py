import dataclasses
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxplore import Camera, InverseSensorModel, Lidar, OccupancyGrid
from jaxplore.maps.ground import Ground
from jaxplore.sensing.base import Sighting, update_grid
from jaxplore.sensing.beams import Scan

pytestmark = pytest.mark.long

REACH, VIEW, VERTICAL, HEIGHT, TILT = 4.0, 1.2, 0.9, 0.5, -0.15
CAMERA = Camera(24, REACH, VIEW, VERTICAL, HEIGHT, TILT)
BOTTOM, TOP = TILT - VERTICAL / 2, TILT + VERTICAL / 2
MODEL = InverseSensorModel()
PLACES, POINTS, UNSURE = 40, 40, 1e-4


class Column(NamedTuple):
    """What one column shows: of each cell, whether it is seen; where rounding decides, neither."""

    seen: list
    doubtful: list
    end: float
    is_hit: bool
    is_sure: bool


def look(stretches, world, elevation, eye, value_at, last=None) -> Column:
    """Go along a ray and keep the horizon, as the definition says, in angles."""
    seen, doubtful, horizon = [], [], -math.pi / 2
    for stretch in stretches:
        height = value_at(elevation, stretch.cell, 0.0) - eye
        angle = math.atan2(height, 0.5 * (stretch.entry + stretch.exit))
        is_solid = value_at(world, stretch.cell, 1.0) >= 0.25
        if stretch.is_sliver:
            doubtful.append(stretch.cell)
            if is_solid or angle > horizon - UNSURE:
                return Column(seen, doubtful, stretch.entry, False, False)
            continue
        top = max(angle, horizon)
        if is_solid:
            sure = abs(top - TOP) > UNSURE
            (seen if top < TOP else []).append(stretch)
            return Column(seen, doubtful, stretch.entry, top < TOP, sure)
        if min(abs(angle - edge) for edge in (BOTTOM, TOP, horizon)) < UNSURE:
            doubtful.append(stretch.cell)
        elif BOTTOM <= angle <= TOP and angle >= horizon:
            seen.append(stretch)
        horizon = top
        if stretch.cell == last:
            break
    return Column(seen, doubtful, REACH, False, True)


@pytest.fixture(scope="module")
def observed(place, observed_from):
    places = [place(seed, 1.2) for seed in range(PLACES)]
    return observed_from(CAMERA, places, POINTS, 99, 0.7, 0.2)


def test_columns_on_hills_equal_a_walk_along_each(observed, crossed, standing, value_at) -> None:
    places, _, (scans, sightings, _) = observed
    num_hits = num_passes = 0
    for index, (world, elevation, pose) in enumerate(places):
        eye = value_at(elevation, standing(pose), 0.0) + HEIGHT
        hits, passes, unsure = (np.zeros(world.shape, int) for _ in range(3))

        def count(into, cell):
            if 0 <= cell[0] < into.shape[0] and 0 <= cell[1] < into.shape[1]:
                into[cell] += 1

        for beam, angle in enumerate(pose[2].astype(float) + np.linspace(-VIEW / 2, VIEW / 2, 24)):
            stretches = list(crossed(pose, angle, REACH))
            column = look(stretches, world, elevation, eye, value_at)
            if not column.is_sure:
                for stretch in stretches:
                    if stretch.entry > column.end - 1e-6:
                        count(unsure, stretch.cell)
            elif column.is_hit and column.end < REACH - 1e-3:
                assert scans.is_return[index, beam]
                assert scans.ranges[index, beam] == pytest.approx(column.end, abs=1e-3)
            elif not column.is_hit:
                assert not scans.is_return[index, beam]
                assert scans.ranges[index, beam] == np.float32(REACH)
            for cell in column.doubtful:
                count(unsure, cell)
            for stretch in column.seen:
                if abs(stretch.exit - REACH) < 1e-3 or abs(stretch.entry - REACH) < 1e-3:
                    count(unsure, stretch.cell)
                elif value_at(world, stretch.cell, 1.0) >= 0.25:
                    count(hits, stretch.cell)
                elif stretch.exit < REACH:
                    count(passes, stretch.cell)
        sure = unsure == 0
        np.testing.assert_array_equal(sightings.hits[index][sure], hits[sure])
        np.testing.assert_array_equal(sightings.passes[index][sure], passes[sure])
        assert (~sure).sum() < 40
        num_hits, num_passes = num_hits + hits[sure].sum(), num_passes + passes[sure].sum()
    assert num_hits > 50
    assert num_passes > 2000


def test_sees_equals_a_walk_to_the_point(observed, crossed, standing, value_at) -> None:
    places, points, (_, _, found) = observed
    counts = {True: 0, False: 0}
    for (world, elevation, pose), targets, answers in zip(places, points, found, strict=True):
        eye = value_at(elevation, standing(pose), 0.0) + HEIGHT
        for target, answer in zip(targets, answers, strict=True):
            offset = target.astype(float) - pose[:2]
            angle, distance = math.atan2(offset[1], offset[0]), math.hypot(*offset)
            bearing = (angle - float(pose[2]) + math.pi) % (2 * math.pi) - math.pi
            cell = standing(target)
            column = look(crossed(pose, angle, distance + 1), world, elevation, eye, value_at, cell)
            edges = (abs(abs(bearing) - VIEW / 2), abs(distance - REACH))
            if not column.is_sure or cell in column.doubtful or min(edges) < 1e-4:
                continue
            inside = 0 <= cell[0] < world.shape[0] and 0 <= cell[1] < world.shape[1]
            in_view = abs(bearing) < VIEW / 2 and distance < REACH
            expected = inside and in_view and cell in [stretch.cell for stretch in column.seen]
            assert bool(answer) == expected
            counts[expected] += 1
    assert min(counts.values()) > 200


# Along a corridor: one row of cells, the camera at (0.95, 0.25) looking along it.

RES, LEVEL = 0.1, Camera(1, 8.0, 0.1, 0.8, 1.0, -0.1)
AHEAD = np.array([0.95, 0.25, 0.0], np.float32)
line_scan = jax.jit(
    lambda camera, world, pose, ground: camera.scan(
        world, pose, key=jax.random.key(0), ground=ground
    )
)
line_sight = jax.jit(
    lambda camera, world, scan, pose, ground: camera.sight(world, scan, pose, ground)
)
line_sees = jax.jit(
    lambda camera, world, pose, points, ground: camera.sees(world, pose, points, ground)
)
line_update = jax.jit(lambda camera, belief, scan, pose: camera.update(belief, scan, pose, MODEL))


def corridor(wall: float | None = None, height: float | None = None, at: float = 4.0):
    """A free strip 10 m long, with a wall from x on, and a ridge 0.5 m wide."""
    world, elevation = np.zeros((5, 100), np.float32), np.zeros((5, 100), np.float32)
    if wall is not None:
        world[:, round(wall / RES) :] = 1.0
    if height is not None:
        elevation[:, round(at / RES) : round(at / RES) + 5] = height
    return OccupancyGrid(world, RES), Ground(elevation, RES)


def row_of(camera: Camera, grid: OccupancyGrid, ground: Ground | None) -> tuple[Scan, Sighting]:
    scan = line_scan(camera, grid, AHEAD, ground)
    sighting = line_sight(camera, grid, scan, AHEAD, ground)
    counts = (sighting.on_map(each)[2] for each in (sighting.hits, sighting.passes))
    return jax.device_get((scan, Sighting(*counts, sighting.window)))


def middles() -> np.ndarray:
    """Distance of the middle of each cell of the row, as the ray crosses it."""
    return (np.arange(100) + 0.5) * RES - 0.95


@pytest.mark.parametrize(("height", "tilt"), [(1.0, -0.1), (0.5, -0.3), (1.5, 0.05)])
@pytest.mark.parametrize("is_given", [False, True])
def test_level_ground_is_seen_from_the_closed_form_on(height, tilt, is_given) -> None:
    camera = Camera(1, 8.0, 0.1, 0.8, height, tilt)
    grid, ground = corridor()
    scan, sighting = row_of(camera, grid, ground if is_given else None)
    assert not scan.is_return[0]
    nearest = height / math.tan(0.4 - tilt)
    farthest = height / math.tan(-tilt - 0.4) if tilt < -0.4 else 8.0
    expected = (middles() >= nearest) & (middles() + RES / 2 <= farthest + 1e-4)
    np.testing.assert_array_equal(sighting.passes, expected)
    assert expected.sum() > 20


def test_a_view_below_the_horizon_ends_on_the_ground() -> None:
    camera = Camera(1, 8.0, 0.1, 0.2, 1.0, -0.5)
    _, sighting = row_of(camera, *corridor())
    nearest, farthest = 1.0 / math.tan(0.6), 1.0 / math.tan(0.4)
    np.testing.assert_array_equal(sighting.passes, (middles() >= nearest) & (middles() <= farthest))


def test_what_a_hill_hides_is_unseen_and_a_wall_is_seen_above_it() -> None:
    grid, ground = corridor(wall=7.0, height=1.3)
    scan, sighting = row_of(LEVEL, grid, ground)
    # The ridge is 0.3 m above the camera; its first cell hides everything but the wall.
    assert scan.ranges[0] == pytest.approx(7.0 - 0.95, abs=1e-4)
    assert scan.is_return[0]
    expected = (middles() >= 1.0 / math.tan(0.5)) & (np.arange(100) <= 40)
    np.testing.assert_array_equal(sighting.passes, expected)
    np.testing.assert_array_equal(np.flatnonzero(sighting.hits), [70])
    points = jnp.asarray([[3.5, 0.25], [4.05, 0.25], [4.2, 0.25], [5.5, 0.25], [7.05, 0.25]])
    seen = line_sees(LEVEL, grid, AHEAD, points, ground)
    np.testing.assert_array_equal(seen, [True, True, False, False, True])


def test_a_hill_above_the_view_hides_the_wall_too() -> None:
    # At 3.1 m the upper edge of the view, 0.3 rad, is 0.96 m above the camera.
    grid, ground = corridor(wall=7.0, height=2.1)
    scan, sighting = row_of(LEVEL, grid, ground)
    assert not scan.is_return[0]
    assert scan.ranges[0] == 8.0
    assert sighting.hits.sum() == 0
    assert sighting.passes[40:].sum() == 0
    assert sighting.passes[39] == 1
    # Nor is what stands on it, and a reading from behind it is no wall.
    scan, _ = row_of(LEVEL, *corridor(wall=4.0, height=2.1))
    assert not scan.is_return[0]
    behind = Scan(jnp.asarray([7.0 - 0.95]), jnp.asarray([True]))
    assert not line_sight(LEVEL, grid, behind, AHEAD, ground).hits.any()


def test_a_camera_on_a_hill_looks_over_a_lower_one() -> None:
    grid, ground = corridor(height=0.4)
    _, low = row_of(LEVEL, grid, ground)
    shadow = (0.6 / 1.0) ** -1 * (4.5 - 0.05 - 0.95)  # behind it, the sight line over its far edge
    dark = (middles() > 4.5 - 0.95) & (middles() < shadow - 0.05)
    assert low.passes[dark].sum() == 0
    assert low.passes[(middles() > shadow + 0.05) & (middles() < 7.9)].all()
    raised = np.asarray(ground.elevation).copy()
    raised[:, :12] = 5.0
    _, high = row_of(LEVEL, grid, Ground(raised, RES))
    assert high.passes.sum() == 0  # 6 m above the ground everything is below the view's edge


def test_a_belief_learns_what_is_seen_and_nothing_behind() -> None:
    grid, _ = corridor(wall=5.0)
    scan = line_scan(LEVEL, grid, AHEAD, None)
    belief = OccupancyGrid.unknown(grid.shape, grid.frame)
    found = np.asarray(line_update(LEVEL, belief, scan, AHEAD).probability)[2]
    seen = (middles() >= 1.0 / math.tan(0.5)) & (np.arange(100) < 50)
    np.testing.assert_allclose(found[seen], 1 / (1 + math.exp(2.0)), rtol=1e-5)
    assert found[50] == pytest.approx(1 / (1 + math.exp(-2.0)), rel=1e-5)
    assert (found[51:] == 0.5).all()
    assert (found[~seen & (np.arange(100) < 50)] == 0.5).all()


def test_movers_block_columns_and_are_not_marked() -> None:
    grid, ground = corridor(wall=7.0, height=2.6, at=5.0)
    scan = jax.jit(
        lambda movers, ground: LEVEL.scan(
            grid, jnp.asarray(AHEAD), key=jax.random.key(0), ground=ground, movers=movers
        )
    )
    disc = jnp.asarray([[4.0, 0.3, 0.2]])
    for given in (None, ground):
        found = scan(disc, given)
        expected = 4.0 - 0.95 - math.sqrt(0.2**2 - 0.05**2)
        assert float(found.ranges[0]) == pytest.approx(expected, abs=1e-4)
        assert not found.is_return[0]
    sighting = line_sight(LEVEL, grid, found, AHEAD, ground)
    assert sighting.hits.sum() == 0
    last = np.flatnonzero(np.asarray(sighting.passes)[2]).max()
    assert last == math.floor((0.95 + expected) / RES) - 1
    # Behind the hill that is higher than the view it is not seen.
    hidden = scan(disc + jnp.asarray([2.0, 0.0, 0.0]), ground)
    assert hidden.ranges[0] == 8.0
    in_front_of_the_wall = scan(disc + jnp.asarray([2.0, 0.0, 0.0]), None)
    assert float(in_front_of_the_wall.ranges[0]) == pytest.approx(expected + 2.0, abs=1e-4)


def test_two_sensors_see_the_union_in_any_order(place, frame) -> None:
    world, elevation, pose = place(5, 0.8)
    grid, ground = OccupancyGrid(world, *frame), Ground(elevation, *frame)
    lidar = Lidar(60, 3.0, 2.0, 0.0)
    first = jnp.asarray(pose)
    key = jax.random.key(0)

    @jax.jit
    def both(belief: OccupancyGrid, second: jax.Array):
        one = lidar.sight(belief, lidar.scan(grid, first, key=key, ground=ground), first, ground)
        two = CAMERA.sight(
            belief, CAMERA.scan(grid, second, key=key, ground=ground), second, ground
        )
        after = update_grid(update_grid(belief, one, MODEL), two, MODEL)
        other = update_grid(update_grid(belief, two, MODEL), one, MODEL)
        return one.is_seen, two.is_seen, after.probability, other.probability

    for turn in (0.0, math.pi):
        second = jnp.asarray(np.asarray(pose) + np.float32([0.0, 0.0, turn]))
        unknown = OccupancyGrid.unknown(grid.shape, grid.frame)
        one, two, after, other = jax.device_get(both(unknown, second))
        assert min(one.sum(), two.sum()) > 10
        if turn:
            assert not (one & two).any()
            np.testing.assert_array_equal(after, other)
            np.testing.assert_array_equal(after != 0.5, one | two)
        else:
            assert (one & two).any()
            np.testing.assert_array_equal((after != 0.5) & ~(one & two), one ^ two)
            np.testing.assert_allclose(after, other, atol=1e-5)


def test_noise_moves_the_reading_and_not_the_wall() -> None:
    world = np.zeros((60, 60), np.float32)
    world[:, 40:] = 1.0
    grid = OccupancyGrid(world, RES)
    camera = Camera(61, 5.0, range_noise=0.02)
    pose = jnp.asarray([1.05, 3.05, 0.0])

    @jax.jit
    def watch(keys: jax.Array) -> tuple[jax.Array, jax.Array]:
        def step(belief, key):
            scan = camera.scan(grid, pose, key=key)
            return camera.update(belief, scan, pose, MODEL), scan.ranges

        belief, ranges = jax.lax.scan(step, OccupancyGrid.unknown(grid.shape, grid.frame), keys)
        return belief.probability, ranges

    probability, ranges = jax.device_get(watch(jax.random.split(jax.random.key(3), 40)))
    assert ranges.std(axis=0).mean() == pytest.approx(0.02, rel=0.1)
    assert (probability[20:40, 40] > 0.65).all()
    assert (probability[20:40, 35:39] < 0.25).all()
    assert (probability[:, 42:] == 0.5).all()


def test_changing_the_view_does_not_recompile() -> None:
    grid, ground = corridor(wall=7.0)
    line_scan(LEVEL, grid, AHEAD, ground)
    before = line_scan._cache_size()
    moved = dataclasses.replace(LEVEL, tilt=jnp.asarray(-0.2), height=jnp.asarray(0.4))
    line_scan(moved, grid, AHEAD, Ground(np.ones((5, 100)), RES))
    assert line_scan._cache_size() == before


def test_a_pose_that_is_not_a_number_sees_nothing() -> None:
    grid, ground = corridor(wall=7.0)
    pose = np.full(3, np.nan, np.float32)
    scan = line_scan(LEVEL, grid, pose, ground)
    assert not scan.is_return.any()
    assert (scan.ranges == 8.0).all()
    assert not line_sight(LEVEL, grid, scan, pose, ground).is_seen.any()
    assert not line_sees(LEVEL, grid, pose, jnp.ones((5, 2)), ground).any()


@pytest.mark.parametrize("sensor", [Camera(3, 2.0), Lidar(3, 2.0)])
def test_a_ground_of_another_map_is_refused(sensor: Camera | Lidar) -> None:
    grid, _ = corridor()
    pose, scan = jnp.asarray(AHEAD), Scan(jnp.ones(3), jnp.ones(3, bool))
    for ground in (Ground(np.zeros((5, 99)), RES), Ground(np.zeros((5, 100)), 0.2)):
        for use in (
            lambda ground: sensor.scan(grid, pose, key=jax.random.key(0), ground=ground),
            lambda ground: sensor.sight(grid, scan, pose, ground),
            lambda ground: sensor.update(grid, scan, pose, MODEL, ground),
            lambda ground: sensor.sees(grid, pose, jnp.ones((1, 2)), ground),
        ):
            with pytest.raises(ValueError, match=r"ground has \(5, .*accepted: those of the map"):
                jax.eval_shape(use, ground)


def test_defaults_are_a_forward_camera() -> None:
    camera = Camera()
    assert (camera.num_beams, camera.max_range) == (61, 20.0)
    np.testing.assert_allclose(camera.beam_angles[[0, -1]], [-math.pi / 6, math.pi / 6], rtol=1e-6)
    assert float(camera.vertical_view) == pytest.approx(math.pi / 4)
    assert (float(camera.height), float(camera.tilt)) == (1.0, pytest.approx(-0.1))
