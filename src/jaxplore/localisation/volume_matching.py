"""Match scans of a volume to its surfaces: Gauss-Newton over position and yaw."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, Count, Scalar
from jaxplore.geometry.level_motion import LevelMatrix, LevelPose, turn
from jaxplore.localisation.scan_matching import filter_information
from jaxplore.localisation.surface import ROUGH_WEIGHT
from jaxplore.localisation.volume_surface import (
    LEAST_NOISE,
    VolumePoints,
    VolumeSurface,
)

SHARED = 5.0
"""Number of points whose errors count as one: points beside each other share those of the map."""
NOISY = 0.5
"""Information, relative to that which errors of normals add, below which nothing was measured."""

Numbers = Float[Array, " N"]
Vectors = Float[Array, "N 3"]


class VolumeMatch(NamedTuple):
    """Result of a match.

    Args:
        pose: pose (x, y, z, yaw) [m, m, m, rad].
        covariance: its covariance (4, 4), in the world.
        share: share of the points that lie on a known surface, within twice `sigma`.
        number: number of these points.
    """

    pose: LevelPose
    covariance: LevelMatrix
    share: Scalar
    number: Scalar


class Residuals(NamedTuple):
    """Distances of points from the surfaces of a map, at a pose.

    Args:
        away: (N,) distances [m]; 0 where the map does not know any.
        rows: (N, 4) their derivatives by the pose.
        weights: (N,) inverses of their variances, less where they are great [1/m^2].
        is_near: (N,) which are known, and within twice `sigma`.
    """

    away: Numbers
    rows: Float[Array, "N 4"]
    weights: Numbers
    is_near: Bool[Array, " N"]


class VolumeMatcher(eqx.Module):
    """Finds the position and yaw at which the end points of scans lie on the surfaces of a map.

    As `ScanMatcher` in the plane, without a search: between two scans the odometry is off by a few
    centimetres. With d the signed distance of the map, T(p) the motion of the level robot to the
    world and x_i the points, Gauss-Newton minimises

        sum over i of w_i d(T(p) x_i)^2 + (p - p_0)' P^-1 (p - p_0)
        w_i = (1 + d^2 / sigma^2)^-2 / (n (s_i^2 + s^2))

    with the noise s_i of the point along its normal, that of the map s = 1 cm, and n = 5 points
    whose errors count as one. Points on no plane count 0.3. The prior holds the directions in which
    nothing was measured: what errors of the normals would add is left out, as in the plane.

    Source: Bylow et al., "Real-time camera tracking and 3D reconstruction using signed distance
    functions", RSS 2013, there over six numbers and with the slope of the map as normal.

    Args:
        sigma: distance at which a point counts a quarter [m].
        points: about how many points are matched, of all rays; static.
        iterations: number of steps of Gauss-Newton; static.

    Raises:
        ValueError: a number that is not positive.
    """

    sigma: Scalar
    points: int = eqx.field(static=True)
    iterations: int = eqx.field(static=True)

    def __init__(self, sigma: ArrayLike = 0.1, *, points: int = 800, iterations: int = 6) -> None:
        self.sigma = _checks.scalar("sigma", sigma, above=0.0)
        self.points = _checks.positive_int("points", points)
        self.iterations = _checks.positive_int("iterations", iterations)

    def __call__(
        self, surface: VolumeSurface, ends: VolumePoints, guess: LevelPose, covariance: LevelMatrix
    ) -> VolumeMatch:
        """Match scans. Where the result is not finite it is the guess, with a share of 0.

        Args:
            surface: the map.
            ends: end points of the scans.
            guess: pose (x, y, z, yaw) by the odometry [m, m, m, rad].
            covariance: covariance (4, 4) of the guess, in the world.
        """
        few = ends.every(max(1, round(ends.points.shape[0] / self.points)))
        prior = jnp.linalg.inv(covariance)
        kept = filter_information(*self._system(surface, few, guess), NOISY)

        def step(_: Count, pose: LevelPose) -> LevelPose:
            found = self.residuals(surface, few, pose)
            information = _information(found.weights, found.rows)
            normal = kept @ information @ kept.T + prior
            gradient = (found.weights * found.away) @ found.rows
            slope = kept @ (kept @ gradient) + prior @ (pose - guess)
            better: LevelPose = pose - jnp.linalg.solve(normal, slope)
            return better

        pose: LevelPose = jax.lax.fori_loop(0, self.iterations, step, guess)
        found = self.residuals(surface, few, pose)
        information = _information(found.weights, found.rows)
        spread = jnp.linalg.inv(kept @ information @ kept.T + prior)
        spread = 0.5 * (spread + spread.T)
        is_finite = jnp.isfinite(pose).all() & jnp.isfinite(spread).all()
        number = jnp.where(is_finite, found.is_near.sum(dtype=jnp.float32), 0.0)
        return VolumeMatch(
            jnp.where(is_finite, pose, guess),
            jnp.where(is_finite, spread, covariance),
            number / jnp.maximum(few.is_point.sum(dtype=jnp.float32), 1.0),
            number,
        )

    def residuals(self, surface: VolumeSurface, ends: VolumePoints, pose: LevelPose) -> Residuals:
        """Return the distances of end points from the surfaces of a map, at a pose.

        Args:
            surface: the map.
            ends: the end points.
            pose: pose (x, y, z, yaw) [m, m, m, rad].
        """
        turned = turn(pose[3])
        arm, own = ends.points @ turned.T, ends.normals @ turned.T
        # In the middle of the band, as in the plane: so points before a surface and behind it are
        # known equally far.
        away, slope, is_known = surface.at(arm + pose[:3] + surface.shift * own)
        away = away - surface.shift * (slope * own).sum(axis=1)
        # The map's own slope along a wall is noise, which would count as information.
        slope = jnp.where(ends.is_flat[:, None], own, slope)
        is_used = ends.is_point & is_known
        robust = (1.0 + (away / self.sigma) ** 2) ** -2
        weights = robust / (SHARED * (LEAST_NOISE**2 + ends.variance))
        weights = weights * jnp.where(ends.is_flat, 1.0, ROUGH_WEIGHT)
        by_yaw = slope[:, 1] * arm[:, 0] - slope[:, 0] * arm[:, 1]
        rows = jnp.concatenate([slope, by_yaw[:, None]], axis=1)
        is_near = is_used & (jnp.abs(away) <= 2.0 * self.sigma)
        return Residuals(away, rows, jnp.where(is_used, weights, 0.0), is_near)

    def _system(
        self, surface: VolumeSurface, ends: VolumePoints, pose: LevelPose
    ) -> tuple[LevelMatrix, LevelMatrix]:
        """Return the information of points at a pose, and what errors of normals add to it."""
        found = self.residuals(surface, ends, pose)
        turned = turn(pose[3])
        arm, own = ends.points @ turned.T, ends.normals @ turned.T
        # The derivatives of a distance whose gradient is each axis, without its part along the
        # normal: in these directions the normal may be off.
        sides = jnp.eye(3) - own[:, :, None] * own[:, None, :]
        by_yaw = sides[..., 1] * arm[:, None, 0] - sides[..., 0] * arm[:, None, 1]
        rows = jnp.concatenate([sides, by_yaw[..., None]], axis=-1)
        weights = jnp.repeat(found.weights * ends.tilt, 3)
        return _information(found.weights, found.rows), _information(weights, rows.reshape(-1, 4))


def _information(weights: Float[Array, " K"], rows: Float[Array, "K 4"]) -> LevelMatrix:
    """Return the sum of the weighted squares of rows."""
    return jnp.einsum("k,ki,kj->ij", weights, rows, rows)
