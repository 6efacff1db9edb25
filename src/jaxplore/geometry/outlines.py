"""Describe obstacles on the ground by rounded polygons: discs, capsules and polygons."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore._checks import array, one_each
from jaxplore._types import Flag, Position, Rows, Scalar, Vector
from jaxplore.geometry.vectors import root

UNROLL = 8
"""Edges per loop iteration: fewer iterations, yet a short program."""


class Outlines(eqx.Module):
    """N shapes on the ground, each the set of points within a radius of a polygon.

    A disc is one corner and a radius, a capsule two corners and a radius, a polygon three or more
    corners with radius 0. The signed distance from a point q to shape n is

        d_n(q) = s min over its edges e of |q - e| - r_n,   s = -1 inside the polygon, else 1

    A point is inside if a ray from it crosses the edges an odd number of times, so corners may be
    listed in either direction. Sources: Ericson, "Real-Time Collision Detection", 2005, section
    5.1.2 (closest point of a segment); Shimrat, "Algorithm 112: position of point relative to
    polygon", CACM 1962.

    Build it with `discs` and `polygons`; `a + b` holds the shapes of both. The number N of shapes
    and the number V of corners are static; a polygon with fewer corners than V repeats its last.

    Args:
        corners: corners (N, V, 2) of the polygons, in order [m].
        radii: radii (N,) by which the polygons are grown [m].
    """

    corners: Float[Array, "N V 2"]
    radii: Float[Array, " N"]

    @classmethod
    def discs(cls, centres: Rows, radii: Vector) -> "Outlines":
        """Build N discs.

        Args:
            centres: centres (N, 2) [m]; N may be 0.
            radii: radii (N,), or one number for all [m].

        Raises:
            ValueError: an array of another shape, numbers that are not finite, a negative radius.
        """
        middles = array("centres", centres, ("N", 2), may_be_empty=True)
        return cls(middles[:, None, :], one_each("radii", radii, middles.shape[0], at_least=0.0))

    @classmethod
    def polygons(
        cls, polygons: Sequence[Rows], radii: Vector = 0.0, *, named: str = "polygons"
    ) -> "Outlines":
        """Build N polygons, each grown by a radius, which rounds its corners.

        Args:
            polygons: corners (V_n, 2) of each polygon in order, without repeating the first [m].
            radii: radii (N,), or one number for all [m].
            named: what messages call the polygons.

        Raises:
            ValueError: an array of another shape, fewer than 3 corners, numbers that are not
                finite, corners on one line, a negative radius.
        """
        rows = []
        for index, polygon in enumerate(polygons):
            name = f"{named}[{index}]"
            corners = np.asarray(array(name, polygon, ("V", 2)), np.float64)
            if len(corners) < 3 or np.linalg.matrix_rank(corners - corners[0], 1e-6) < 2:
                raise ValueError(
                    f"{name} is {corners.tolist()}; accepted: 3 corners or more, not on one line"
                )
            rows.append(corners)
        # Repeating the last corner adds edges of zero length, which change neither the distance nor
        # the number of crossings.
        most = max(map(len, rows), default=1)
        padded = [np.concatenate([row, row[-1:].repeat(most - len(row), axis=0)]) for row in rows]
        stacked = np.reshape(padded, (-1, most, 2))
        return cls(
            jnp.asarray(stacked, jnp.float32), one_each("radii", radii, len(rows), at_least=0.0)
        )

    def __add__(self, other: "Outlines") -> "Outlines":
        # Repeating the last corner changes no shape: see `polygons`.
        most = max(self.corners.shape[1], other.corners.shape[1])
        corners = [
            jnp.concatenate([each, jnp.repeat(each[:, -1:], most - each.shape[1], axis=1)], axis=1)
            for each in (self.corners, other.corners)
        ]
        return Outlines(jnp.concatenate(corners), jnp.concatenate([self.radii, other.radii]))

    @property
    def number(self) -> int:
        """Number of shapes, N."""
        return self.radii.shape[0]

    @property
    def centres(self) -> Float[Array, "N 2"]:
        """Centres (N, 2) of the axis-aligned bounding boxes of the corners [m]."""
        return 0.5 * (jnp.min(self.corners, axis=1) + jnp.max(self.corners, axis=1))

    def distances(self, position: Position) -> Float[Array, " N"]:
        """Return the signed distances (N,) from a position to each shape [m], negative inside."""

        def one(corners: Array, radius: Scalar) -> Scalar:
            return nearest(corners, radius, position[0], position[1]).distance

        return jax.vmap(one)(self.corners, self.radii)


class Nearest(NamedTuple):
    """Distance and offset from a shape to a point.

    The distance is negative inside [m]. (x, y) is the vector from the nearest point of the polygon,
    without its radius, to the point [m].
    """

    distance: Scalar
    x: Scalar
    y: Scalar


def nearest(corners: Float[Array, "V 2"], radius: Scalar, x: Scalar, y: Scalar) -> Nearest:
    """Return the signed distance and the offset from one shape of `Outlines` to a point.

    The corners (V, 2) of the polygon are in order; it is grown by the radius [m]. The distance of a
    NaN point is NaN.
    """
    if corners.shape[0] == 1:
        return _nearest_of_disc(corners[0], radius, x, y)
    # Repeated corners give edges of zero length, and level edges have no slope: both divisions are
    # guarded, and such edges are never crossed.
    ends = jnp.roll(corners, -1, axis=0)
    edges = ends - corners
    square = jnp.sum(edges * edges, axis=-1)
    inverse = jnp.where(square > 0.0, 1.0 / jnp.where(square > 0.0, square, 1.0), 0.0)
    rise = edges[:, 1]
    run = edges[:, 0] / jnp.where(rise == 0.0, 1.0, rise)

    Best = tuple[Scalar, Scalar, Scalar, Flag]

    def take(best: Best, edge: tuple[Array, Array, Array, Scalar, Scalar]) -> tuple[Best, None]:
        least, best_x, best_y, is_inside = best
        start, end, along, scale, slope = edge
        ahead, beside = x - start[0], y - start[1]
        share = jnp.clip((ahead * along[0] + beside * along[1]) * scale, 0.0, 1.0)
        off_x, off_y = ahead - share * along[0], beside - share * along[1]
        distance = off_x * off_x + off_y * off_y
        # Negated so that NaN is taken: a diverged rollout must not count as far from everything.
        is_nearer = ~(distance >= least)
        # Compare the corners themselves, so that two edges that meet agree on the side of the ray
        # on which their common corner lies.
        crosses = (start[1] > y) != (end[1] > y)
        is_inside = is_inside ^ (crosses & (ahead < slope * beside))
        return (
            jnp.where(is_nearer, distance, least),
            jnp.where(is_nearer, off_x, best_x),
            jnp.where(is_nearer, off_y, best_y),
            is_inside,
        ), None

    start = (jnp.full((), jnp.inf), jnp.zeros(()), jnp.zeros(()), jnp.zeros((), bool))
    (least, off_x, off_y, is_inside), _ = jax.lax.scan(
        take, start, (corners, ends, edges, inverse, run), unroll=UNROLL
    )
    length = root(least)
    return Nearest(jnp.where(is_inside, -length, length) - radius, off_x, off_y)


def _nearest_of_disc(centre: Float[Array, "2"], radius: Scalar, x: Scalar, y: Scalar) -> Nearest:
    """Return the signed distance and the offset from a disc to a point, without edges."""
    ahead, beside = x - centre[0], y - centre[1]
    square = ahead * ahead + beside * beside
    # So far away that the square is infinite, there is no direction, as for a polygon.
    is_far = square >= jnp.inf
    off_x, off_y = (jnp.where(is_far, 0.0, component) for component in (ahead, beside))
    return Nearest(root(square) - radius, off_x, off_y)
