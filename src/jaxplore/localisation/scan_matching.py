"""Match a scan to a map of surfaces: a correlative search, then Gauss-Newton with a covariance."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, Count, Pose, Scalar
from jaxplore.geometry.motion import Matrix, transform_points
from jaxplore.localisation.surface import EndPoints, SurfaceMap

TIE = 1e-3
"""Weight of the prior in the search: among poses that fit equally well the most likely one."""
LEAST_STD = 0.01
"""Least standard deviation of a residual [m]."""
NOISY = 2.0
"""Information, relative to that which errors of normals add, below which nothing was measured."""
SAMPLES = 2.0
"""Weight that an end point gives a cell on its normal: a map takes samples half a cell apart."""
LEAST_RATIO = 0.2
"""Least number of mapped end points that is believed for each end point of a scan."""
MAP_ERROR = 0.02
"""Standard deviation of the error of a mapped surface that more scans do not lessen [cells]."""
SECTORS = 16
"""Number of sectors of a scan in each of which this error is the same."""
FARTHEST = 3.0
"""Standard deviations of the guess beyond which the search does not go."""
CHUNK = 64
"""Number of poses whose scores are computed at once."""


Numbers = Float[Array, " N"]
Vectors = Float[Array, "N 2"]


class ScanMatch(NamedTuple):
    """Result of a match.

    Args:
        pose: pose (x, y, yaw) [m, m, rad].
        covariance: its covariance (3, 3), in the world.
        share: share of the end points that lie on a known surface, within twice `sigma`.
        residual: weighted root mean square of the distances of the end points [m].
    """

    pose: Pose
    covariance: Matrix
    share: Scalar
    residual: Scalar


class ScanMatcher(eqx.Module):
    """Finds the pose at which the end points of a scan lie on the surfaces of a map.

    With d the signed distance of the map, T(p) the motion from the robot to the world and x_i the
    end points, the search takes the pose of a lattice around the guess with the greatest score

        mean over i of exp(-d(T(p) x_i)^2 / (2 sigma^2)) - 0.001 (p - p_0)' P^-1 (p - p_0)

    Gauss-Newton then minimises the sum over i of w_i d(T(p) x_i)^2 / s^2 and the distance from the
    guess, with the weights w_i = (1 + d^2 / sigma^2)^-2 of Geman and McClure. With J_i the gradient
    of d(T(p) x_i), s^2 the weighted mean of the squared distances and psi = w d, the covariance is
    that of such an estimate (the sandwich of Huber),

        H^-1 M H^-1,   H = E[psi'] sum over i of J_i' J_i / s^2 + P^-1
        M = E[psi^2] sum over i of (1 + 1 / r_i) J_i' J_i / s^4
            + b^2 sum over g of S_g' S_g / s^4 + P^-1

    The map is made of end points with noise of their own, which all points beside them share: r_i
    is their number for each point of the scan. b is an error of the map that does not become less
    with more scans, from cells and corners: 2 % of a cell, the same within each of 16 sectors, for
    which S_g is the sum of the w_i J_i.

    d is read half-way between the ends of the band of the map, along the normal n of the end point:
    d(T(p) x) is taken as d(T(p) x + a n) - a n . grad d. So points before a surface and behind it
    are known equally far.

    Where the end point is on a line, its normal takes the place of the gradient of d. Directions in
    which the sum is no more than what errors of normals would add, such as along a corridor, are
    left out of it, and of the steps.

    Source: Olson, "Real-time correlative scan matching", ICRA 2009; Kohlbrecher et al., "A flexible
    and scalable SLAM system with full 3D motion estimation", SSRR 2011; Huber, "The behavior of
    maximum likelihood estimates under nonstandard conditions", 1967.

    Args:
        sigma: distance at which an end point counts half as much or less [m].
        steps: number of steps of the lattice to either side along x and y; static.
        spacing: greatest spacing of the lattice along x and y [m]; it is less where the lattice
            would go beyond three standard deviations of the guess.
        turn_spacing: greatest spacing of its yaw [rad], likewise.
        turn_steps: number of steps to either side in yaw; `steps` when absent; static.
        search_points: number of end points in the search; static.
        iterations: number of steps of Gauss-Newton; static.

    Raises:
        ValueError: a number that is not positive.
    """

    sigma: Scalar
    spacing: Scalar
    turn_spacing: Scalar
    steps: int = eqx.field(static=True)
    turn_steps: int = eqx.field(static=True)
    search_points: int = eqx.field(static=True)
    iterations: int = eqx.field(static=True)

    def __init__(
        self,
        sigma: ArrayLike = 0.1,
        *,
        steps: int = 3,
        spacing: ArrayLike = 0.1,
        turn_spacing: ArrayLike = 0.02,
        turn_steps: int | None = None,
        search_points: int = 90,
        iterations: int = 6,
    ) -> None:
        self.sigma = _checks.scalar("sigma", sigma, above=0.0)
        self.spacing = _checks.scalar("spacing", spacing, above=0.0)
        self.turn_spacing = _checks.scalar("turn_spacing", turn_spacing, above=0.0)
        self.steps = _checks.positive_int("steps", steps)
        self.turn_steps = self.steps
        if turn_steps is not None:
            self.turn_steps = _checks.positive_int("turn_steps", turn_steps)
        self.search_points = _checks.positive_int("search_points", search_points)
        self.iterations = _checks.positive_int("iterations", iterations)

    def __call__(
        self, surface: SurfaceMap, ends: EndPoints, guess: Pose, covariance: Matrix, way: Scalar
    ) -> ScanMatch:
        """Match a scan.

        Where the result is not finite it is the guess, with a share of 0.

        Args:
            surface: the map.
            ends: end points of the scan.
            guess: pose (x, y, yaw) by the odometry [m, m, rad].
            covariance: covariance (3, 3) of the guess, in the world.
            way: length of the robot's way so far [m].
        """
        prior = jnp.linalg.inv(covariance)
        start = self.search(surface, ends, guess, covariance, way)
        kept = filter_information(*self._system(surface, ends, start, way)[:2])

        def step(_: Count, pose: Pose) -> Pose:
            information, _tilt, gradient, *_rest = self._system(surface, ends, pose, way)
            normal = kept @ information @ kept.T + prior
            slope = kept @ (kept @ gradient) + prior @ (pose - guess)
            better: Pose = pose - jnp.linalg.solve(normal, slope)
            return better

        pose: Pose = jax.lax.fori_loop(0, self.iterations, step, start)
        _, _, _, share, residual = self._system(surface, ends, pose, way)
        information, spread = self._sandwich(surface, ends, pose, way)
        inverse = jnp.linalg.inv(kept @ information @ kept.T + prior)
        found = inverse @ (kept @ spread @ kept.T + prior) @ inverse
        found = 0.5 * (found + found.T)
        is_finite = jnp.isfinite(pose).all() & jnp.isfinite(found).all()
        return ScanMatch(
            jnp.where(is_finite, pose, guess),
            jnp.where(is_finite, found, covariance),
            jnp.where(is_finite, share, 0.0),
            jnp.where(is_finite, residual, jnp.inf),
        )

    def search(
        self, surface: SurfaceMap, ends: EndPoints, guess: Pose, covariance: Matrix, way: Scalar
    ) -> Pose:
        """Return the pose of the lattice with the greatest score; arguments as in a call."""
        offsets = self.offsets(covariance)
        prior = jnp.linalg.inv(covariance)
        few = ends.every(max(1, ends.points.shape[0] // self.search_points))
        number = jnp.maximum(few.is_point.sum(dtype=jnp.float32), 1.0)

        def score(offset: Pose) -> Scalar:
            cells = jax.vmap(surface.frame.to_cell)(transform_points(guess + offset, few.points))
            away = jax.vmap(surface.nearest, (0, None))(cells, way)
            # Unknown cells are a band away, and count nothing.
            near = jnp.where(away < surface.band, jnp.exp(-0.5 * (away / self.sigma) ** 2), 0.0)
            fit = jnp.sum(jnp.where(few.is_point, near, 0.0)) / number
            unlikely: Scalar = offset @ prior @ offset
            return fit - TIE * unlikely

        scores: Array = jax.lax.map(score, offsets, batch_size=CHUNK)
        return guess + offsets[jnp.argmax(scores)]

    def offsets(self, covariance: Matrix) -> Float[Array, "K 3"]:
        """Return the differences from the guess that the search tries.

        Args:
            covariance: covariance (3, 3) of the guess.
        """
        count, turns = (
            jnp.arange(-steps, steps + 1, dtype=jnp.float32)
            for steps in (self.steps, self.turn_steps)
        )
        lattice = jnp.stack(jnp.meshgrid(count, count, turns, indexing="ij"), axis=-1)
        greatest = jnp.stack([self.spacing, self.spacing, self.turn_spacing])
        steps = jnp.array([self.steps, self.steps, self.turn_steps], jnp.float32)
        std = jnp.sqrt(jnp.diagonal(covariance))
        offsets: Array = lattice.reshape(-1, 3) * jnp.minimum(FARTHEST / steps * std, greatest)
        return offsets

    def _system(
        self, surface: SurfaceMap, ends: EndPoints, pose: Pose, way: Scalar
    ) -> tuple[Matrix, Matrix, Pose, Scalar, Scalar]:
        """Return the information of a scan, what of it the errors of normals add, the gradient, the
        share and the residual at a pose."""
        away, slope, arm, is_used, weight, least = self._residuals(surface, ends, pose, way)
        rows = _rows(slope, arm)
        information = jnp.einsum("n,ni,nj->ij", weight, rows, rows) / least
        along = _rows(jnp.stack([-slope[:, 1], slope[:, 0]], axis=1), arm)
        tilt = jnp.einsum("n,ni,nj->ij", weight * ends.tilt, along, along) / least
        gradient = (weight * away) @ rows / least
        is_near = is_used & (jnp.abs(away) <= 2.0 * self.sigma)
        number = jnp.maximum(ends.is_point.sum(dtype=jnp.float32), 1.0)
        share = is_near.sum(dtype=jnp.float32) / number
        residual = jnp.sqrt(jnp.sum(weight * away**2) / jnp.maximum(weight.sum(), 1.0))
        return information, tilt, gradient, share, residual

    def _residuals(
        self, surface: SurfaceMap, ends: EndPoints, pose: Pose, way: Scalar
    ) -> tuple[Numbers, Vectors, Vectors, Bool[Array, " N"], Numbers, Scalar]:
        """Return the distances of the end points, their slopes, the points relative to the sensor,
        which of them count, their weights, and the weighted mean of the squares, at least that of
        `LEAST_STD`."""
        points = transform_points(pose, ends.points)
        own = transform_points(pose * jnp.array([0.0, 0.0, 1.0]), ends.normals)
        # In the middle of the band: on the surface, points before it are known further than points
        # behind it. Their mean would pull the pose ahead in clutter, at every scan.
        shift = 0.5 * (surface.band - surface.depth)
        away, slope, is_known = jax.vmap(surface.at, (0, None))(points + shift * own, way)
        # The map's own slope along a wall is noise, which would count as information.
        slope = jnp.where(ends.is_flat[:, None], own, slope)
        away = away - shift * (slope * own).sum(axis=1)
        is_used = ends.is_point & is_known
        weight = jnp.where(is_used, (1.0 + (away / self.sigma) ** 2) ** -2, 0.0)
        variance = jnp.sum(weight * away**2) / jnp.maximum(weight.sum(), 1.0)
        least = jnp.maximum(variance, LEAST_STD**2)
        return away, slope, points - pose[:2], is_used, weight, least

    def _sandwich(
        self, surface: SurfaceMap, ends: EndPoints, pose: Pose, way: Scalar
    ) -> tuple[Matrix, Matrix]:
        """Return H and M of the covariance, without the prior."""
        away, slope, arm, is_used, weight, least = self._residuals(surface, ends, pose, way)
        rows, used = _rows(slope, arm), is_used.astype(jnp.float32)
        number = jnp.maximum(used.sum(), 1.0)
        square = (away / self.sigma) ** 2
        # psi' is w + d w', which is negative far from the surface.
        bend = weight * (1.0 - 4.0 * square / (1.0 + square))
        bent = jnp.maximum(bend.sum() / number, 0.1)
        freedom = jnp.maximum(number / jnp.maximum(number - 3.0, 1.0), 1.0)
        noise = freedom * jnp.sum((weight * away) ** 2) / number
        noise = jnp.maximum(noise, (bent * LEAST_STD) ** 2)
        # How many end points the map has there for each one of the scan.
        points, side = arm + pose[:2], surface.frame.resolution
        row, column = jnp.unstack(jax.vmap(surface.frame.to_cell)(points), axis=-1)
        mapped = surface.weights.at[row, column].get(mode="fill", fill_value=0.0) / SAMPLES
        beside = jnp.roll(points, -1, axis=0) - jnp.roll(points, 1, axis=0)
        apart = jnp.minimum(0.5 * jnp.hypot(beside[:, 0], beside[:, 1]) / side, 1.0)
        ratio = jnp.maximum(mapped * apart, LEAST_RATIO)
        information = bent * jnp.einsum("n,ni,nj->ij", used, rows, rows) / least
        own = noise * jnp.einsum("n,ni,nj->ij", used * (1.0 + 1.0 / ratio), rows, rows)
        sector = jnp.arange(rows.shape[0]) * SECTORS // rows.shape[0]
        sums = jax.ops.segment_sum(weight[:, None] * rows, sector, SECTORS)
        shared = (MAP_ERROR * side) ** 2 * (sums.T @ sums)
        return information, (own + shared) / least**2


def _rows(slope: Float[Array, "N 2"], arm: Float[Array, "N 2"]) -> Float[Array, "N 3"]:
    """Return the derivatives (N, 3) of distances by the pose.

    `slope` are the gradients of the distances at the end points, and `arm` the end points relative
    to the sensor, in the world [m].
    """
    by_yaw = slope[:, 1] * arm[:, 0] - slope[:, 0] * arm[:, 1]
    return jnp.concatenate([slope, by_yaw[:, None]], axis=1)


def filter_information(
    information: Float[Array, "K K"], tilt: Float[Array, "K K"], noisy: float = NOISY
) -> Float[Array, "K K"]:
    """Return the matrix K that keeps of an information A what errors of normals do not explain.

    Along a corridor, normals with errors seem to measure the position. In the basis in which the
    information that they add is the identity, K A K' has for each eigenvalue v of A the eigenvalue
    `max(v - noisy, 0)`.

    Source: after Zhang, Kaess and Singh, "On degeneracy of optimization-based state estimation
    problems", ICRA 2016, where the directions of small eigenvalues are left out.

    Args:
        information: information A (K, K) of a scan.
        tilt: (K, K) what errors of normals add to it.
        noisy: information, relative to that, below which nothing was measured.
    """
    # So that it can be inverted where normals have no errors, or nothing was measured.
    least = 1e-6 * (jnp.diagonal(information) + 1.0)
    root = jnp.linalg.cholesky(tilt + jnp.diag(least))
    inverse = jnp.linalg.inv(root)
    values, vectors = jnp.linalg.eigh(inverse @ information @ inverse.T)
    share = jnp.maximum(values - noisy, 0.0) / jnp.maximum(values, noisy)
    kept: Array = root @ (vectors * jnp.sqrt(share)) @ vectors.T @ inverse
    return kept
