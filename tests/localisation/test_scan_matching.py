"""Matching of scans: the search and the minimum by hand, and the covariance by many scans."""

import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from jaxplore.localisation import EndPoints, ScanMatch, ScanMatcher, SurfaceMap
from jaxplore.localisation.scan_matching import LEAST_STD, TIE
from jaxplore.localisation.surface import LEAST_WEIGHT
from jaxplore.maps.frame import GridFrame
from jaxplore.sensing import Lidar, Scan

pytestmark = pytest.mark.long

SIDE, ORIGIN, SHAPE = 0.1, (-3.6, -2.6, 0.0), (52, 72)
SENSOR = Lidar(180, max_range=8.0)
WAY = jnp.zeros(())
PLACE = np.array([-1.0, 0.2, 0.4])
STDS = np.array([0.1, 0.1, 0.05])
PRIOR = jnp.asarray(np.diag(STDS**2), jnp.float32)
MATCHER = ScanMatcher()
type ScanOf = Callable[..., Scan]


@eqx.filter_jit
def matched(
    matcher: ScanMatcher,
    surface: SurfaceMap,
    scan: Scan,
    guess: jax.Array,
    prior: jax.Array,
    sensor: Lidar = SENSOR,
) -> ScanMatch:
    return matcher(surface, EndPoints.of(sensor, scan), guess, prior, WAY)


@eqx.filter_jit
def searched(surface: SurfaceMap, ends: EndPoints, guess: jax.Array, prior: jax.Array) -> jax.Array:
    return MATCHER.search(surface, ends, guess, prior, WAY)


end_points = eqx.filter_jit(EndPoints.of)


def surface_of(
    scan_of: ScanOf, walls: np.ndarray, noise: float, number: int, sensor: Lidar = SENSOR
) -> SurfaceMap:
    """Return the map of scans around the place."""
    rng = np.random.default_rng(1)
    add = eqx.filter_jit(
        lambda surface, pose, scan: surface.with_scan(pose, EndPoints.of(sensor, scan), WAY)
    )
    surface = SurfaceMap.empty(GridFrame(SIDE, ORIGIN), SHAPE, jnp.asarray(10.0))
    for seed in range(number):
        pose = PLACE + rng.uniform(-1.0, 1.0, 3) * [0.4, 0.4, math.pi]
        scan = scan_of(walls, pose, sensor, noise, seed)
        surface = add(surface, jnp.asarray(pose, jnp.float32), scan)
    return surface


@pytest.fixture(scope="module")
def noisy_map(scan_of: ScanOf, room: np.ndarray) -> SurfaceMap:
    return surface_of(scan_of, room, 0.02, 100)


def placed_by_hand(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    return points @ np.array([[cos, sin], [-sin, cos]]) + pose[:2]


def score_by_hand(
    surface: SurfaceMap, points: np.ndarray, offset: np.ndarray, pose: np.ndarray, prior: np.ndarray
) -> float:
    """Return the score of a pose of the lattice, in double precision."""
    cells = np.floor((placed_by_hand(pose, points) - ORIGIN[:2]) / SIDE).astype(int)[:, ::-1]
    is_in = ((cells >= 0) & (cells < SHAPE)).all(axis=1)
    row, column = np.where(is_in[:, None], cells, 0).T
    weights = np.asarray(surface.weights, float)[row, column]
    is_known = is_in & (weights >= LEAST_WEIGHT)
    away = np.asarray(surface.sums, float)[row, column] / np.where(is_known, weights, 1.0)
    near = np.abs(away) < surface.band
    fit = np.where(is_known & near, np.exp(-0.5 * (away / float(MATCHER.sigma)) ** 2), 0.0)
    return float(fit.mean() - TIE * offset @ np.linalg.inv(prior) @ offset)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1))
def test_the_search_finds_the_best_pose_of_the_lattice(seed: int) -> None:
    """On maps of random distances, which have many poses that are nearly as good."""
    rng = np.random.default_rng(seed)
    weights = np.where(rng.random(SHAPE) < 0.8, rng.uniform(0.2, 3.0, SHAPE), 0.0)
    sums = weights * rng.uniform(-0.13, 0.2, SHAPE)
    surface = SurfaceMap(
        *(jnp.asarray(each, jnp.float32) for each in (sums, weights)),
        jnp.zeros(SHAPE),
        GridFrame(SIDE, ORIGIN),
        jnp.asarray(10.0),
    )
    points = rng.uniform(-3.0, 3.0, (180, 2)).astype(np.float32)
    is_point = rng.random(180) < 0.7
    yes = jnp.asarray(is_point)
    ends = EndPoints(*(jnp.asarray(points) for _ in range(3)), yes, yes, jnp.zeros(180))
    guess = rng.uniform(-0.5, 0.5, 3).astype(np.float32)
    # The lattice is narrower than its greatest spacing along x and in the yaw.
    factor = np.diag([0.04, 0.2, 0.01]) @ (np.eye(3) + 0.1 * rng.standard_normal((3, 3)))
    prior = (factor @ factor.T).astype(np.float32)
    found = searched(surface, ends, jnp.asarray(guess), jnp.asarray(prior))
    step = max(1, 180 // MATCHER.search_points)
    used = points[::step][is_point[::step]].astype(float)
    spacing = np.minimum(np.sqrt(np.diag(prior.astype(float))), [0.1, 0.1, 0.02])
    lattice = np.stack(np.meshgrid(*[np.arange(-3, 4)] * 3, indexing="ij"), axis=-1)
    offsets = lattice.reshape(-1, 3) * spacing
    scores = [
        score_by_hand(surface, used, each, guess + each, prior.astype(float)) for each in offsets
    ]
    apart = np.asarray(found, float) - guess
    np.testing.assert_allclose(apart / spacing, np.round(apart / spacing), atol=1e-3)
    own = score_by_hand(surface, used, apart, guess + apart, prior.astype(float))
    # A point on the line between two cells may be rounded into the other one.
    assert own >= max(scores) - 1.0 / len(used)
    assert max(scores) > np.median(scores) + 2.0 / len(used)


def distances_by_hand(surface: SurfaceMap, points: np.ndarray) -> np.ndarray:
    """Return interpolated distances in double precision; NaN where they are not known."""
    column, row = ((points - ORIGIN[:2]) / SIDE - 0.5).T
    top, left = np.floor(row).astype(int), np.floor(column).astype(int)
    v, u = row - top, column - left
    weights = np.asarray(surface.weights, float)
    values = np.where(
        weights >= LEAST_WEIGHT, np.asarray(surface.sums, float) / np.maximum(weights, 1e-9), np.nan
    )
    upper = (1 - u) * values[top, left] + u * values[top, left + 1]
    lower = (1 - u) * values[top + 1, left] + u * values[top + 1, left + 1]
    return (1 - v) * upper + v * lower


@pytest.mark.parametrize("seed", range(4))
def test_the_pose_minimises_the_objective(
    scan_of: ScanOf, room: np.ndarray, noisy_map: SurfaceMap, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    scan = scan_of(room, PLACE, SENSOR, 0.02, 500 + seed)
    guess = PLACE + 0.5 * STDS * rng.standard_normal(3)
    found = matched(MATCHER, noisy_map, scan, jnp.asarray(guess, jnp.float32), PRIOR)
    ends = np.asarray(scan.points(SENSOR), float)
    variance = max(float(found.residual) ** 2, LEAST_STD**2)
    sigma = float(MATCHER.sigma)

    def objective(pose: np.ndarray) -> float:
        square = (distances_by_hand(noisy_map, placed_by_hand(pose, ends)) / sigma) ** 2
        # Its derivative by d is that of squares with the weights of Geman and McClure.
        fit = 0.5 * sigma**2 * np.nansum(square / (1.0 + square))
        return float(fit / variance + 0.5 * ((pose - guess) ** 2 / STDS**2).sum())

    best = minimize(
        objective, PLACE, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9}
    ).x
    std = np.sqrt(np.diag(np.asarray(found.covariance, float)))
    # The steps take the slope from the scan, and that of the map has noise.
    np.testing.assert_array_less(np.abs(np.asarray(found.pose) - best) / std, 0.4)
    np.testing.assert_array_less(np.abs(best - PLACE), 6.0 * std)


def matches(
    scan_of: ScanOf, walls: np.ndarray, surface: SurfaceMap, noise: float, number: int
) -> tuple[np.ndarray, np.ndarray, list[float]]:
    """Return errors (N, 3), the mean covariance, and the shares of many matches."""
    rng = np.random.default_rng(2)
    errors, covariances, shares = [], [], []
    for seed in range(number):
        scan = scan_of(walls, PLACE, SENSOR, noise, 1000 + seed)
        guess = PLACE + 0.3 * STDS * rng.standard_normal(3)
        found = matched(MATCHER, surface, scan, jnp.asarray(guess, jnp.float32), PRIOR)
        errors.append(np.asarray(found.pose, float) - PLACE)
        covariances.append(np.asarray(found.covariance, float))
        shares.append(float(found.share))
    return np.array(errors), np.mean(covariances, axis=0), shares


@pytest.mark.parametrize("noise", [0.01, 0.02])
def test_the_covariance_is_the_spread_of_matches(
    scan_of: ScanOf, room: np.ndarray, noise: float
) -> None:
    """The standard deviations of 200 matches are 0.7 to 1.15 times those that are told: the
    weights make residuals look smaller than they are, and a centimetre is their least."""
    surface = surface_of(scan_of, room, noise, 100)
    errors, covariance, shares = matches(scan_of, room, surface, noise, 200)
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), (errors - errors.mean(axis=0)).T)
    ratios = np.sqrt(np.linalg.eigvalsh(np.cov(whitened)))
    assert ratios.min() > 0.6
    assert ratios.max() < 1.3
    assert min(shares) > 0.95
    # The map, made of other noisy scans, is off by less than the noise of a match.
    assert np.abs(errors.mean(axis=0) / np.sqrt(np.diag(covariance))).max() < 1.0


@eqx.filter_jit
def with_scan(surface: SurfaceMap, pose: jax.Array, scan: Scan) -> SurfaceMap:
    return surface.with_scan(pose, EndPoints.of(SENSOR, scan), WAY)


def boxes(*sides: tuple[float, float, float, float]) -> np.ndarray:
    """Return the walls (S, 2, 2) of rectangles (x, y, width, height)."""
    walls = []
    for x, y, width, height in sides:
        corners = np.array([[x, y], [x + width, y], [x + width, y + height], [x, y + height]])
        walls.append(np.stack([corners, np.roll(corners, -1, axis=0)], axis=1))
    return np.concatenate(walls)


PLACES = {
    "room": boxes((-3.0, -2.0, 6.0, 4.0), (1.0, -1.0, 0.8, 0.6)),
    "corridor": boxes((-3.4, -0.9, 6.8, 2.0), (0.5, 0.9, 0.9, 0.2), (-2.0, -0.9, 0.8, 0.2)),
    "office": np.concatenate(
        [
            boxes((-3.4, -2.4, 6.8, 4.8), (-2.9, 1.4, 0.7, 0.5)),
            np.array([[[-3.4, -0.9], [-2.0, -0.9]], [[-1.2, -0.9], [1.0, -0.9]]]),
            np.array([[[1.8, -0.9], [3.4, -0.9]], [[1.0, -0.9], [1.0, -2.4]]]),
            np.array([[[0.4, 1.2], [0.4, 2.4]], [[0.4, 1.2], [3.4, 1.2]]]),
        ]
    ),
}


@pytest.mark.parametrize("name", PLACES)
@pytest.mark.parametrize("number", [1, 12])
def test_errors_of_scan_pairs_are_those_that_are_told(
    scan_of: ScanOf, name: str, number: int
) -> None:
    """The normalised squared errors of 60 matches, each to a map of its own, have a mean of about
    3, the number of coordinates: 2.0 to 3.3 here, and 4.0 to 12.0 before the map's own noise
    counted. Of pairs of scans the map has as much of it as the scan."""
    rng = np.random.default_rng(7)
    squares = []
    std = np.array([0.05, 0.05, 0.02])
    prior = jnp.asarray(np.diag(std**2), jnp.float32)
    for seed in range(60):
        place = PLACE + rng.uniform(-1.0, 1.0, 3) * [0.3, 0.1, 0.3]
        surface = SurfaceMap.empty(GridFrame(SIDE, ORIGIN), SHAPE, jnp.asarray(10.0))
        for index in range(number):
            pose = place + rng.uniform(-1.0, 1.0, 3) * [0.3, 0.2, 0.5]
            scan = scan_of(PLACES[name], pose, SENSOR, 0.03, 100 * seed + index)
            surface = with_scan(surface, jnp.asarray(pose, jnp.float32), scan)
        scan = scan_of(PLACES[name], place, SENSOR, 0.03, 90_000 + seed)
        guess = jnp.asarray(place + std * rng.standard_normal(3), jnp.float32)
        found = matched(MATCHER, surface, scan, guess, prior)
        error = np.asarray(found.pose, float) - place
        squares.append(error @ np.linalg.solve(np.asarray(found.covariance, float), error))
    assert 1.7 < np.mean(squares) < 4.3
    # Far fewer than one in a hundred of a chi-squared distribution are beyond 25.
    assert max(squares) < 25.0


def test_a_wrong_guess_is_corrected(
    scan_of: ScanOf, room: np.ndarray, noisy_map: SurfaceMap
) -> None:
    """Within the lattice, 0.3 m and 0.06 rad to either side."""
    scan = scan_of(room, PLACE, SENSOR, 0.02, 7)
    prior = jnp.asarray(np.diag([0.2, 0.2, 0.05]) ** 2, jnp.float32)
    for offset in ([0.28, -0.25, 0.055], [-0.3, 0.3, -0.05], [0.1, 0.29, 0.0]):
        guess = jnp.asarray(PLACE + offset, jnp.float32)
        found = matched(MATCHER, noisy_map, scan, guess, prior)
        assert np.abs(np.asarray(found.pose) - PLACE)[:2].max() < 0.015
        assert abs(float(found.pose[2]) - PLACE[2]) < 0.006
        assert float(found.share) > 0.95


@pytest.mark.parametrize(
    ("sensor", "noise"), [(SENSOR, 0.01), (Lidar(361, 8.0, math.radians(180.0)), 0.02)]
)
def test_along_a_corridor_nothing_is_measured(scan_of: ScanOf, sensor: Lidar, noise: float) -> None:
    """The covariance along it stays that of the guess, and in the other coordinates the pose is
    measured. Neither the noise of normals nor end points far along the walls count."""
    long = 50.0
    walls = np.array([[[-long, y], [long, y]] for y in (-1.0, 1.5)])
    surface = surface_of(scan_of, walls, noise, 30, sensor)
    start = np.array([-1.0, 0.1, 0.0])
    guess = start + np.array([0.1, 0.06, -0.03])
    scan = scan_of(walls, start, sensor, noise, 5)
    prior = jnp.asarray(np.diag([0.2, 0.1, 0.05]) ** 2, jnp.float32)
    found = matched(MATCHER, surface, scan, jnp.asarray(guess, jnp.float32), prior, sensor)
    std = np.sqrt(np.diag(np.asarray(found.covariance, float)))
    assert std[0] == pytest.approx(0.2, rel=0.02)
    assert std[1] < 0.005
    assert std[2] < 0.002
    assert abs(float(found.pose[1]) - start[1]) < 0.01
    assert abs(float(found.pose[2]) - start[2]) < 0.005
    # Each pose along it fits: the search takes the most likely one, up to the noise of the map.
    assert abs(float(found.pose[0]) - guess[0]) < 0.2


def test_a_scan_that_says_nothing_leaves_the_guess(
    scan_of: ScanOf, room: np.ndarray, noisy_map: SurfaceMap
) -> None:
    guess = jnp.asarray(PLACE + np.array([0.05, 0.0, 0.0]), jnp.float32)
    nothing = Scan(jnp.full(180, 8.0), jnp.zeros(180, bool))
    # A scan that is far off the map, too.
    away = scan_of(room, PLACE, SENSOR)
    for scan, at in ((nothing, guess), (away, guess + jnp.array([40.0, 0.0, 0.0]))):
        found = matched(MATCHER, noisy_map, scan, at, PRIOR)
        np.testing.assert_allclose(found.pose, at, atol=1e-5)
        np.testing.assert_allclose(found.covariance, PRIOR, rtol=1e-4, atol=1e-9)
        assert float(found.share) == 0.0


def test_numbers_that_are_not_finite_are_contained(
    scan_of: ScanOf, room: np.ndarray, noisy_map: SurfaceMap
) -> None:
    scan = scan_of(room, PLACE, SENSOR)
    guess = jnp.asarray(PLACE, jnp.float32)
    broken = Scan(scan.ranges.at[3].set(jnp.nan), scan.is_return)
    for given_scan, prior in ((broken, PRIOR), (scan, jnp.zeros((3, 3)))):
        found = matched(MATCHER, noisy_map, given_scan, guess, prior)
        assert np.isfinite(np.asarray(found.pose)).all()
        assert np.isfinite(np.asarray(found.covariance)).all()
        np.testing.assert_allclose(found.pose, guess, atol=0.02)


def test_other_numbers_do_not_recompile(
    scan_of: ScanOf, room: np.ndarray, noisy_map: SurfaceMap, traced: Callable[..., int]
) -> None:
    scan = scan_of(room, PLACE, SENSOR)
    guess = jnp.asarray(PLACE, jnp.float32)

    def match(matcher: ScanMatcher, prior: jax.Array) -> jax.Array:
        return matcher(noisy_map, EndPoints.of(SENSOR, scan), guess, prior, WAY).pose

    matchers = (MATCHER, ScanMatcher(0.2), ScanMatcher(spacing=0.2), ScanMatcher(turn_spacing=0.1))
    assert traced(match, [(each, size * PRIOR) for size, each in enumerate(matchers, 1)]) == 1
