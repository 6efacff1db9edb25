"""Search a whole map for the pose of a robot that does not know where it is, by one scan."""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore._types import Flag, Pose, Scalar
from jaxplore.geometry.motion import transform_points, wrap_angle
from jaxplore.localisation.likelihood_field import LikelihoodField, Points, Poses
from jaxplore.localisation.particles import ParticleFilter

LATTICE = 0.2
"""Distance between the positions that are tried [m]; whole cells."""
TURNS = 120
"""Number of yaws that are tried."""
TILE = 8
"""Positions along each side of a tile, of which the best one is kept for each yaw."""
RIVALS = 64
"""Number of other places that are looked at closely."""
SHIFTS = (-0.1, -0.05, 0.0, 0.05, 0.1)
"""Shifts by which a pose of the lattice is refined along x and y [m]."""
REFINED_TURNS = (-0.02, 0.0, 0.02)
"""Turns by which it is refined [rad]."""
FINEST = 0.5
"""Factor on the shifts and turns of the last refinement."""
FINE_STD = 0.1
"""Standard deviation of the distance of a beam's end from a wall where places are compared [m]."""
LEAST_RATIO = 3.0
"""Logarithm of the ratio of the likelihoods from which on a place beats another one."""
LEAST_SHARE = 0.7
"""Share of the ends of beams that must be at known walls, for a robot that stands there."""
LEAST_BEAMS = 12
"""Number of beams that must have met something."""
SAMPLES = 48
"""Number of points of a beam that are looked at for walls."""
OPEN = 0.3
"""Distance from a wall beyond which the end of a beam in a free cell contradicts the map [m]."""
BEHIND = 0.4
"""Way that a beam must go on behind a known wall to contradict the map [m]."""


class Places(NamedTuple):
    """Where a scan fits on a map.

    Args:
        pose: the pose at which it fits best (x, y, yaw) [m, m, rad].
        share: share of the ends of its beams that are at known walls from there; 0 with fewer than
            `LEAST_BEAMS` of them.
        rival: the best pose elsewhere.
        ratio: logarithm of the ratio of the likelihoods of both.
        near: (E, 3) best pose near each expected one.
        near_ratios: (E,) logarithm of the ratio of the likelihood of `pose` to that of each of
            these; infinite where the scan fits nowhere near.
        contradicted: (E,) share of the beams that contradict the map at each expected pose, or at
            the best one near it, if that is less: one that goes on behind a wall, or ends in free
            space. What is not mapped contradicts nothing.
    """

    pose: Pose
    share: Scalar
    rival: Pose
    ratio: Scalar
    near: Float[Array, "E 3"]
    near_ratios: Float[Array, " E"]
    contradicted: Float[Array, " E"]

    @property
    def is_seen(self) -> Flag:
        """Whether enough of the scan is on the map."""
        return self.share >= LEAST_SHARE

    @property
    def is_unique(self) -> Flag:
        """Whether the scan fits at no other place nearly as well."""
        return self.ratio >= LEAST_RATIO


def share_at_walls(
    filter: ParticleFilter,
    field: LikelihoodField,
    pose: Pose,
    points: Points,
    is_return: Bool[Array, " B"],
) -> Scalar:
    """Return the share of the ends of beams that are at known walls, seen from a pose.

    They are if they are within `distance_std` of one. The share is 0 with fewer than `LEAST_BEAMS`
    beams that returned.

    Args:
        filter: particle filter with the numbers.
        field: known map.
        pose: pose (x, y, yaw) [m, m, rad].
        points: ends (B, 2) of beams in the frame of the robot [m].
        is_return: mask (B,) of the beams that returned.
    """
    is_end = is_return & jnp.isfinite(points).all(axis=1)
    away = field.distances(pose, jnp.where(is_end[:, None], points, 0.0))
    number = jnp.sum(is_end, dtype=jnp.float32)
    near = jnp.sum(is_end & (away <= filter.distance_std), dtype=jnp.float32)
    return jnp.where(number >= LEAST_BEAMS, near / jnp.maximum(number, 1.0), 0.0)


def search_places(
    filter: ParticleFilter,
    field: LikelihoodField,
    points: Points,
    is_return: Bool[Array, " B"],
    max_range: float,
    expected: Float[Array, "E 3"],
) -> Places:
    """Return where a scan fits best on a map, and where else it fits best.

    Places are found on a lattice of poses on free cells, every `LATTICE` along x and y and for
    `TURNS` yaws, by the likelihood of the filter, tempered. There the ends of beams are rounded to
    cells, so that all positions of a yaw are sums of shifted images. Of each tile and yaw the best
    one is kept. The best of all, and the best `RIVALS` farther from it than the radius of a cluster
    or turned by more than its angle, are then compared by what whole beams say: one that goes on
    for `BEHIND` behind a known wall, also one that met nothing, counts like one that ends at
    nothing.

    Source: Olson, "Real-time correlative scan matching", ICRA 2009, without its pyramid.

    Args:
        filter: particle filter with the numbers of the likelihood.
        field: known map.
        points: ends (B, 2) of the beams in the frame of the robot [m].
        is_return: mask (B,) of the beams that returned.
        max_range: greatest range of a beam [m]; static.
        expected: poses (E, 3) near which the robot may be (x, y, yaw) [m, m, rad]; NaN for none.
    """
    beams = _Beams.of(filter, points, is_return, max_range)
    poses, scores = _search_lattice(filter, field, beams, max_range)
    best = _refine(filter, field, poses[jnp.argmax(scores)], beams)
    is_near = filter.is_near(poses, best[0])
    _, others = jax.lax.top_k(jnp.where(is_near, -jnp.inf, scores), min(RIVALS, len(poses)))
    rivals, likelihoods = jax.lax.map(
        lambda pose: _refine(filter, field, pose, beams), poses[others]
    )
    # A place of the cluster, or off the free cells, is none.
    is_other = ~is_near[others] & jnp.isfinite(scores[others])
    likelihoods = jnp.where(is_other, likelihoods, -jnp.inf)
    rival = jnp.argmax(likelihoods)
    share = share_at_walls(filter, field, best[0], points, is_return)

    def look_near(pose: Pose) -> tuple[Pose, Scalar, Scalar]:
        around = jnp.where(filter.is_near(poses, pose), scores, -jnp.inf)
        found, likelihood = _refine(filter, field, poses[jnp.argmax(around)], beams)
        is_any = jnp.isfinite(around.max())
        least = _contradicted_share(field, pose, beams)
        near = jnp.where(is_any, _contradicted_share(field, found, beams), 1.0)
        ratio = jnp.where(is_any, best[1] - likelihood, jnp.inf)
        return found, ratio, jnp.where(jnp.isfinite(pose).all(), jnp.minimum(least, near), 1.0)

    near = jax.lax.map(look_near, expected)
    return Places(best[0], share, rivals[rival], best[1] - likelihoods[rival], *near)


class _Beams(NamedTuple):
    """Beams of a scan that count: their ends [m], which returned, and which met nothing."""

    ends: Points
    is_return: Bool[Array, " B"]
    is_clear: Bool[Array, " B"]

    @classmethod
    def of(
        cls, filter: ParticleFilter, points: Points, is_return: Array, max_range: float
    ) -> "_Beams":
        # One without a measurement has no length.
        length = jnp.hypot(*jnp.unstack(points, axis=1))
        ends, is_end = filter.select_ends(points, is_return)
        far, is_clear = filter.select_ends(points, ~is_return & (length >= 0.99 * max_range))
        return cls(jnp.where(is_clear[:, None], far, ends), is_end, is_clear)


def _search_lattice(
    filter: ParticleFilter,
    field: LikelihoodField,
    beams: _Beams,
    max_range: float,
) -> tuple[Poses, Float[Array, " L"]]:
    """Return the best pose of each tile and yaw, and its likelihood, tempered; -inf for none."""
    frame, distance = field.distance.frame, field.distance.values
    rows, columns = distance.shape
    stride = max(1, round(LATTICE / frame.resolution))
    margin = math.ceil(max_range / frame.resolution) + stride + 1
    # All sides are whole tiles.
    tall, wide = (-(-size // (stride * TILE)) * TILE for size in (rows, columns))
    bottom = stride * (tall + 1) - rows + margin
    right = stride * (wide + 1) - columns + margin
    fit = jnp.log(
        (1.0 - filter.outlier_share) * jnp.exp(-0.5 * (distance / filter.distance_std) ** 2)
        + filter.outlier_share
    )
    image = jnp.pad(fit, ((margin, bottom), (margin, right)), constant_values=math.nan)
    image = jnp.where(jnp.isnan(image), jnp.log(filter.outlier_share), image)
    # Every `stride` cells from each of the first ones: a shift is one contiguous piece of one.
    sides = [-(-size // stride) * stride - size for size in image.shape]
    image = jnp.pad(image, ((0, sides[0]), (0, sides[1])))
    phases = image.reshape(
        image.shape[0] // stride, stride, image.shape[1] // stride, stride
    ).transpose(1, 3, 0, 2)
    is_free = jnp.pad(field.is_free, ((0, stride * tall), (0, stride * wide)))
    is_free = is_free[: stride * tall : stride, : stride * wide : stride]
    row, column = jnp.unstack(
        jnp.stack(jnp.meshgrid(jnp.arange(TILE), jnp.arange(TILE), indexing="ij")).reshape(2, -1)
    )

    def try_turn(turn: Scalar) -> tuple[Float[Array, "P 3"], Float[Array, " P"]]:
        cos, sin = jnp.cos(turn), jnp.sin(turn)
        x, y = jnp.unstack(beams.ends, axis=1)
        # From the centre of a cell, in the axes of the grid.
        along = jnp.stack([sin * x + cos * y, cos * x - sin * y], axis=1) / frame.resolution
        shifts = jnp.clip(jnp.round(along).astype(jnp.int32) + margin, 0, None)

        def add(total: Array, beam: tuple[Array, Array]) -> tuple[Array, None]:
            shift, is_used = beam
            begin = jnp.concatenate([shift % stride, shift // stride])
            piece = jax.lax.dynamic_slice(phases, begin, (1, 1, tall, wide))[0, 0]
            return total + jnp.where(is_used, piece, 0.0), None

        total, _ = jax.lax.scan(add, jnp.zeros((tall, wide)), (shifts, beams.is_return))
        total = jnp.where(is_free, filter.temper * total, -jnp.inf)
        tiles = total.reshape(tall // TILE, TILE, wide // TILE, TILE).transpose(0, 2, 1, 3)
        flat = tiles.reshape(tall // TILE, wide // TILE, TILE * TILE)
        best = jnp.argmax(flat, axis=-1)
        tile_row, tile_column = jnp.meshgrid(
            jnp.arange(tall // TILE), jnp.arange(wide // TILE), indexing="ij"
        )
        cells = jnp.stack([tile_row * TILE + row[best], tile_column * TILE + column[best]], axis=-1)
        places = frame.cell_centre((stride * cells).reshape(-1, 2))
        yaw = jnp.full((len(places), 1), 1.0) * wrap_angle(turn + frame.origin[2])
        return jnp.concatenate([places, yaw], axis=1), flat.max(axis=-1).reshape(-1)

    turns = (2.0 * np.pi / TURNS * np.arange(TURNS)).astype(np.float32)
    poses, scores = jax.lax.map(try_turn, jnp.asarray(turns))
    return poses.reshape(-1, 3), scores.reshape(-1)


def _refine(
    filter: ParticleFilter, field: LikelihoodField, pose: Pose, beams: _Beams
) -> tuple[Pose, Scalar]:
    """Return the best pose near one, and the likelihood of the beams there, tempered."""
    near = np.stack(np.meshgrid(SHIFTS, SHIFTS, REFINED_TURNS), axis=-1).reshape(-1, 3)
    poses = pose + jnp.asarray(near.astype(np.float32))
    fits = jax.vmap(lambda each: _end_fits(field, each, beams).sum())(poses)
    few = np.stack(np.meshgrid(SHIFTS[1:-1], SHIFTS[1:-1], REFINED_TURNS), axis=-1)
    few = FINEST * few.reshape(-1, 3)
    poses = poses[jnp.argmax(fits)] + jnp.asarray(few.astype(np.float32))
    likelihoods = jax.vmap(lambda each: _beam_likelihood(filter, field, each, beams))(poses)
    best = jnp.argmax(likelihoods)
    return poses[best].at[2].set(wrap_angle(poses[best, 2])), likelihoods[best]


def _end_fits(field: LikelihoodField, pose: Pose, beams: _Beams) -> Float[Array, " B"]:
    """Return how well the end of each beam fits, from 0 to 1."""
    away = field.distances(pose, beams.ends)
    return jnp.where(beams.is_return, jnp.exp(-0.5 * (away / FINE_STD) ** 2), 0.0)


def _beam_likelihood(
    filter: ParticleFilter, field: LikelihoodField, pose: Pose, beams: _Beams
) -> Scalar:
    """Return the logarithm of the likelihood of whole beams from a pose, tempered."""
    is_behind = _go_behind_walls(field, pose, beams)
    fit = jnp.where(beams.is_clear, 1.0, _end_fits(field, pose, beams))
    fit = jnp.where(is_behind, 0.0, fit)
    logs = jnp.log((1.0 - filter.outlier_share) * fit + filter.outlier_share)
    return filter.temper * jnp.where(beams.is_return | beams.is_clear, logs, 0.0).sum()


def _contradicted_share(field: LikelihoodField, pose: Pose, beams: _Beams) -> Scalar:
    """Return the share of the beams that contradict the map from a pose."""
    cells = field.distance.frame.to_cell(transform_points(pose, beams.ends))
    sides = jnp.array(field.distance.values.shape, jnp.int32)
    is_inside = ((cells >= 0) & (cells < sides)).all(axis=1)
    row, column = jnp.unstack(jnp.clip(cells, 0, sides - 1), axis=1)
    is_open = field.is_free[row, column] & (field.distance.values[row, column] > OPEN)
    is_contrary = beams.is_return & is_inside & is_open
    is_contrary |= (beams.is_return | beams.is_clear) & _go_behind_walls(field, pose, beams)
    number = jnp.sum(beams.is_return | beams.is_clear, dtype=jnp.float32)
    return jnp.sum(is_contrary, dtype=jnp.float32) / jnp.maximum(number, 1.0)


def _go_behind_walls(field: LikelihoodField, pose: Pose, beams: _Beams) -> Bool[Array, " B"]:
    """Return which beams go on behind a known wall."""
    share = jnp.arange(SAMPLES, dtype=jnp.float32) / SAMPLES
    points = transform_points(pose, (share[:, None, None] * beams.ends).reshape(-1, 2))
    cells = field.distance.frame.to_cell(points)
    sides = jnp.array(field.distance.values.shape, jnp.int32)
    is_inside = ((cells >= 0) & (cells < sides)).all(axis=1)
    row, column = jnp.unstack(jnp.clip(cells, 0, sides - 1), axis=1)
    is_wall = is_inside & (field.distance.values[row, column] <= 0.0)
    length = jnp.hypot(*jnp.unstack(beams.ends, axis=1))
    is_before = share[:, None] * length < length - BEHIND
    return (is_wall.reshape(SAMPLES, -1) & is_before).any(axis=0)
