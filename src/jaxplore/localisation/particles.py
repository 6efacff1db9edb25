"""Monte Carlo localisation: a particle filter of the robot's pose on a known map."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplore import _checks, _covariances, _kinds
from jaxplore._limits import LONGEST_RANGE, MOST_BEAMS, MOST_SAMPLES
from jaxplore._types import ArrayLike, Flag, Key, Pose, Rows, Scalar, Vector
from jaxplore.geometry.motion import Matrix, compose, wrap_angle
from jaxplore.localisation.likelihood_field import LikelihoodField, Points, Poses
from jaxplore.localisation.odometry import Odometry
from jaxplore.localisation.odometry_model import OdometryModel
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OccupancyGrid

Weights = Float[Array, " K"]
CANDIDATES = 64
"""Number of particles around which the heaviest cluster is looked for."""
CONVERGED_SHARE = 0.8
"""Share of the weight in one cluster, and of the usual fit of a scan, from which on the pose counts
as known."""
COARSE = 4
"""One of this many beams judges random poses, of which there are as many as particles."""


def effective_sample_size(weights: Weights) -> Scalar:
    """Return `1 / sum w^2`: K with equal weights, 1 if one particle has all."""
    return 1.0 / (weights**2).sum()


def low_variance_indices(weights: Weights, offset: Scalar) -> Int[Array, " K"]:
    """Draw K particles by the low-variance sampler: particle i floor(K w_i) or ceil(K w_i) times.

    Draw j is the first particle whose cumulative weight exceeds `(j + offset) / K`. The weights add
    up to 1, and the offset is random, uniform in [0, 1).

    Source: Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, table 4.4.
    """
    number = weights.shape[0]
    return indices_at(weights, (jnp.arange(number, dtype=jnp.float32) + offset) / number)


def indices_at(weights: Weights, levels: Float[Array, " M"]) -> Int[Array, " M"]:
    """Return the first particle (M,) whose cumulative weight exceeds each level in [0, 1).

    The weights add up to 1.
    """
    cumulative = jnp.cumsum(weights)
    # The sum is 1 only up to rounding; a level beyond it would be a particle without weight.
    levels = levels * cumulative[-1]
    index = jnp.searchsorted(cumulative, levels, side="right")
    return jnp.minimum(index, weights.shape[0] - 1)


class Particles(NamedTuple):
    """A distribution of the pose, as a particle filter holds it.

    Args:
        poses: poses (K, 3) as (x, y, yaw) [m, m, rad].
        weights: weights (K,) of the poses, which add up to 1.
        slow: slow mean of how well scans fit, in [0, 1].
        fast: fast mean of the same.
    """

    poses: Poses
    weights: Weights
    slow: Scalar
    fast: Scalar

    @property
    def effective_sample_size(self) -> Scalar:
        """Return `1 / sum w^2`: K with equal weights, 1 if one particle has all."""
        return effective_sample_size(self.weights)


class PoseEstimate(NamedTuple):
    """Where the robot is, by the heaviest cluster of particles.

    Args:
        pose: mean (x, y, yaw) of the cluster, the yaw on the circle, in [-pi, pi] [m, m, rad].
        covariance: covariance (3, 3) of the cluster around it.
        share: share of the weight that is in the cluster, in [0, 1].
        is_converged: whether that is at least 0.8, and scans fit at least 0.8 times as well as they
            do usually. If not, the robot may as well be elsewhere, and the covariance says nothing
            about that. After a robot is carried away, it takes a few scans to become False.
    """

    pose: Pose
    covariance: Matrix
    share: Scalar
    is_converged: Flag


class ParticleFilter(eqx.Module):
    """Monte Carlo localisation on a known map, with recovery from a wrong pose.

    A motion moves each particle by the measured increment with noise of the odometry's covariance.
    A scan multiplies the weight of each particle by

        L^temper,   log L = sum_b log((1 - outlier_share) exp(-d_b^2 / (2 distance_std^2))
                                      + outlier_share)

    with d_b the distance of the end of beam b from the nearest wall. Beams are not independent,
    because they share the errors of the map and of the model. So `num_beams` of them count like
    `temper * num_beams` independent ones. Beams without a return do not count.

    If the effective sample size is below K / 2, particles are drawn anew by the low-variance
    sampler. To recover from a wrong pose the filter compares how well scans fit now and before,

        fit = sum_i w_i L_i^(1 / number of beams),   slow += slow_rate (fit - slow),
        fast += fast_rate (fit - fast),   p = max(0, 1 - fast / slow)

    and replaces each particle with the probability p. Both means begin at `usual_fit`, so that a
    robot that never knew its pose and settles at a wrong one is found as well. The new particles
    are drawn from K random poses on free cells by their likelihood, of every fourth beam: with 500
    particles in a hall of 80 m^2, a robot that was carried away was lost for 6 scans, in the mean
    of 8 runs, instead of 19 with random poses alone.

    All methods may be traced, and mapped over several filters. `likelihood_field` and `init_around`
    check what they are given if it is not traced. Nothing else raises: a motion that is not finite
    is none, a point that is not finite does not count, and a pose that is not finite is replaced.

    Source: Thrun, Burgard and Fox, "Probabilistic Robotics", 2005: tables 4.4 (low-variance
    sampler), 6.3 (likelihood field) and 8.3 (augmented MCL). There the fit is the product over all
    beams; its root is used here, which does not depend on their number. Particles that are drawn
    from the scan: Lenser and Veloso, "Sensor resetting localization for poorly modelled mobile
    robots", 2000.

    Args:
        odometry: model of the odometry; `Odometry()` by default.
        num_particles: number of particles, K.
        num_beams: number of beams of a scan that count, evenly spread; all if a scan has fewer.
        max_distance: bound of the distance from a wall [m]; static. Three times `distance_std` are
            enough.
        distance_std: standard deviation of the distance of a beam's end from a wall [m].
        outlier_share: share of beams that end at nothing on the map, in (0, 1).
        temper: exponent of the likelihood, in (0, 1].
        usual_fit: fit of scans at the right pose that is expected before the first scan, in (0, 1].
            It was 0.93 in a simulated room and 0.73 in a real building, on a map of other scans.
        slow_rate: share of a scan in the slow mean of the fit, in [0, 1].
        fast_rate: share of a scan in the fast mean of the fit, in [0, 1].
        cluster_radius: greatest distance from the centre of a cluster [m].
        cluster_angle: greatest difference from its yaw [rad].

    Raises:
        ValueError: something else than an `OdometryModel`, a number of particles or beams below 1,
            a distance that is not positive, a share or a rate outside its bounds.
    """

    odometry: OdometryModel
    num_particles: int = eqx.field(static=True)
    num_beams: int = eqx.field(static=True)
    max_distance: float = eqx.field(static=True)
    distance_std: Scalar
    outlier_share: Scalar
    temper: Scalar
    usual_fit: Scalar
    slow_rate: Scalar
    fast_rate: Scalar
    cluster_radius: Scalar
    cluster_angle: Scalar

    @_kinds.check_arguments
    def __init__(
        self,
        odometry: OdometryModel | None = None,
        num_particles: int = 2000,
        num_beams: int = 60,
        *,
        max_distance: float = 0.6,
        distance_std: ArrayLike = 0.2,
        outlier_share: ArrayLike = 0.2,
        temper: ArrayLike = 0.3,
        usual_fit: ArrayLike = 0.8,
        slow_rate: ArrayLike = 0.02,
        fast_rate: ArrayLike = 0.2,
        cluster_radius: ArrayLike = 1.0,
        cluster_angle: ArrayLike = 0.5,
    ) -> None:
        self.odometry = Odometry() if odometry is None else odometry
        self.num_particles = _checks.positive_int(
            "num_particles", num_particles, at_most=MOST_SAMPLES
        )
        self.num_beams = _checks.positive_int("num_beams", num_beams, at_most=MOST_BEAMS)
        self.max_distance = _checks.number(
            "max_distance", max_distance, above=0.0, at_most=LONGEST_RANGE
        )
        self.distance_std = _checks.scalar("distance_std", distance_std, above=0.0)
        self.outlier_share = _checks.scalar("outlier_share", outlier_share, above=0.0, below=1.0)
        self.temper = _checks.scalar("temper", temper, above=0.0, at_most=1.0)
        self.usual_fit = _checks.scalar("usual_fit", usual_fit, above=0.0, at_most=1.0)
        self.slow_rate = _checks.scalar("slow_rate", slow_rate, at_least=0.0, at_most=1.0)
        self.fast_rate = _checks.scalar("fast_rate", fast_rate, at_least=0.0, at_most=1.0)
        self.cluster_radius = _checks.scalar("cluster_radius", cluster_radius, above=0.0)
        self.cluster_angle = _checks.scalar("cluster_angle", cluster_angle, above=0.0)

    @_kinds.check_arguments
    def likelihood_field(self, grid: OccupancyGrid) -> LikelihoodField:
        """Return a known map as the filter reads it.

        Args:
            grid: known map.

        Raises:
            ValueError: something else than an `OccupancyGrid`, or one without a free cell.
        """
        known = grid.probability
        # In NumPy: while something else is traced, JAX traces what is made of known arrays too.
        if not _kinds.is_traced(known) and not (np.asarray(known) < FREE_THRESHOLD).any():
            raise ValueError("grid has no free cell; accepted: a map with free cells")
        return LikelihoodField.of(grid, self.max_distance)

    def init_around(self, pose: Vector, covariance: Rows, key: Key) -> Particles:
        """Return particles of a normal distribution, for a robot that knows about where it is.

        Args:
            pose: mean (x, y, yaw) [m, m, rad].
            covariance: covariance (3, 3), which may be singular.
            key: random key.

        Raises:
            ValueError: a pose that is not three finite numbers, a covariance that is not symmetric
                and positive semidefinite.
        """
        _kinds.key("key", key)
        mean = _checks.vector("pose", pose, 3)
        spread = _covariances.covariance("covariance", covariance, 3)
        # Unlike that of Cholesky this root exists for a coordinate that is known exactly.
        values, vectors = jnp.linalg.eigh(spread)
        root = vectors * jnp.sqrt(jnp.maximum(values, 0.0))
        normal = jax.random.normal(key, (self.num_particles, 3))
        return self._unseen(mean + normal @ root.T)

    def init_everywhere(self, field: LikelihoodField, key: Key) -> Particles:
        """Return particles that are uniform over the free cells of a map and all yaws.

        Args:
            field: known map.
            key: random key.
        """
        return self._unseen(field.random_poses(self.num_particles, key))

    def predict(
        self,
        particles: Particles,
        increment: Pose,
        elapsed: Scalar,
        key: Key,
        *,
        covariance: Matrix | None = None,
    ) -> Particles:
        """Return the particles after a measured motion.

        Args:
            particles: particles before it.
            increment: measured motion (dx, dy, dyaw) in the frame of the robot [m, m, rad].
            elapsed: time that it took [s].
            key: random key of the noise.
            covariance: covariance (3, 3) of the motion; that of the odometry when absent.
        """
        is_known = jnp.isfinite(increment).all() & jnp.isfinite(elapsed)
        increment = jnp.where(is_known, increment, 0.0)
        elapsed = jnp.where(is_known, elapsed, 0.0)
        if covariance is None:
            covariance = self.odometry.covariance(increment, elapsed)
        stds = jnp.sqrt(jnp.maximum(jnp.diagonal(covariance), 0.0))
        normal = jax.random.normal(key, particles.poses.shape)
        poses = jax.vmap(compose)(particles.poses, increment + stds * normal)
        # Single precision would lose digits of a yaw that grows with each turn.
        return particles._replace(poses=poses.at[:, 2].set(wrap_angle(poses[:, 2])))

    def update(
        self,
        particles: Particles,
        points: Points,
        is_return: Bool[Array, " B"],
        field: LikelihoodField,
        key: Key,
    ) -> Particles:
        """Return the particles after a scan. Without a return that counts nothing is learned.

        Args:
            particles: particles before it.
            points: ends (B, 2) of its beams in the frame of the robot [m], as of `Scan.points`.
            is_return: mask (B,) of the beams that returned.
            field: known map.
            key: random key.
        """
        number = self.num_particles
        keys = jax.random.split(key, 3)
        points, is_counted = self.select_ends(points, is_return)
        logs = self.log_likelihoods(particles.poses, points, is_counted, field)
        # A pose that is not finite has no likelihood, and is replaced below.
        is_lost = ~jnp.isfinite(particles.poses).all(axis=1)
        weights = _update_weights(
            particles.weights, jnp.where(is_lost, -jnp.inf, self.temper * logs)
        )
        count = is_counted.sum()
        per_beam = jnp.exp(logs / jnp.maximum(count, 1).astype(jnp.float32))
        fit = (particles.weights * jnp.where(is_lost, 0.0, per_beam)).sum()
        slow = self._mean(particles.slow, fit, self.slow_rate, count)
        fast = self._mean(particles.fast, fit, self.fast_rate, count)
        share = jnp.where(count > 0, 1.0 - fast / jnp.maximum(slow, 1e-9), 0.0)
        is_random = jax.random.uniform(keys[0], (number,)) < share
        # Fitting poses come with drawing anew, because they need the weight of other particles.
        is_due = (2.0 * effective_sample_size(weights) < number) | (is_random | is_lost).any()
        index = low_variance_indices(weights, jax.random.uniform(keys[1], ()))
        is_random = is_random | is_lost[index]
        fresh = self._sample_fitting_poses(points, is_counted, field, keys[2])
        drawn = jnp.where(is_random[:, None], fresh, particles.poses[index])
        return Particles(
            poses=jnp.where(is_due, drawn, particles.poses),
            weights=jnp.where(is_due, 1.0 / number, weights),
            slow=slow,
            fast=fast,
        )

    def log_likelihoods(
        self,
        poses: Poses,
        points: Points,
        is_counted: Bool[Array, " B"],
        field: LikelihoodField,
    ) -> Weights:
        """Return log L of all given beams for each pose (K,), not tempered.

        Args:
            poses: poses (K, 3) [m, m, rad].
            points: ends (B, 2) of beams in the frame of the robot [m].
            is_counted: mask (B,) of the beams that count.
            field: known map.
        """
        of_each = jax.vmap(field.log_likelihood, in_axes=(0, None, None, None, None))
        return of_each(poses, points, is_counted, self.distance_std, self.outlier_share)

    def estimate(self, particles: Particles) -> PoseEstimate:
        """Return the pose by the heaviest cluster of particles.

        Clusters are the particles within `cluster_radius` and `cluster_angle` of one of 64, which
        are spread evenly over the weight. The heaviest is centred at its mean once. A mean over all
        particles would lie between two places that the robot may be in.

        Args:
            particles: the particles.
        """
        poses, weights = particles.poses, particles.weights
        number = min(CANDIDATES, self.num_particles)
        evenly = (jnp.arange(number, dtype=jnp.float32) + 0.5) / number
        chosen = poses[indices_at(weights, evenly)]
        in_each = jax.vmap(self.is_near, in_axes=(None, 0))(poses, chosen)
        mass = jnp.where(in_each, weights, 0.0).sum(axis=1)
        heaviest = jnp.argmax(mass)
        centre = _mean_pose(poses, jnp.where(in_each[heaviest], weights, 0.0), chosen[heaviest])
        members = jnp.where(self.is_near(poses, centre), weights, 0.0)
        pose = _mean_pose(poses, members, centre)
        share = members.sum()
        away = jnp.where((members > 0.0)[:, None], poses - pose, 0.0)
        away = away.at[:, 2].set(wrap_angle(away[:, 2]))
        covariance = (members[:, None] * away).T @ away / jnp.maximum(share, 1e-9)
        fits = particles.fast >= CONVERGED_SHARE * particles.slow
        return PoseEstimate(pose, covariance, share, (share >= CONVERGED_SHARE) & fits)

    def _unseen(self, poses: Poses) -> Particles:
        """Return particles of equal weight before the first scan."""
        number = self.num_particles
        weights = jnp.full((number,), 1.0 / number, jnp.float32)
        return Particles(poses, weights, self.usual_fit, self.usual_fit)

    def _sample_fitting_poses(
        self, points: Points, is_counted: Bool[Array, " B"], field: LikelihoodField, key: Key
    ) -> Poses:
        """Return poses (K, 3) that are drawn from K random ones by how well a scan fits."""
        keys = jax.random.split(key)
        poses = field.random_poses(self.num_particles, keys[0])
        few = points[::COARSE], is_counted[::COARSE]
        # As if all beams fitted like these few.
        scale = is_counted.sum().astype(jnp.float32) / jnp.maximum(few[1].sum(), 1).astype(
            jnp.float32
        )
        logs = self.temper * scale * self.log_likelihoods(poses, *few, field)
        weights = jax.nn.softmax(logs)
        return poses[low_variance_indices(weights, jax.random.uniform(keys[1], ()))]

    def select_ends(
        self, points: Points, is_return: Bool[Array, " B"]
    ) -> tuple[Float[Array, "M 2"], Bool[Array, " M"]]:
        """Return the ends (M, 2) of the beams that count, and the mask of those that are valid.

        Args:
            points: ends (B, 2) of all beams of a scan [m].
            is_return: mask (B,) of those that returned.
        """
        chosen = np.linspace(0, len(points) - 1, min(self.num_beams, len(points))).round()
        index = chosen.astype(np.int32)
        points, is_counted = points[index], is_return[index]
        is_counted = is_counted & jnp.isfinite(points).all(axis=1)
        return jnp.where(is_counted[:, None], points, 0.0), is_counted

    def _mean(self, mean: Scalar, fit: Scalar, rate: Scalar, count: Int[Array, ""]) -> Scalar:
        """Return a running mean after a scan, of which some beams must count."""
        return jnp.where(count > 0, mean + rate * (fit - mean), mean)

    def is_near(self, poses: Poses, centre: Pose) -> Bool[Array, " K"]:
        """Return the mask (K,) of the poses that belong to the cluster around a pose.

        Args:
            poses: poses (K, 3) [m, m, rad].
            centre: the pose around which the cluster is.
        """
        away = poses - centre
        distance = jnp.hypot(away[:, 0], away[:, 1])
        turn = jnp.abs(wrap_angle(away[:, 2]))
        return (distance <= self.cluster_radius) & (turn <= self.cluster_angle)


def _update_weights(weights: Weights, log_likelihoods: Weights) -> Weights:
    """Return weights times likelihoods, so that they add up to 1; as before if none is left."""
    logs = jnp.log(weights) + log_likelihoods
    is_left = logs.max() > -jnp.inf
    return jnp.where(is_left, jax.nn.softmax(jnp.where(is_left, logs, 0.0)), weights)


def _mean_pose(poses: Poses, weights: Weights, otherwise: Pose) -> Pose:
    """Return the weighted mean of poses, the yaw on the circle; without any weight `otherwise`."""
    total = weights.sum()
    is_any = total > 0.0
    share = jnp.where(weights > 0.0, weights, 0.0) / jnp.where(is_any, total, 1.0)
    held = jnp.where((share > 0.0)[:, None], poses, 0.0)
    position = share @ held[:, :2]
    yaw = jnp.arctan2(share @ jnp.sin(held[:, 2]), share @ jnp.cos(held[:, 2]))
    return jnp.where(is_any, jnp.append(position, yaw), otherwise)
