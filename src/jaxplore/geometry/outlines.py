"""Outlines of things on the ground: discs, polygons, and what is between them."""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore._checks import array, one_each
from jaxplore._types import Flag, Position, Rows, Scalar, Vector

UNROLL = 8
"""Edges per iteration: few iterations without a long program."""


class Outlines(eqx.Module):
    """N things on the ground, each of which is what is within a radius of a polygon.

    So a disc is one corner and a radius, a capsule two corners and a radius, a polygon three
    corners or more without one. The distance of a point q from the n-th is

        d_n(q) = s min over its edges e of |q - e| - r_n,   s = -1 inside the polygon, else 1

    negative inside. Inside is where a ray crosses the edges an odd number of times, so corners may
    go round either way. (Ericson, "Real-Time Collision Detection", 2005, section 5.1.2, the
    point of a segment nearest to a point; Shimrat, "Algorithm 112: position of point relative to
    polygon", CACM 1962.)

    Made by `discs` and `polygons`; `a + b` has the things of both. The numbers N of things and V of
    corners are static; a polygon with fewer corners than another repeats its last one.

    Args:
        corners: (N, V, 2) in order [m].
        radii: (N,) [m].
    """

    corners: Float[Array, "N V 2"]
    radii: Float[Array, " N"]

    @classmethod
    def discs(cls, centres: Rows, radii: Vector) -> "Outlines":
        """Return discs.

        Args:
            centres: (N, 2) [m]; none of them is fine.
            radii: (N,) or one number [m].

        Raises:
            ValueError: another shape, numbers that are not finite, a negative radius.
        """
        middles = array("centres", centres, ("N", 2), may_be_empty=True)
        return cls(middles[:, None, :], one_each("radii", radii, middles.shape[0], at_least=0.0))

    @classmethod
    def polygons(cls, polygons: Sequence[Rows], radii: Vector = 0.0) -> "Outlines":
        """Return polygons, each of which is rounded off by its radius.

        Args:
            polygons: of each its corners (V_n, 2) in order, without repeating the first [m].
            radii: by which they are thicker, (N,) or one number [m].

        Raises:
            ValueError: another shape, fewer corners than 3, numbers that are not finite, corners
                on one line, a negative radius.
        """
        rows = []
        for index, polygon in enumerate(polygons):
            name = f"polygons[{index}]"
            corners = np.asarray(array(name, polygon, ("V", 2)), np.float64)
            if len(corners) < 3 or np.linalg.matrix_rank(corners - corners[0], 1e-6) < 2:
                raise ValueError(
                    f"{name} is {corners.tolist()}; accepted: 3 corners or more, not on one line"
                )
            rows.append(corners)
        most = max(map(len, rows), default=1)
        padded = [np.concatenate([row, row[-1:].repeat(most - len(row), axis=0)]) for row in rows]
        stacked = np.reshape(padded, (-1, most, 2))
        return cls(
            jnp.asarray(stacked, jnp.float32), one_each("radii", radii, len(rows), at_least=0.0)
        )

    def __add__(self, other: "Outlines") -> "Outlines":
        most = max(self.corners.shape[1], other.corners.shape[1])
        corners = [
            jnp.concatenate([each, jnp.repeat(each[:, -1:], most - each.shape[1], axis=1)], axis=1)
            for each in (self.corners, other.corners)
        ]
        return Outlines(jnp.concatenate(corners), jnp.concatenate([self.radii, other.radii]))

    @property
    def number(self) -> int:
        """How many things there are, N."""
        return self.radii.shape[0]

    @property
    def centres(self) -> Float[Array, "N 2"]:
        """Middles (N, 2) of the boxes along the axes that hold the corners [m]."""
        return 0.5 * (jnp.min(self.corners, axis=1) + jnp.max(self.corners, axis=1))

    def distances(self, position: Position) -> Float[Array, " N"]:
        """Return the distance (N,) of a position from each [m], negative inside."""

        def one(corners: Array, radius: Scalar) -> Scalar:
            return nearest(corners, radius, position[0], position[1]).distance

        return jax.vmap(one)(self.corners, self.radii)


class Nearest(NamedTuple):
    """How far a point is from something.

    Args:
        distance: from its edge, negative inside [m].
        x: from the nearest point of the polygon without its radius to the point [m].
        y: the same along y [m].
    """

    distance: Scalar
    x: Scalar
    y: Scalar


def nearest(corners: Float[Array, "V 2"], radius: Scalar, x: Scalar, y: Scalar) -> Nearest:
    """Return how far a point is from one of `Outlines`.

    Of a point that is not a number the distance is none.

    Args:
        corners: (V, 2) [m].
        radius: [m].
        x: of the point [m].
        y: of the point [m].
    """
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
        # Also what is not a number is taken: a diverged rollout is not far from everything.
        is_nearer = ~(distance >= least)
        # By the corners themselves: two edges that meet agree on which side of the ray they do.
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
    is_zero = least <= 0.0
    length = jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, least)))
    return Nearest(jnp.where(is_inside, -length, length) - radius, off_x, off_y)
