"""Match a scan of a volume to its surfaces: Gauss-Newton over position and yaw."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, Count, Scalar
from jaxplore.geometry.level_motion import LevelMatrix, LevelPose, turn
from jaxplore.localisation.scan_matching import _filter_information as filter_information
from jaxplore.localisation.volume_surface import LEAST_NOISE, VolumePoints, VolumeSurface

ROUGH = 0.3
SHARED = 5.0
"""Number of points whose errors count as one: those of a map are the same beside each other."""


class VolumeMatch(NamedTuple):
    pose: LevelPose
    covariance: LevelMatrix
    share: Scalar
    residual: Scalar


class VolumeMatcher(eqx.Module):
    sigma: Scalar
    iterations: int = eqx.field(static=True)

    def __init__(self, sigma: ArrayLike = 0.1, *, iterations: int = 6) -> None:
        self.sigma = _checks.scalar("sigma", sigma, above=0.0)
        self.iterations = _checks.positive_int("iterations", iterations)

    def __call__(
        self, surface: VolumeSurface, ends: VolumePoints, guess: LevelPose, covariance: LevelMatrix
    ) -> VolumeMatch:
        prior = jnp.linalg.inv(covariance)
        kept = filter_information(*self._system(surface, ends, guess)[:2])

        def step(_: Count, pose: LevelPose) -> LevelPose:
            information, _tilt, gradient, *_rest = self._system(surface, ends, pose)
            normal = kept @ information @ kept.T + prior
            slope = kept @ (kept @ gradient) + prior @ (pose - guess)
            better: LevelPose = pose - jnp.linalg.solve(normal, slope)
            return better

        pose = jax.lax.fori_loop(0, self.iterations, step, guess)
        information, _, _, share, residual = self._system(surface, ends, pose)
        found = jnp.linalg.inv(kept @ information @ kept.T + prior)
        found = 0.5 * (found + found.T)
        is_finite = jnp.isfinite(pose).all() & jnp.isfinite(found).all()
        return VolumeMatch(
            jnp.where(is_finite, pose, guess),
            jnp.where(is_finite, found, covariance),
            jnp.where(is_finite, share, 0.0),
            jnp.where(is_finite, residual, jnp.inf),
        )

    def _system(self, surface, ends, pose):
        turned = turn(pose[3])
        arm = ends.points @ turned.T
        own = ends.normals @ turned.T
        shift = surface.shift
        away, slope, is_known = surface.at(arm + pose[:3] + shift * own)
        away = away - shift * (slope * own).sum(axis=1)
        is_used = ends.is_point & is_known
        robust = (1.0 + (away / self.sigma) ** 2) ** -2
        weight = jnp.where(is_used, robust / (LEAST_NOISE**2 + ends.variance), 0.0)
        # All points beside one another share the errors of the map.
        weight = weight / SHARED * jnp.where(ends.is_flat, 1.0, ROUGH)
        slope = jnp.where(ends.is_flat[:, None], own, slope)
        rows = _rows(slope, arm)
        information = jnp.einsum("n,ni,nj->ij", weight, rows, rows)
        moves = jax.vmap(_moves)(arm)
        across = jnp.eye(3) - own[:, :, None] * own[:, None, :]
        tilt = jnp.einsum("n,nia,nab,njb->ij", weight * ends.tilt, moves, across, moves)
        gradient = (weight * away) @ rows
        number = jnp.maximum(ends.is_point.sum(dtype=jnp.float32), 1.0)
        is_near = is_used & (jnp.abs(away) <= 2.0 * self.sigma)
        share = is_near.sum(dtype=jnp.float32) / number
        residual = jnp.sqrt(jnp.sum(weight * away**2) / jnp.maximum(weight.sum(), 1e-9))
        return information, tilt, gradient, share, residual


def _moves(arm):
    """(4, 3)"""
    x, y, _ = arm
    yaw = jnp.stack([-y, x, jnp.zeros_like(x)])
    return jnp.concatenate([jnp.eye(3), yaw[None]])


def _rows(slope, arm):
    by_yaw = slope[:, 1] * arm[:, 0] - slope[:, 0] * arm[:, 1]
    return jnp.concatenate([slope, by_yaw[:, None]], axis=1)
