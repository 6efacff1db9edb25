"""A particle filter of the pose: against an exact filter, and in a room that it does not know."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import norm

import jaxplore as jx
from jaxplore.geometry.motion import between
from jaxplore.localisation import LikelihoodField, Odometry, OdometryBias, ParticleFilter, Particles
from jaxplore.localisation.particles import effective_sample_size, low_variance_indices

pytestmark = pytest.mark.long

KEY = jax.random.key(0)
# A small room with a corner cut off, on a map that ends at its walls.
CELL, ORIGIN = 0.2, (-1.2, -1.0, 0.0)
WALLS = np.zeros((10, 12), bool)
WALLS[[0, -1]] = WALLS[:, [0, -1]] = WALLS[1:4, 8:11] = True
ROOM = jx.OccupancyGrid(np.where(WALLS, 0.9, 0.1), CELL, ORIGIN)


def distance_by_hand(points: np.ndarray, bound: float) -> np.ndarray:
    """Return the distances of points from walls: of the centres of cells to all walls, between
    them bilinear."""
    rows, columns = np.indices(WALLS.shape)
    walls = np.argwhere(WALLS)
    away = np.hypot(rows[..., None] - walls[:, 0], columns[..., None] - walls[:, 1]).min(axis=-1)
    at_centres = np.clip((away - 0.5) * CELL, 0.0, bound)
    column, row = ((points - ORIGIN[:2]) / CELL - 0.5).T
    height, width = WALLS.shape
    is_on = (abs(row + 0.5 - height / 2) <= height / 2) & (
        abs(column + 0.5 - width / 2) <= width / 2
    )
    row, column = np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)
    top, left = np.minimum(row.astype(int), height - 2), np.minimum(column.astype(int), width - 2)
    v, u = row - top, column - left
    value = (1 - v) * ((1 - u) * at_centres[top, left] + u * at_centres[top, left + 1])
    value += v * ((1 - u) * at_centres[top + 1, left] + u * at_centres[top + 1, left + 1])
    return np.where(is_on, value, bound)


def likelihoods_by_hand(
    poses: np.ndarray, points: np.ndarray, settings: ParticleFilter
) -> np.ndarray:
    cos, sin = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x, y = points.T
    ends = np.stack([poses[:, :1] + cos * x - sin * y, poses[:, 1:2] + sin * x + cos * y], axis=-1)
    away = distance_by_hand(ends.reshape(-1, 2), settings.max_distance).reshape(len(poses), -1)
    fit = np.exp(-0.5 * (away / float(settings.distance_std)) ** 2)
    outlier = float(settings.outlier_share)
    return np.log((1 - outlier) * fit + outlier).sum(axis=1)


@eqx.filter_jit
def log_likelihoods(settings, poses, points, is_used):
    return settings.log_likelihoods(poses, points, is_used, settings.likelihood_field(ROOM))


@given(st.integers(0, 2**32 - 1))
def test_likelihoods_are_those_of_the_formula(seed: int) -> None:
    rng = np.random.default_rng(seed)
    settings = ParticleFilter(num_particles=3, max_distance=0.5, outlier_share=0.1)
    poses = rng.uniform(-1.5, 1.5, (3, 3)).astype(np.float32)
    points = rng.uniform(-1.5, 1.5, (9, 2)).astype(np.float32)
    found = log_likelihoods(settings, poses, points, np.arange(9) < 7)
    expected = likelihoods_by_hand(poses.astype(float), points[:7].astype(float), settings)
    np.testing.assert_allclose(found, expected, atol=2e-4)


# The exact filter: positions 0.05 m apart over 4 m x 4 m, and yaws 7.5 degrees. With 0.2 m
# its means are 0.03 m off, with 0.1 m 0.01 m: the likelihood has kinks where the nearest wall
# changes.
STEP, TURNS = 0.05, 48
AXIS = STEP * (np.arange(80) - 39.5)
YAWS = math.tau * np.arange(TURNS) / TURNS - math.pi
EXACT = ParticleFilter(
    # Its variances grow with the motion: 0.2 m and 0.35 rad for the motions below.
    Odometry(distance_noise=0.4, turn_per_distance=0.7, turn_noise=0.0, slip_in_turns=0.0),
    5000,
    8,
    max_distance=1.0,
    distance_std=0.35,
    temper=0.5,
    slow_rate=0.0,  # no random particles
    fast_rate=0.0,
)
PRIOR, SPREAD = np.array([-0.3, 0.1, 0.5]), np.array([0.3, 0.3, 0.4])
MOTION = np.array([0.25, 0.0, 0.2])
ENDS = 0.9 * np.stack([np.cos(math.tau * np.arange(8) / 8), np.sin(math.tau * np.arange(8) / 8)], 1)
ENDS[:3] *= 0.6


def wrapped_normal(angle: np.ndarray, std: float) -> np.ndarray:
    return sum(norm.pdf(angle + math.tau * turn, scale=std) for turn in range(-3, 4))


def exact_posterior(updates: int) -> np.ndarray:
    """Return the probabilities (x, y, yaw) after some motions, each followed by a scan."""
    belief = norm.pdf(AXIS[:, None, None], PRIOR[0], SPREAD[0])
    belief = belief * norm.pdf(AXIS[None, :, None], PRIOR[1], SPREAD[1])
    belief = belief * wrapped_normal(YAWS - PRIOR[2], SPREAD[2])
    position_std, yaw_std = 0.4 * math.sqrt(MOTION[0]), 0.7 * math.sqrt(MOTION[0])
    nodes = np.stack(np.meshgrid(AXIS, AXIS, YAWS, indexing="ij"), axis=-1)
    logs = likelihoods_by_hand(nodes.reshape(-1, 3), ENDS, EXACT).reshape(belief.shape)
    for _ in range(updates):
        moved = np.empty_like(belief)
        for k, yaw in enumerate(YAWS):
            dx, dy = MOTION[0] * math.cos(yaw), MOTION[0] * math.sin(yaw)
            along = norm.pdf(AXIS[:, None] - AXIS - dx, scale=position_std)
            across = norm.pdf(AXIS[:, None] - AXIS - dy, scale=position_std)
            moved[:, :, k] = along @ belief[:, :, k] @ across.T
        belief = moved @ wrapped_normal(YAWS[None, :] - YAWS[:, None] - MOTION[2], yaw_std)
        belief = belief * np.exp(0.5 * logs)
        belief /= belief.sum()
    return belief


@eqx.filter_jit
def many_posteriors(settings: ParticleFilter, keys: jax.Array, updates: int) -> Particles:
    """Run independent filters, mapped over their keys."""
    field = settings.likelihood_field(ROOM)
    points, is_return = jnp.asarray(ENDS, jnp.float32), jnp.ones(8, bool)

    def step(particles: Particles, key: jax.Array) -> tuple[Particles, jax.Array]:
        to_move, to_see = jax.random.split(key)
        motion = jnp.asarray(MOTION, jnp.float32)
        particles = settings.predict(particles, motion, jnp.ones(()), to_move)
        particles = settings.update(particles, points, is_return, field, to_see)
        return particles, particles.effective_sample_size

    def run(key: jax.Array) -> tuple[Particles, jax.Array]:
        first, rest = jax.random.split(key)
        start = settings.init_around(
            jnp.asarray(PRIOR, jnp.float32), jnp.diag(jnp.asarray(SPREAD**2, jnp.float32)), first
        )
        return jax.lax.scan(step, start, jax.random.split(rest, updates))

    return jax.vmap(run)(keys)


def test_the_posterior_is_that_of_an_exact_filter() -> None:
    updates = 5
    expected = exact_posterior(updates)
    # The exact filter lost nothing at its border.
    assert expected[[0, -1]].sum() + expected[:, [0, -1]].sum() < 1e-4
    particles, sizes = many_posteriors(EXACT, jax.random.split(KEY, 24), updates)
    # Some updates drew particles anew, and others kept their weights.
    is_drawn = np.asarray(sizes) > 4999.0
    assert 0 < is_drawn[0].sum() < updates
    poses = np.asarray(particles.poses, float).reshape(-1, 3)
    weights = np.asarray(particles.weights, float).reshape(-1) / 24
    assert weights.sum() == pytest.approx(1.0, abs=1e-4)
    # Between runs of 5000 particles means differ by 4 % of the standard deviation, so the mean of
    # these runs is good to 1 %.
    for axis, grid in ((0, AXIS), (1, AXIS)):
        marginal = expected.sum(axis=(1 - axis, 2))
        mean = marginal @ grid
        std = math.sqrt(marginal @ (grid - mean) ** 2)
        assert weights @ poses[:, axis] == pytest.approx(mean, abs=0.03 * std)
        found = math.sqrt(weights @ (poses[:, axis] - mean) ** 2)
        assert found == pytest.approx(std, rel=0.03)
        edges = np.linspace(-2.0, 2.0, 11)
        share, _ = np.histogram(poses[:, axis], edges, weights=weights)
        np.testing.assert_allclose(share, marginal.reshape(10, 8).sum(axis=1), atol=0.012)
    marginal = expected.sum(axis=(0, 1))
    circle = weights @ np.exp(1j * poses[:, 2])
    assert abs(circle - marginal @ np.exp(1j * YAWS)) < 0.012
    # The posterior is far from the prior: all of this would fail without the scans.
    blind = many_posteriors(
        eqx.tree_at(lambda each: each.temper, EXACT, jnp.full((), 1e-6)),
        jax.random.split(KEY, 24),
        updates,
    )[0]
    assert abs(float(blind.poses[..., 0].mean()) - weights @ poses[:, 0]) > 0.15


# A hall of 10 m x 8 m with two walls that stand in it and a post: no two places look alike.
HALL = np.zeros((40, 50))
HALL[[0, -1]] = HALL[:, [0, -1]] = HALL[1:18, 20:21] = HALL[28:, 34:35] = HALL[24:27, 12:15] = 1.0
WORLD = jx.OccupancyGrid(HALL, 0.2)
LIDAR = jx.Lidar(num_beams=60, max_range=10.0)
WHEELS = Odometry(distance_noise=0.05, turn_per_distance=0.05, turn_noise=0.05)
FILTER = ParticleFilter(WHEELS, 2000)


def circle(x: float, y: float, yaw: float, number: int) -> np.ndarray:
    """Return poses on a circle with a radius of 1 m."""
    turned = yaw + 0.1 * np.arange(number)
    ends = [x + np.sin(turned) - np.sin(yaw), y - np.cos(turned) + np.cos(yaw), turned]
    return np.stack(ends, axis=1)


class Found(eqx.Module):
    distance: jax.Array
    turn: jax.Array
    is_converged: jax.Array
    particles: Particles


@eqx.filter_jit
def localise(settings: ParticleFilter, poses: jax.Array, is_carried: jax.Array, key) -> Found:
    """Drive along poses; where the robot is carried its odometry says that it stands still."""
    field = settings.likelihood_field(WORLD)
    first, rest = jax.random.split(key)

    def step(carry, given):
        particles, before = carry
        pose, carried, key = given
        keys = jax.random.split(key, 4)
        motion = jnp.where(carried, 0.0, between(before, pose))
        measured, _ = WHEELS.measure(motion, jnp.ones(()), OdometryBias.none(), keys[0])
        particles = settings.predict(particles, measured, jnp.ones(()), keys[1])
        scan = LIDAR.scan(WORLD, pose, key=keys[2])
        particles = settings.update(particles, scan.points(LIDAR), scan.is_return, field, keys[3])
        estimate = settings.estimate(particles)
        away = between(pose, estimate.pose)
        said = jnp.hypot(away[0], away[1]), jnp.abs(away[2]), estimate.is_converged
        return (particles, pose), said

    start = settings.init_everywhere(field, first)
    given = poses, is_carried, jax.random.split(rest, len(poses))
    (particles, _), said = jax.lax.scan(step, (start, poses[0]), given)
    return Found(*said, particles)


DRIVE = np.concatenate([circle(1.6, 2.2, -0.5, 30), circle(8.2, 3.2, 0.0, 40)])
POSES, CARRIED = jnp.asarray(DRIVE, jnp.float32), jnp.arange(70) == 30


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_finds_itself_and_again_when_it_is_carried_away(seed: int) -> None:
    assert bool(WORLD.at(POSES[:, :2]).max() < 0.5)
    found = localise(FILTER, POSES, CARRIED, jax.random.key(seed))
    is_right = (np.asarray(found.distance) < 0.25) & (np.asarray(found.turn) < 0.1)
    converged = np.asarray(found.is_converged)
    assert is_right[12:30].all()
    assert converged[15:30].all()
    assert not is_right[30]
    assert is_right[40:].all()
    assert converged[45:].all()
    # It knows that it does not know, but for the first scans in the other place.
    assert (converged & ~is_right).sum() <= 8
    assert float(np.mean(found.distance[15:30])) < 0.08


def test_few_particles_find_it_because_they_are_drawn_from_the_scan() -> None:
    few, lost = ParticleFilter(WHEELS, 500), []
    for seed in range(8):
        found = localise(few, POSES, CARRIED, jax.random.key(seed))
        is_right = (np.asarray(found.distance) < 0.25) & (np.asarray(found.turn) < 0.1)
        lost.append(int((~is_right[30:]).sum()))
    # With random poses alone it is 19 scans.
    assert np.mean(lost) < 9.0


def test_without_recovery_it_stays_lost() -> None:
    still = eqx.tree_at(
        lambda each: (each.slow_rate, each.fast_rate), FILTER, (jnp.zeros(()), jnp.zeros(()))
    )
    found = localise(still, POSES, CARRIED, jax.random.key(0))
    assert (np.asarray(found.distance)[31:] > 1.0).all()


def test_the_same_key_gives_the_same_particles() -> None:
    runs = [localise(FILTER, POSES, CARRIED, jax.random.key(seed)) for seed in (1, 1, 2)]
    same, other = (np.asarray(each.particles.poses) for each in runs[1:])
    np.testing.assert_array_equal(runs[0].particles.poses, same)
    assert (same != other).all()


def test_other_numbers_do_not_compile_again() -> None:
    localise(FILTER, POSES, CARRIED, KEY)
    before = localise._cached._cache_size()
    settings = ParticleFilter(
        Odometry(0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1),
        2000,
        distance_std=0.1,
        outlier_share=0.3,
        temper=0.1,
        usual_fit=0.5,
        slow_rate=0.1,
        fast_rate=0.5,
        cluster_radius=0.5,
        cluster_angle=0.2,
    )
    localise(settings, POSES + 0.01, CARRIED, jax.random.key(5))
    assert localise._cached._cache_size() == before


drawn = jax.jit(low_variance_indices)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.999), st.sampled_from([0.1, 1.0, 10.0]))
def test_low_variance_draws_are_within_one_of_their_expectation(
    seed: int, offset: float, power: float
) -> None:
    rng = np.random.default_rng(seed)
    weights = rng.random(200) ** power * (rng.random(200) < 0.8)
    weights = (weights / weights.sum()).astype(np.float32)
    index = np.asarray(drawn(weights, jnp.float32(offset)))
    counts = np.bincount(index, minlength=200)
    expected = 200 * weights.astype(float)
    assert (np.abs(counts - expected) < 1.0 + 1e-3).all()
    assert (counts[weights == 0.0] == 0).all()
    assert (np.diff(index) >= 0).all()


def test_effective_sample_sizes() -> None:
    assert float(effective_sample_size(jnp.full(8, 0.125))) == pytest.approx(8.0)
    assert float(effective_sample_size(jnp.eye(8)[3])) == pytest.approx(1.0)
    assert float(effective_sample_size(jnp.asarray([0.5, 0.5, 0.0]))) == pytest.approx(2.0)


SMALL = ParticleFilter(num_particles=1000, num_beams=8)
update = eqx.filter_jit(SMALL.update)


def test_a_normal_start_has_the_moments_that_are_given() -> None:
    root = np.array([[0.3, 0.0, 0.0], [0.1, 0.2, 0.0], [0.0, 0.0, 0.0]])
    found = ParticleFilter(num_particles=20000).init_around((1.0, 2.0, 3.0), root @ root.T, KEY)
    poses = np.asarray(found.poses, float)
    np.testing.assert_allclose(poses.mean(axis=0), [1.0, 2.0, 3.0], atol=0.01)
    np.testing.assert_allclose(np.cov(poses.T), root @ root.T, atol=0.003)
    # The yaw is known exactly.
    np.testing.assert_allclose(poses[:, 2], 3.0, atol=1e-3)
    assert float(found.weights.sum()) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (3.0, -2.0, 2.0)])
def test_random_poses_are_uniform_over_free_cells(origin) -> None:
    probability = np.full((4, 5), 0.5)
    probability[1, 1:4] = probability[3, 0] = 0.1
    probability[2, 2] = 0.9
    grid = jx.OccupancyGrid(probability, 0.5, origin)
    for shown in (grid, grid.pad((6, 8))):
        poses = SMALL.likelihood_field(shown).random_poses(8000, KEY)
        cells = np.asarray(grid.frame.to_cell(poses[:, :2]))
        counts = np.zeros((4, 5))
        np.add.at(counts, tuple(cells.T), 1)
        assert (counts[probability > 0.25] == 0).all()
        # Five standard deviations of a count of 2000.
        assert (abs(counts[probability < 0.25] - 2000) < 5 * math.sqrt(2000 * 0.75)).all()
        within = np.asarray(grid.frame.to_grid(poses[:, :2])) % 1.0
        np.testing.assert_allclose(within.mean(axis=0), 0.5, atol=0.02)
        assert abs(np.exp(1j * np.asarray(poses[:, 2])).mean()) < 0.05
        assert float(jnp.abs(poses[:, 2]).max()) <= math.pi


def test_beyond_the_map_there_is_no_wall() -> None:
    open_map = jx.OccupancyGrid(np.full((6, 6), 0.1), 0.2)
    field = LikelihoodField.of(open_map, 0.6)
    np.testing.assert_allclose(field.distance.values, 0.6)
    assert float(field.distance(jnp.asarray([50.0, 0.0]))) == pytest.approx(0.6)
    # Padding is off the map too.
    padded = LikelihoodField.of(open_map.pad((9, 8)), 0.6)
    np.testing.assert_allclose(padded.distance.values, 0.6)


def placed_particles(poses: np.ndarray, weights: np.ndarray) -> Particles:
    usual = SMALL.usual_fit
    return Particles(
        jnp.asarray(poses, jnp.float32), jnp.asarray(weights, jnp.float32), usual, usual
    )


def test_the_estimate_is_the_heaviest_cluster() -> None:
    rng = np.random.default_rng(0)
    poses = np.concatenate(
        [
            [1.0, 2.0, math.pi] + 0.1 * rng.standard_normal((300, 3)),
            [4.0, 2.0, 0.0] + 0.1 * rng.standard_normal((700, 3)),
        ]
    )
    poses[:, 2] = np.arctan2(np.sin(poses[:, 2]), np.cos(poses[:, 2]))
    # Few particles, with most of the weight, around a yaw of pi, where signs change.
    weights = np.where(np.arange(1000) < 300, 0.7 / 300, 0.3 / 700)
    found = SMALL.estimate(placed_particles(poses, weights))
    away = poses[:300] - [1.0, 2.0, 0.0]
    away[:, 2] = np.arctan2(-np.sin(away[:, 2]), -np.cos(away[:, 2]))
    expected = away.mean(axis=0)
    np.testing.assert_allclose(found.pose[:2], expected[:2] + np.array([1.0, 2.0]), atol=1e-3)
    turn = math.remainder(float(found.pose[2]) - math.pi - expected[2], math.tau)
    assert turn == pytest.approx(0.0, abs=1e-3)
    np.testing.assert_allclose(found.covariance, np.cov(away.T, bias=True), atol=2e-4)
    assert float(found.share) == pytest.approx(0.7, abs=1e-3)
    assert not bool(found.is_converged)
    sure = SMALL.estimate(placed_particles(poses, np.where(weights > 1e-3, 1 / 300, 0.0)))
    assert bool(sure.is_converged)
    # The particles agree, and the scans do not fit.
    badly = placed_particles(poses, np.where(weights > 1e-3, 1 / 300, 0.0))
    badly = badly._replace(fast=0.5 * badly.slow)
    assert not bool(SMALL.estimate(badly).is_converged)


def test_numbers_that_are_not_finite_stay_where_they_are() -> None:
    field = SMALL.likelihood_field(ROOM)
    start = SMALL.init_around((0.0, 0.0, 0.5), np.diag([0.01, 0.01, 0.01]), KEY)
    for motion, elapsed in (([math.nan, 0.0, 0.0], 0.1), ([0.1, 0.0, 0.0], math.inf)):
        moved = SMALL.predict(start, jnp.asarray(motion), jnp.float32(elapsed), KEY)
        np.testing.assert_allclose(moved.poses, start.poses, atol=1e-6)
    bad = jnp.asarray(np.where(np.arange(8)[:, None] < 3, np.nan, ENDS), jnp.float32)
    some, good = jnp.arange(8) >= 3, jnp.asarray(ENDS, jnp.float32)
    # A point that is not finite counts as little as a beam without a return.
    for points in (bad, bad.at[1, 0].set(math.inf)):
        found = update(start, points, jnp.ones(8, bool), field, KEY)
        expected = update(start, good, some, field, KEY)
        np.testing.assert_allclose(found.weights, expected.weights, rtol=1e-5)
        assert float(found.fast) == pytest.approx(float(expected.fast))
    # Nothing is learned without a return.
    for unseen in (
        update(start, good, jnp.zeros(8, bool), field, KEY),
        update(start, jnp.full((8, 2), math.nan), jnp.ones(8, bool), field, KEY),
    ):
        np.testing.assert_allclose(unseen.weights, start.weights, rtol=1e-5)
        np.testing.assert_array_equal(unseen.poses, start.poses)
        assert float(unseen.slow) == float(unseen.fast) == float(start.slow)
    # Poses that are not finite are replaced, some or all of them.
    for lost in (jnp.arange(1000) < 400, jnp.ones(1000, bool)):
        damaged = start._replace(poses=jnp.where(lost[:, None], jnp.nan, start.poses))
        mended = update(damaged, good, jnp.ones(8, bool), field, KEY)
        assert bool(jnp.isfinite(mended.poses).all())
        assert float(mended.weights.sum()) == pytest.approx(1.0, abs=1e-4)
        assert all(bool(jnp.isfinite(part).all()) for part in SMALL.estimate(mended)[:3])


def test_wrong_settings_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^grid has no free cell; accepted"):
        SMALL.likelihood_field(jx.OccupancyGrid(np.ones((3, 3)), 0.1))
    with pytest.raises(ValueError, match=r"^covariance is .*; accepted: symmetric and positive"):
        SMALL.init_around((0.0, 0.0, 0.0), np.diag([1.0, -1.0, 1.0]), KEY)
    with pytest.raises(ValueError, match=r"^pose is .*; accepted: 3 finite numbers"):
        SMALL.init_around((0.0, math.nan, 0.0), np.eye(3), KEY)


def test_the_ends_of_beams_are_the_points_of_a_scan() -> None:
    scan = LIDAR.scan(WORLD, POSES[0], key=KEY)
    expected = [
        [distance * math.cos(angle), distance * math.sin(angle)]
        for distance, angle in zip(np.asarray(scan.ranges), LIDAR.beam_angles, strict=True)
    ]
    np.testing.assert_allclose(scan.points(LIDAR), expected, rtol=1e-5, atol=1e-5)
