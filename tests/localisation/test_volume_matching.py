"""Matching of scans in a volume: by a search over poses, derivatives, and poses that are known."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from jaxplore.geometry.level_motion import between, compose, propagate_covariance
from jaxplore.localisation import VolumeMatcher, VolumeOdometry, VolumePoints, VolumeSurface
from jaxplore.localisation.surface import ROUGH_WEIGHT
from jaxplore.localisation.volume_matching import SHARED
from jaxplore.localisation.volume_surface import LEAST_NOISE, smallest_axis
from jaxplore.maps import VoxelGrid
from jaxplore.sensing import DepthCamera

pytestmark = pytest.mark.long

SIDE = 0.1
PLACE = np.array([1.2, 2.1, 1.1, 0.4])
PRIOR = np.diag(np.array([0.1, 0.1, 0.1, 0.05]) ** 2)
MATCHER = VolumeMatcher()
EXACT, NOISY = DepthCamera(48, 36, quadratic_noise=0.0), DepthCamera(48, 36)
TILT = np.array([[0.98, 0.0, 0.199], [0.0, 1.0, 0.0], [-0.199, 0.0, 0.98]], np.float32)
"""Rotation of a body that looks down by 0.2 rad, about."""


def room(*, has_box: bool = True) -> VoxelGrid:
    """Return a room of 4 m by 4 m by 2.4 m, with a box in a corner, or an endless wall."""
    solid = np.zeros((24, 40, 40), bool)
    solid[:, :, 30:] = True
    if has_box:
        solid[[0, -1]] = solid[:, [0, -1]] = True
        solid[:9, 26:, 22:] = True
    return VoxelGrid.solid(solid, SIDE)


def yawed(yaw: float) -> np.ndarray:
    cos, sin = math.cos(yaw), math.sin(yaw)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


@eqx.filter_jit
def end_points(world: VoxelGrid, sensor: DepthCamera, pose: jax.Array, key: jax.Array):
    turned = jnp.array(TILT)
    cos, sin = jnp.cos(pose[3]), jnp.sin(pose[3])
    yaw = (
        jnp.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]])
        .at[:2, :2]
        .set(jnp.stack([jnp.stack([cos, -sin]), jnp.stack([sin, cos])]))
    )
    scan = sensor.scan(world, pose[:3], yaw @ turned, key=key)
    return VolumePoints.of([sensor], [scan], turned)


@eqx.filter_jit
def add(surface: VolumeSurface, pose: jax.Array, ends: VolumePoints) -> VolumeSurface:
    return surface.with_scan(pose, ends)


@eqx.filter_jit
def matched(surface: VolumeSurface, ends: VolumePoints, guess: jax.Array, prior: jax.Array):
    return MATCHER(surface, ends, guess, prior)


@eqx.filter_jit
def residuals(surface: VolumeSurface, ends: VolumePoints, pose: jax.Array):
    return MATCHER.residuals(surface, ends, pose)


def mapped(world: VoxelGrid, sensor: DepthCamera) -> VolumeSurface:
    """Return the surfaces that scans from places around the place show."""
    surface, rng = VolumeSurface.empty(world), np.random.default_rng(1)
    for number in range(12):
        pose = jnp.asarray(PLACE + rng.uniform(-0.3, 0.3, 4), jnp.float32)
        surface = add(surface, pose, end_points(world, sensor, pose, jax.random.key(number)))
    return surface


@pytest.fixture(scope="module")
def exact():
    return mapped(room(), EXACT), end_points(room(), EXACT, jnp.asarray(PLACE), jax.random.key(99))


@pytest.fixture(scope="module")
def noisy():
    return mapped(room(), NOISY), end_points(room(), NOISY, jnp.asarray(PLACE), jax.random.key(99))


@pytest.mark.parametrize(
    "off", [(0.0, 0.0, 0.0, 0.0), (0.05, -0.04, 0.03, 0.02), (-0.06, 0.05, -0.04, -0.03)]
)
def test_without_noise_the_true_pose_is_found(exact, off) -> None:
    guess = jnp.asarray(PLACE + off, jnp.float32)
    found = matched(*exact, guess, jnp.asarray(PRIOR, jnp.float32))
    assert float(found.share) > 0.8
    off = np.abs(np.asarray(found.pose, np.float64) - PLACE)
    assert (off < [0.01, 0.01, 0.01, 0.004]).all(), off
    assert (np.sqrt(np.diagonal(found.covariance)) < 0.1 * np.sqrt(np.diagonal(PRIOR))).all()


def cost(surface: VolumeSurface, ends: VolumePoints, pose: np.ndarray, guess: np.ndarray) -> float:
    """Return the cost of a pose, in double precision and by SciPy's interpolation.

    The weights of the kernel are the derivative of d^2 / (2 (1 + d^2 / sigma^2)).
    """
    few = jax.tree.map(
        lambda rows: np.asarray(rows, np.float64)[:: max(1, round(len(rows) / MATCHER.points))],
        (ends.points, ends.normals, ends.is_point, ends.is_flat, ends.variance),
    )
    points, normals, is_point, is_flat, variance = few
    arm, own = points @ yawed(pose[3]).T, normals @ yawed(pose[3]).T
    weights = np.asarray(surface.weights, np.float64)
    values = np.asarray(surface.sums, np.float64) / np.where(weights > 0.0, weights, 1.0)
    shift, sigma = surface.shift, float(MATCHER.sigma)

    def read(places: np.ndarray) -> np.ndarray:
        grid = ((places - np.asarray(surface.origin)) / SIDE - 0.5)[:, ::-1].T
        return map_coordinates(values, grid, order=1, mode="nearest")

    before = arm + pose[:3] + shift * own
    small = 1e-4
    # The slope along the normal by differences; it is 1 but near corners.
    along = (read(before + small * own) - read(before - small * own)) / (2.0 * small)
    away = read(before) - shift * along
    known = np.asarray(residuals(surface, ends.every(1), jnp.asarray(guess, jnp.float32)).weights)
    known = known[:: max(1, round(len(known) / MATCHER.points))] > 0.0
    share = is_point * known * np.where(is_flat, 1.0, ROUGH_WEIGHT)
    share = share / (SHARED * (LEAST_NOISE**2 + variance))
    robust = 0.5 * away**2 / (1.0 + (away / sigma) ** 2)
    off = pose - guess
    return float((share * robust).sum() + 0.5 * off @ np.linalg.inv(PRIOR) @ off)


def test_no_pose_of_a_grid_around_it_fits_better(noisy) -> None:
    """The search in double precision has the interpolation of SciPy."""
    guess = PLACE + np.array([0.04, -0.03, 0.02, 0.015])
    found = matched(*noisy, jnp.asarray(guess, jnp.float32), jnp.asarray(PRIOR, jnp.float32))
    pose = np.asarray(found.pose, np.float64)
    steps = np.array([0.01, 0.01, 0.01, 0.004])
    best, least = pose, np.inf
    for corner in np.ndindex(5, 5, 5, 5):
        tried = PLACE + (np.array(corner) - 2) * steps
        value = cost(*noisy, tried, guess)
        if value < least:
            best, least = tried, value
    assert (np.abs(pose - best) <= 1.0 * steps + 1e-6).all()
    assert cost(*noisy, pose, guess) <= 1.02 * least
    assert np.linalg.norm(pose[:3] - PLACE[:3]) < 0.02


def test_derivatives_are_those_of_differences(noisy) -> None:
    """On planes; a corner bends them."""
    surface, ends = noisy
    pose, small = jnp.asarray(PLACE, jnp.float32), 2e-3
    here = residuals(surface, ends, pose)
    is_used = (np.asarray(here.weights) > 0.0) & np.asarray(ends.is_flat)
    assert is_used.sum() > 300
    for axis in range(4):
        step = jnp.zeros(4).at[axis].set(small)
        ahead, behind = (residuals(surface, ends, pose + sign * step) for sign in (1.0, -1.0))
        is_both = is_used & (np.asarray(ahead.weights) > 0.0) & (np.asarray(behind.weights) > 0.0)
        slope = (np.asarray(ahead.away) - np.asarray(behind.away)) / (2.0 * small)
        off = np.abs(slope - np.asarray(here.rows)[:, axis])[is_both]
        assert np.median(off) < 0.03


def test_the_slope_is_that_of_the_interpolation(noisy) -> None:
    surface, _ = noisy
    known = np.argwhere(np.asarray(surface.weights) >= 1.0)
    rng = np.random.default_rng(0)
    voxels = known[rng.integers(len(known), size=400)]
    points = (voxels[:, ::-1] + 0.5 + rng.uniform(0.1, 0.9, (400, 3))) * SIDE
    read = eqx.filter_jit(surface.at)
    value, slope, is_known = (np.asarray(each) for each in read(jnp.asarray(points, jnp.float32)))
    assert is_known.sum() > 50
    weights = np.asarray(surface.weights, np.float64)
    values = np.asarray(surface.sums, np.float64) / np.where(weights > 0.0, weights, 1.0)

    def wanted(places: np.ndarray) -> np.ndarray:
        return map_coordinates(values, (places / SIDE - 0.5)[:, ::-1].T, order=1)

    np.testing.assert_allclose(value[is_known], wanted(points)[is_known], atol=1e-5)
    for axis in range(3):
        step = np.eye(3)[axis] * 1e-5
        by_difference = (wanted(points + step) - wanted(points - step)) / 2e-5
        np.testing.assert_allclose(slope[is_known, axis], by_difference[is_known], atol=2e-3)


def test_along_a_bare_wall_the_pose_stays_with_the_odometry() -> None:
    world = room(has_box=False)
    surface = mapped(world, NOISY)
    ends = end_points(world, NOISY, jnp.asarray(PLACE), jax.random.key(99))
    off = np.array([0.04, 0.05, -0.05, 0.02])
    guess = jnp.asarray(PLACE + off, jnp.float32)
    found = matched(surface, ends, guess, jnp.asarray(PRIOR, jnp.float32))
    pose, std = np.asarray(found.pose), np.sqrt(np.diagonal(found.covariance))
    # The wall is across x: x and yaw are measured, y and z are not.
    assert abs(pose[0] - PLACE[0]) < 0.01
    assert abs(pose[3] - PLACE[3]) < 0.01
    assert (np.abs(pose[1:3] - np.asarray(guess)[1:3]) < 0.03).all()
    assert (std[[0, 3]] < 0.02).all()
    assert (std[1:3] > 0.05).all()


def test_planes_through_neighbours_face_the_sensor(exact) -> None:
    _, ends = exact
    normals, is_flat = np.asarray(ends.normals, np.float64), np.asarray(ends.is_flat)
    turned = normals[is_flat] @ yawed(PLACE[3]).T
    # Walls, floor and box are across the axes.
    assert (np.abs(turned).max(axis=1) > 0.995).mean() > 0.95
    assert ((normals * np.asarray(ends.points)).sum(axis=1)[is_flat] < 0.0).all()


def test_the_smallest_axis_is_that_of_numpy() -> None:
    rng = np.random.default_rng(0)
    bases, _ = np.linalg.qr(rng.normal(size=(200, 3, 3)))
    sizes = np.stack([rng.uniform(0, 1e-4, 200), *rng.uniform(1e-3, 1e-2, (2, 200))], axis=1)
    spread = (np.einsum("nij,nj,nkj->nik", bases, sizes, bases)).astype(np.float32)
    values, vectors = np.linalg.eigh(spread.astype(np.float64))
    axis, thin, middle = (np.asarray(each) for each in eqx.filter_jit(smallest_axis)(spread))
    assert (np.abs((axis * vectors[:, :, 0]).sum(axis=1)) > 0.999).all()
    np.testing.assert_allclose(thin, values[:, 0], atol=3e-6)
    np.testing.assert_allclose(middle, values[:, 1], rtol=0.02, atol=2e-5)


def test_motions_are_composed_and_told_apart() -> None:
    rng = np.random.default_rng(0)
    pose, other = (jnp.asarray(rng.normal(size=4), jnp.float32) for _ in range(2))
    motion = np.asarray(between(pose, other), np.float64)
    wanted = yawed(float(pose[3])).T @ (np.asarray(other) - np.asarray(pose))[:3]
    np.testing.assert_allclose(motion[:3], wanted, atol=1e-5)
    after = np.asarray(compose(pose, jnp.asarray(motion, jnp.float32)))
    np.testing.assert_allclose(after, np.asarray(other), atol=1e-5)


def test_drift_has_the_covariance_that_a_filter_expects() -> None:
    """Flights of 40 steps, each with its own errors."""
    odometry = VolumeOdometry(0.05, 0.02, 0.03, 0.0)
    motion = jnp.array([0.1, 0.02, -0.03, 0.05])

    def fly(key: jax.Array) -> jax.Array:
        errors = odometry.draw(jax.random.fold_in(key, 1000))

        def step(pose: jax.Array, number: jax.Array) -> tuple[jax.Array, None]:
            own = jax.random.fold_in(key, number)
            measured, _ = odometry.measure(motion, jnp.array(0.05), errors, own)
            return compose(pose, measured), None

        return jax.lax.scan(step, jnp.zeros(4), jnp.arange(40))[0]

    ends = np.asarray(jax.jit(jax.vmap(fly))(jax.random.split(jax.random.key(0), 4000)), float)
    pose, covariance = jnp.zeros(4), jnp.zeros((4, 4))
    for _ in range(40):
        added = odometry.covariance(motion)
        covariance = propagate_covariance(pose, motion, covariance, added)
        pose = compose(pose, motion)
    np.testing.assert_allclose(ends.mean(axis=0), np.asarray(pose), atol=0.05)
    found, wanted = np.cov(ends.T), np.asarray(covariance)
    scale = np.sqrt(np.outer(np.diagonal(wanted), np.diagonal(wanted)))
    assert (np.abs(found - wanted) / scale).max() < 0.08


def test_the_error_of_scale_is_that_of_the_run() -> None:
    odometry = VolumeOdometry(0.0, 0.0, 0.0, 0.1)
    keys = jax.random.split(jax.random.key(0), 2000)
    scales = np.asarray(jax.vmap(lambda key: odometry.draw(key).scale)(keys))
    assert scales.std() == pytest.approx(0.1, rel=0.05)
    errors = odometry.draw(keys[0])
    motion = jnp.array([1.0, -2.0, 0.5, 0.3])
    measured, after = odometry.measure(motion, jnp.array(0.05), errors, keys[1])
    wanted = np.append((1.0 + scales[0]) * np.asarray(motion)[:3], 0.3)
    np.testing.assert_allclose(np.asarray(measured), wanted, rtol=1e-6)
    assert after == errors
    assert float(odometry.draw(None).scale) == 0.0
