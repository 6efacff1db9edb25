"""The pose of a robot on a map that it knows, by a particle filter."""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Count, Flag, Key, Pose, Scalar
from jaxplore.geometry.motion import Matrix, compose, propagate_covariance, rotation
from jaxplore.localisation.estimator import PoseEstimator
from jaxplore.localisation.likelihood_field import LikelihoodField
from jaxplore.localisation.odometry_model import ErrorEstimate, OdometryModel, Reckoning
from jaxplore.localisation.particles import ParticleFilter, Particles, PoseEstimate
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.sensing.beams import Beams, Scan


class StoredPoses(NamedTuple):
    """Estimated poses along the way, in arrays with room for K of them.

    Args:
        poses: (K, 3) poses (x, y, yaw) [m, m, rad].
        way: (K,) length of the robot's way up to each [m].
        number: number of stored poses.
    """

    poses: Float[Array, "K 3"]
    way: Float[Array, " K"]
    number: Count

    @classmethod
    def none(cls, capacity: int) -> "StoredPoses":
        """Return room for poses.

        Args:
            capacity: greatest number of poses.
        """
        return cls(jnp.zeros((capacity, 3)), jnp.zeros(capacity), jnp.zeros((), jnp.int32))

    @property
    def capacity(self) -> int:
        """Greatest number of poses."""
        return int(self.way.shape[0])

    @property
    def last(self) -> Count:
        """Index of the newest pose; 0 without any."""
        return jnp.maximum(self.number - 1, 0)

    def with_pose(self, is_due: Flag, pose: Pose, way: Scalar) -> "StoredPoses":
        """Return the poses with another one; unchanged where there is no room.

        Args:
            is_due: whether it is stored.
            pose: the pose.
            way: length of the robot's way [m].
        """
        at = jnp.where(is_due, self.number, self.capacity)
        return StoredPoses(
            self.poses.at[at].set(pose, mode="drop"),
            self.way.at[at].set(way, mode="drop"),
            jnp.minimum(self.number + is_due.astype(jnp.int32), self.capacity),
        )


class ParticleState(NamedTuple):
    """What a `ParticleLocaliser` knows.

    Args:
        particles: the particles at the newest scan.
        found: the pose at the newest scan, by the heaviest cluster of particles.
        motion: motion since then by the odometry, in the frame of that pose [m, m, rad].
        covariance: (3, 3) covariance of that motion, in that frame.
        errors: what is known of the odometry's errors; None where nothing is estimated of them. Its
            covariance with the pose is that with the motion.
        elapsed: time since then [s].
        way: length of the robot's way by its odometry [m].
        field: the known map.
        scans: estimated poses at some of the scans.
        key: random key.
        number: number of scans.
    """

    particles: Particles
    found: PoseEstimate
    motion: Pose
    covariance: Matrix
    errors: ErrorEstimate | None
    elapsed: Scalar
    way: Scalar
    field: LikelihoodField
    scans: StoredPoses
    key: Key
    number: Count

    @property
    def pose(self) -> Pose:
        """Pose by the heaviest cluster of particles and the motion since the newest scan."""
        return compose(self.found.pose, self.motion)

    @property
    def is_known(self) -> Flag:
        """Whether the filter has converged, see `PoseEstimate`."""
        return self.found.is_converged

    @property
    def share(self) -> Scalar:
        """Fast mean of how well scans fit the map, in [0, 1]."""
        return self.particles.fast

    @property
    def uncertainty(self) -> Scalar:
        """Standard deviation of the position [m], the root of the mean of its variances along x
        and y: of the heaviest cluster, or of all particles if the filter has not converged."""
        near = self.found.covariance[0, 0] + self.found.covariance[1, 1]
        weights, places = self.particles.weights, self.particles.poses[:, :2]
        away = places - weights @ places
        total = weights @ (away * away).sum(axis=1)
        return jnp.sqrt(0.5 * jnp.where(self.is_known, near, total))


class ParticleLocaliser(PoseEstimator):
    """Estimates the pose of a robot on a map that it knows, by a `ParticleFilter`.

    The particles begin around the start, or on all free cells of the map if the robot does not know
    where it starts. A scan of the first sensor updates them; between scans the pose follows the
    odometry. The map is never changed, so a scan counts where the robot's own map speaks against it
    as well: that is how a robot that was carried away finds itself.

    Before each scan every particle moves a little at random, also while the robot stands. Else
    those that a scan has drawn anew stay where they are, some tenths of a metre from the true pose.

    Source: Gordon, Salmond and Smith, "Novel approach to nonlinear/non-Gaussian Bayesian state
    estimation", 1993, who call it roughening.

    Args:
        filter: the particle filter; a `ParticleFilter` with its defaults when absent.
        is_start_known: whether the robot knows about where it starts.
        start_std: standard deviation of the position at a known start, along x and y [m].
        start_yaw_std: standard deviation of the yaw there [rad].
        roughening_std: standard deviation of that random motion, along x and y [m].
        roughening_yaw_std: standard deviation of its turn [rad].
        spacing: way after which the estimated pose is stored, for the report [m].
        capacity: greatest number of stored poses; static.

    Raises:
        ValueError: a part of another class, a standard deviation below 0, a spacing or a capacity
            that is not positive.
    """

    is_mapping: ClassVar[bool] = False

    filter: ParticleFilter
    start_std: Scalar
    start_yaw_std: Scalar
    roughening_std: Scalar
    roughening_yaw_std: Scalar
    spacing: Scalar
    is_start_known: bool = eqx.field(static=True)
    capacity: int = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        filter: ParticleFilter | None = None,
        *,
        is_start_known: bool = True,
        start_std: ArrayLike = 0.1,
        start_yaw_std: ArrayLike = 0.05,
        roughening_std: ArrayLike = 0.02,
        roughening_yaw_std: ArrayLike = 0.01,
        spacing: ArrayLike = 0.25,
        capacity: int = 4096,
    ) -> None:
        self.filter = ParticleFilter() if filter is None else filter
        self.is_start_known = _kinds.flag("is_start_known", is_start_known)
        self.start_std = _checks.scalar("start_std", start_std, at_least=0.0)
        self.start_yaw_std = _checks.scalar("start_yaw_std", start_yaw_std, at_least=0.0)
        self.roughening_std = _checks.scalar("roughening_std", roughening_std, at_least=0.0)
        self.roughening_yaw_std = _checks.scalar(
            "roughening_yaw_std", roughening_yaw_std, at_least=0.0
        )
        self.spacing = _checks.scalar("spacing", spacing, above=0.0)
        self.capacity = _checks.positive_int("capacity", capacity)

    @property
    def expected_odometry(self) -> OdometryModel:
        """Errors of the odometry that the filter expects."""
        return self.filter.odometry

    def check_map(self, prior: OccupancyGrid | None) -> None:
        """Check that the map that the robot knows in advance is one to find a pose on.

        Args:
            prior: that map; None if it knows nothing.

        Raises:
            ValueError: no map, or one without a free cell.
        """
        if prior is None:
            raise ValueError(
                "prior is None for a robot that finds its pose on a known map; accepted: the map"
            )
        self.filter.likelihood_field(prior)

    def start(
        self, pose: Pose, grid: OccupancyGrid, sensors: Sequence[Beams], key: Key | None
    ) -> ParticleState:
        """Return the state at the start; see `PoseEstimator.start`."""
        pose = _checks.pose("pose", pose)
        key = jax.random.key(0) if key is None else key
        drawn, kept = jax.random.split(key)
        field = self.filter.likelihood_field(grid)
        if self.is_start_known:
            stds = jnp.stack([self.start_std, self.start_std, self.start_yaw_std])
            particles = self.filter.init_around(pose, jnp.diag(stds * stds), drawn)
        else:
            particles = self.filter.init_everywhere(field, drawn)
        nothing, none = jnp.zeros(()), jnp.zeros((), jnp.int32)
        return ParticleState(
            particles,
            self.filter.estimate(particles),
            jnp.zeros(3),
            jnp.zeros((3, 3)),
            self.expected_odometry.estimate(),
            nothing,
            nothing,
            field,
            StoredPoses.none(self.capacity),
            kept,
            none,
        )

    @_kinds.check_arguments
    def start_around(
        self, state: ParticleState, pose: Pose, position_std: Scalar, yaw_std: Scalar
    ) -> ParticleState:
        """Return the state of a robot that is told where it is, on the same map.

        Args:
            state: state before.
            pose: pose (x, y, yaw) [m, m, rad].
            position_std: standard deviation of the position, along x and y [m].
            yaw_std: standard deviation of the yaw [rad].
        """
        stds = jnp.stack([position_std, position_std, yaw_std])
        kept, drawn = jax.random.split(state.key)
        particles = self.filter.init_around(pose, jnp.diag(stds * stds), drawn)
        return state._replace(
            particles=particles,
            found=self.filter.estimate(particles),
            motion=jnp.zeros(3),
            covariance=jnp.zeros((3, 3)),
            elapsed=jnp.zeros(()),
            key=kept,
        )

    @_kinds.check_arguments
    def predict(self, state: ParticleState, motion: Pose, elapsed: Scalar) -> ParticleState:
        """Return the state after a motion; see `PoseEstimator.predict`.

        Particles move at the next scan: the odometry's variances do not depend on the rate.
        """
        known = Reckoning(state.motion, state.covariance, state.errors, state.way)
        known = self.expected_odometry.predict(known, motion, elapsed)
        return state._replace(
            motion=known.pose,
            covariance=known.covariance,
            errors=known.errors,
            elapsed=state.elapsed + elapsed,
            way=known.way,
        )

    @_kinds.check_arguments
    def correct(
        self, state: ParticleState, scans: Sequence[Scan], sensors: Sequence[Beams]
    ) -> ParticleState:
        """Return the state after scans; see `PoseEstimator.correct`."""
        keys = jax.random.split(jax.random.fold_in(state.key, state.number), 3)
        # What is estimated of the odometry's errors tells how exact this motion is.
        spread = None if state.errors is None else state.covariance
        particles = self.filter.predict(
            state.particles, state.motion, state.elapsed, keys[0], covariance=spread
        )
        stds = jnp.stack([self.roughening_std, self.roughening_std, self.roughening_yaw_std])
        rough = stds * jax.random.normal(keys[1], particles.poses.shape)
        particles = particles._replace(poses=particles.poses + rough)
        points = scans[0].points(sensors[0])
        particles = self.filter.update(particles, points, scans[0].is_return, state.field, keys[2])
        found = self.filter.estimate(particles)
        away = state.way - state.scans.way[state.scans.last]
        is_due = (state.scans.number == 0) | (away >= self.spacing)
        return state._replace(
            particles=particles,
            found=found,
            motion=jnp.zeros(3),
            covariance=jnp.zeros((3, 3)),
            errors=_learn_errors(state, found),
            elapsed=jnp.zeros(()),
            # A robot that does not know where it is claims no pose.
            scans=state.scans.with_pose(is_due & found.is_converged, found.pose, state.way),
            number=state.number + 1,
        )


def _learn_errors(state: ParticleState, found: PoseEstimate) -> ErrorEstimate | None:
    """Return what a scan tells of the odometry's errors; `state` is that before the scan."""
    errors, before = state.errors, state.found
    if errors is None:
        return None
    spread = propagate_covariance(before.pose, state.motion, before.covariance, state.covariance)
    known = errors._replace(cross=rotation(before.pose[2]) @ errors.cross)
    known = known.correct(state.pose, spread, found.pose, found.covariance)
    # Another place than before says nothing of the motion between them.
    is_same = before.is_converged & found.is_converged
    mean, covariance, _ = (
        jnp.where(is_same, new, old) for new, old in zip(known, errors, strict=True)
    )
    return ErrorEstimate(mean, covariance, jnp.zeros_like(errors.cross))
