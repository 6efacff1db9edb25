"""Signed distances of surfaces: against walls whose distance is known."""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore.localisation import EndPoints, SurfaceMap
from jaxplore.localisation.surface import AHEAD, BEHIND, MOST_WEIGHT
from jaxplore.maps.frame import GridFrame
from jaxplore.sensing import Lidar, Scan

SIDE = 0.1
SHAPE = (48, 56)
FAN = Lidar(121, max_range=6.0, field_of_view=math.radians(120.0))
CIRCLE = Lidar(180, max_range=8.0)
ORIGIN = jnp.zeros(3)
WAY = jnp.zeros(())
MEMORY = jnp.asarray(5.0)

end_points = eqx.filter_jit(EndPoints.of)
with_scan = eqx.filter_jit(lambda surface, pose, ends, way: surface.with_scan(pose, ends, way))


@eqx.filter_jit
def looked_up(
    surface: SurfaceMap, points: jax.Array, way: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    return jax.vmap(surface.at, (0, None))(points, way)


def empty(origin: tuple[float, float, float] = (-2.8, -2.4, 0.0)) -> SurfaceMap:
    return SurfaceMap.empty(GridFrame(SIDE, origin), SHAPE, MEMORY)


def long_wall(distance: float, angle: float) -> np.ndarray:
    """Return a wall across a direction at a distance, which the sensor at the origin faces."""
    normal = np.array([math.cos(angle), math.sin(angle)])
    along = 20.0 * np.array([-normal[1], normal[0]])
    return np.array([[distance * normal - along, distance * normal + along]])


@settings(max_examples=25)
@given(st.floats(0.9, 1.6), st.floats(-1.0, 1.0), st.floats(-math.pi, math.pi))
def test_distances_of_a_straight_wall_are_true(
    scan_of: Callable[..., Scan], distance: float, slant: float, yaw: float
) -> None:
    """At any angle to the cells and to the sensor, in a map that is turned."""
    frame = (-2.8 * math.cos(0.3) + 2.4 * math.sin(0.3), -2.8 * math.sin(0.3) - 2.0, 0.3)
    pose = jnp.array([0.03, -0.05, yaw], jnp.float32)
    walls = long_wall(distance, yaw + slant)
    ends = end_points(FAN, scan_of(walls, pose, FAN))
    surface = with_scan(empty(frame), pose, ends, WAY)
    normal = np.array([math.cos(yaw + slant), math.sin(yaw + slant)])
    along = np.array([-normal[1], normal[0]])
    # Points within a cell of the wall, to the side of the foot of the perpendicular where beams
    # are dense.
    t, s = np.meshgrid(np.linspace(-0.3, 0.3, 21), np.linspace(-0.4, 1.2, 9) * SIDE)
    # The sensor's foot on the wall, and from there along it.
    foot = np.asarray(pose[:2], float)
    foot = foot + (distance - foot @ normal) * normal
    points = foot + t.reshape(-1, 1) * along - s.reshape(-1, 1) * normal
    is_on = abs(slant) < 0.75
    found, slope, is_known = looked_up(surface, jnp.asarray(points, jnp.float32), WAY)
    is_known = np.asarray(is_known)
    if is_on:
        assert is_known.mean() > 0.8
    # A hundredth of a cell.
    np.testing.assert_allclose(
        np.asarray(found)[is_known], s.reshape(-1)[is_known], atol=0.01 * SIDE
    )
    expected = np.broadcast_to(-normal, (is_known.sum(), 2))
    np.testing.assert_allclose(np.asarray(slope)[is_known], expected, atol=0.01)


SPARSE = Lidar(31, max_range=6.0, field_of_view=math.radians(120.0))
filled = eqx.filter_jit(lambda ends, number: ends.fill(number, is_full_circle=False))


def test_between_beams_of_one_surface_it_is_written_too(scan_of: Callable[..., Scan]) -> None:
    """Beams 4 degrees apart leave gaps of two cells in a wall, and none across an opening."""
    walls = np.array([[[2.4, -2.0], [2.4, -0.3]], [[2.4, 0.3], [2.4, 2.0]]])
    scan = scan_of(walls, ORIGIN, SPARSE)
    ends = end_points(SPARSE, scan)
    frame = GridFrame(0.05, (1.8, -1.6, 0.0))
    t = np.linspace(-1.2, 1.2, 97)
    points = jnp.asarray(np.stack([np.full(97, 2.39), t], axis=1), jnp.float32)
    is_wall = np.abs(t) > 0.55
    known = {}
    for number in (1, 4):
        surface = SurfaceMap.empty(frame, (64, 32), MEMORY)
        surface = with_scan(surface, ORIGIN, filled(ends, number), WAY)
        found, _, is_known = looked_up(surface, points, WAY)
        known[number] = np.asarray(is_known)
        np.testing.assert_allclose(np.asarray(found)[known[number]], 0.01, atol=1e-3)
    assert known[1][is_wall].mean() < 0.5
    assert known[4][is_wall].all()
    assert not known[4][np.abs(t) < 0.2].any()


def test_lines_of_noisy_ranges_are_longer(scan_of: Callable[..., Scan]) -> None:
    """Noise of 4 cm: as usual half of the points of a wall are on a line, with the noise said
    nearly all are, and their normals are better."""
    normal = np.array([math.cos(0.2), math.sin(0.2)])
    shares, errors = [], []
    for noise in (0.015, 0.04):
        flat, away = [], []
        for seed in range(10):
            scan = scan_of(long_wall(2.0, 0.2), ORIGIN, FAN, 0.04, seed)
            ends = end_points(FAN, scan, noise)
            flat.append(np.asarray(ends.is_flat))
            away.append(1.0 + np.asarray(ends.normals, float) @ normal)
        shares.append(np.mean(flat))
        errors.append(np.sqrt(2.0 * np.mean(np.concatenate(away)[np.concatenate(flat)])))
    assert shares[0] < 0.6
    assert shares[1] > 0.95
    assert errors[1] < 0.6 * errors[0]


def test_a_wall_is_where_noisy_scans_have_it_on_average(scan_of: Callable[..., Scan]) -> None:
    """Forty scans with noise of a fifth of a cell: the wall is known to less than a tenth of it,
    and does not grow thicker."""
    noise, number, distance = 0.02, 40, 1.234
    walls = long_wall(distance, 0.2)
    surface = empty()
    for seed in range(number):
        ends = end_points(FAN, scan_of(walls, ORIGIN, FAN, noise, seed))
        surface = with_scan(surface, ORIGIN, ends, WAY)
    normal = np.array([math.cos(0.2), math.sin(0.2)])
    t = np.linspace(-0.5, 0.5, 41)
    points = distance * normal + t[:, None] * np.array([-normal[1], normal[0]])
    found, _, is_known = looked_up(surface, jnp.asarray(points, jnp.float32), WAY)
    assert bool(is_known.all())
    error = np.asarray(found, float)
    assert abs(error.mean()) < 0.1 * noise
    assert error.std() < 0.4 * noise


def test_a_distance_is_the_weighted_mean_of_those_of_scans() -> None:
    """Two scans of one flat point each, of walls 6 cm apart, in cells on its normal."""

    def ends_at(x: float) -> EndPoints:
        point = jnp.array([[x, 0.05]], jnp.float32)
        yes = jnp.ones(1, bool)
        return EndPoints(point, point, jnp.array([[-1.0, 0.0]]), yes, yes, jnp.zeros(1))

    surface = empty((0.0, 0.0, 0.0))
    first = with_scan(surface, ORIGIN, ends_at(1.02), WAY)
    both = with_scan(first, ORIGIN, ends_at(1.08), WAY)
    # Columns of cells with centres at 0.85 m ... 0.95 m are before both walls at full weight.
    x = (np.arange(SHAPE[1]) + 0.5) * SIDE
    for column in (9, 10):
        one = float(first.sums[0, column] / first.weights[0, column])
        assert one == pytest.approx(1.02 - x[column], abs=1e-5)
        mean = float(both.sums[0, column] / both.weights[0, column])
        weights = np.array([first.weights[0, column], both.weights[0, column]])
        expected = (weights[0] * (1.02 - x[column]) + np.diff(weights)[0] * (1.08 - x[column])) / (
            weights[1]
        )
        assert mean == pytest.approx(float(expected), abs=1e-5)
    known = np.flatnonzero(np.asarray(first.weights[0]) > 0.0)
    away = 1.02 - x[known]
    assert away.min() > -BEHIND * SIDE
    assert away.max() < AHEAD * SIDE
    assert not np.asarray(first.weights[1:]).any()


def test_the_weight_of_a_cell_is_bounded(scan_of: Callable[..., Scan]) -> None:
    """After hundreds of scans of a wall that has moved, the map follows."""
    add = eqx.filter_jit(
        lambda surface, ends, number: jax.lax.fori_loop(
            0, number, lambda _, each: each.with_scan(ORIGIN, ends, WAY), surface
        )
    )
    surface = empty()
    for distance, number in ((1.20, 300), (1.25, 100)):
        ends = end_points(FAN, scan_of(long_wall(distance, 0.0), ORIGIN, FAN))
        surface = add(surface, ends, jnp.asarray(number))
    heaviest = float(surface.weights.max())
    # A scan can add the weight of all points that share a cell.
    assert MOST_WEIGHT <= heaviest < MOST_WEIGHT + 20.0
    value, _, is_known = surface.at(jnp.array([1.25, 0.0]), WAY)
    assert bool(is_known)
    assert abs(float(value)) < 0.005


def test_stale_cells_do_not_count_and_are_written_anew(scan_of: Callable[..., Scan]) -> None:
    at = jnp.array([[1.2, 0.0]])
    old = end_points(FAN, scan_of(long_wall(1.2, 0.0), ORIGIN, FAN))
    new = end_points(FAN, scan_of(long_wall(1.26, 0.0), ORIGIN, FAN))
    surface = with_scan(empty(), ORIGIN, old, jnp.asarray(1.0))
    for way, is_fresh in ((5.9, True), (6.1, False)):
        _, _, is_known = looked_up(surface, at, jnp.asarray(way))
        assert bool(is_known[0]) == is_fresh
        assert bool(surface.is_known(jnp.asarray(way)).any()) == is_fresh
        cell = surface.frame.to_cell(at[0])
        nearest = float(surface.nearest(cell, jnp.asarray(way)))
        assert (nearest < surface.band) == is_fresh
    # Within the memory both walls count, after it the new one alone.
    mixed = with_scan(surface, ORIGIN, new, jnp.asarray(5.9))
    fresh = with_scan(surface, ORIGIN, new, jnp.asarray(6.1))
    for made, expected in ((mixed, 0.03), (fresh, 0.06)):
        found, _, is_known = looked_up(made, at, jnp.asarray(6.1))
        assert bool(is_known[0])
        assert float(found[0]) == pytest.approx(expected, abs=0.003)


def test_off_the_map_nothing_is_known_or_written(scan_of: Callable[..., Scan]) -> None:
    ends = end_points(FAN, scan_of(long_wall(2.75, 0.0), ORIGIN, FAN))
    surface = with_scan(empty(), ORIGIN, ends, WAY)
    # The map ends at x = 2.8; the wall continues beyond it at the sides. No row wraps around.
    columns = np.flatnonzero(np.asarray(surface.weights).any(axis=0))
    assert columns.min() >= SHAPE[1] - 1 - (AHEAD + 1)
    far = jnp.array([[2.76, 0.0], [9.0, 9.0], [-2.79, 0.0], [math.nan, 0.0]])
    found, slope, is_known = looked_up(surface, far, WAY)
    assert not np.asarray(is_known).any()
    assert np.all(np.asarray(found) == 0.0)
    assert np.all(np.asarray(slope) == 0.0)
    for cell in ((-1, 3), (3, -1), (SHAPE[0], 3), (3, SHAPE[1])):
        assert float(surface.nearest(jnp.array(cell), WAY)) == pytest.approx(surface.band)
    outside = with_scan(empty(), jnp.array([50.0, 0.0, 0.0]), ends, WAY)
    assert not np.asarray(outside.weights).any()


@pytest.mark.parametrize("sensor", [FAN, CIRCLE])
def test_normals_of_end_points_are_those_of_walls(
    scan_of: Callable[..., Scan], room: np.ndarray, sensor: Lidar
) -> None:
    pose = np.array([-1.0, 0.2, 0.4])
    ends = end_points(sensor, scan_of(room, pose, sensor))
    points = (
        np.asarray(ends.points, float)
        @ np.array([[math.cos(0.4), math.sin(0.4)], [-math.sin(0.4), math.cos(0.4)]])
        + pose[:2]
    )
    start, along = room[:, 0], room[:, 1] - room[:, 0]
    length = np.linalg.norm(along, axis=1)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / length[:, None]
    from_start = points[:, None] - start
    away = np.abs((from_start * across).sum(axis=-1))
    share = (from_start * along).sum(axis=-1) / length**2
    beyond = np.maximum(np.maximum(-share, share - 1.0), 0.0) * length
    wall = (away + beyond).argmin(axis=1)
    # Away from corners all neighbours are on one wall.
    inside = np.minimum(share, 1.0 - share)[np.arange(len(wall)), wall] * length[wall]
    is_clear = np.asarray(ends.is_point) & (inside > 0.9)
    assert is_clear.sum() > 20
    turned = across[wall]
    normals = np.asarray(ends.normals, float) @ np.array(
        [[math.cos(0.4), math.sin(0.4)], [-math.sin(0.4), math.cos(0.4)]]
    )
    assert np.asarray(ends.is_flat)[is_clear].all()
    np.testing.assert_allclose(np.abs((normals * turned).sum(axis=1))[is_clear], 1.0, atol=1e-5)
    # They point to the sensor, are of length 1, and the anchors are on the walls.
    assert ((normals * (pose[:2] - points)).sum(axis=1) > 0.0)[is_clear].all()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-5)
    offset = ((np.asarray(ends.anchors) - np.asarray(ends.points)) * np.asarray(ends.normals)).sum(
        axis=1
    )
    np.testing.assert_allclose(offset[is_clear], 0.0, atol=1e-4)


def test_the_first_beam_and_the_last_are_neighbours_only_on_a_circle() -> None:
    """Three points beside the gap of the fan: a line only with those on its other side."""
    for view, is_flat in ((2.0 * math.pi, True), (math.radians(355.0), False)):
        sensor = Lidar(72, max_range=4.0, field_of_view=view)
        angles = np.asarray(sensor.beam_angles, float)
        # The wall x = -1, seen by one beam before the gap and two behind it.
        is_return = np.zeros(72, bool)
        is_return[[0, 1, 71]] = True
        ranges = np.where(is_return, -1.0 / np.cos(angles), 4.0)
        ends = end_points(sensor, Scan(jnp.asarray(ranges, jnp.float32), jnp.asarray(is_return)))
        assert bool(ends.is_flat[0]) == is_flat
        assert bool(ends.is_flat[71]) == is_flat


def test_a_scan_without_returns_changes_nothing(scan_of: Callable[..., Scan]) -> None:
    seen = with_scan(
        empty(), ORIGIN, end_points(FAN, scan_of(long_wall(1.2, 0.0), ORIGIN, FAN)), WAY
    )
    nothing = end_points(FAN, scan_of(long_wall(50.0, 0.0), ORIGIN, FAN))
    assert not np.asarray(nothing.is_point).any()
    after = with_scan(seen, ORIGIN, nothing, jnp.asarray(3.0))
    for before, now in ((seen.sums, after.sums), (seen.seen_at, after.seen_at)):
        np.testing.assert_array_equal(before, now)
    assert all(np.isfinite(np.asarray(leaf)).all() for leaf in jax.tree.leaves(nothing))


def test_other_numbers_do_not_recompile(
    scan_of: Callable[..., Scan], traced: Callable[..., int]
) -> None:
    ends = end_points(FAN, scan_of(long_wall(1.2, 0.0), ORIGIN, FAN))

    def add(surface: SurfaceMap, way: jax.Array) -> jax.Array:
        after = surface.with_scan(ORIGIN, ends, way)
        return after.at(ORIGIN[:2], way)[0]

    calls = [
        (SurfaceMap.empty(GridFrame(SIDE, (x, -2.0, 0.1)), SHAPE, jnp.asarray(memory)), WAY + x)
        for x, memory in ((-2.0, 1.0), (-1.0, 9.0))
    ]
    assert traced(add, calls) == 1
