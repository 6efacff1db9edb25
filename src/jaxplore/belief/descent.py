"""Extend a cost-to-go into closed nodes, and find the direction in which it falls."""

import functools

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from jaxplore._types import Scalar

NEIGHBOURS = ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))
"""Steps (row, column) to the neighbours: the straight ones first, then the diagonal ones."""


def corner_of(step: tuple[int, int]) -> tuple[int, int]:
    """Return where the corner that a diagonal step passes is in a mask of corners, from its start.

    Entry (r, c) of such a mask is the corner between the nodes (r, c) and (r + 1, c + 1).
    """
    return min(step[0], 0), min(step[1], 0)


def find_predecessors(
    mask: Bool[Array, "H W"], step: tuple[int, int], corners: Bool[Array, "H W"]
) -> Bool[Array, "H W"]:
    """Return the nodes from which a step leads to a node of a mask.

    A diagonal step must pass a corner of the mask `corners`.
    """
    there = neighbour(mask, step)
    return there & neighbour(corners, corner_of(step)) if all(step) else there


def neighbour(values: Array, step: tuple[int, int], outside: float | bool = False) -> Array:
    """Return the value of the neighbour of each node by a step; `outside` off the map."""
    height, width = values.shape
    padded = jnp.pad(values, 1, constant_values=outside)
    down, right = step
    return padded[1 + down : 1 + down + height, 1 + right : 1 + right + width]


def extend(
    value: Float[Array, "H W"],
    num_layers: int,
    step: Scalar,
    corners: Bool[Array, "H W"] | None = None,
) -> Float[Array, "H W"]:
    """Fill infinite nodes from their neighbours, so that interpolation stays finite.

    Each of `num_layers` layers gets the greatest finite value around it plus `step`. So an obstacle
    becomes a ridge that is higher than both of its sides, however thin it is. Nodes that are still
    infinite get the greatest finite value plus `step` per layer. A field without finite values
    becomes 0.

    If a path leads diagonally between two closed nodes, these get at most the mean of the path's
    ends: a saddle. Between two ridges the interpolated cost would rise on the way through the gap,
    and a robot that descends would stop in front of it. `corners` are those that a diagonal step
    may pass; all when None.
    """
    height, width = value.shape
    greatest = jnp.max(jnp.where(jnp.isfinite(value), value, -jnp.inf))

    def layer(_: Array, current: Array) -> Array:
        known = jnp.where(jnp.isfinite(current), current, -jnp.inf)
        padded = jnp.pad(known, 1, constant_values=-jnp.inf)
        around = jnp.full_like(current, -jnp.inf)
        for down in (0, 1, 2):
            for right in (0, 1, 2):
                around = jnp.maximum(around, padded[down : down + height, right : right + width])
        ridge = jnp.where(jnp.isfinite(around), around + step, jnp.inf)
        return jnp.where(jnp.isfinite(current), current, ridge)

    filled = jnp.minimum(jax.lax.fori_loop(0, num_layers, layer, value), _saddles(value, corners))
    beyond = jnp.where(jnp.isfinite(greatest), greatest + num_layers * step, 0.0)
    return jnp.where(jnp.isfinite(filled), filled, beyond)


def _saddles(value: Float[Array, "H W"], corners: Bool[Array, "H W"] | None) -> Float[Array, "H W"]:
    """Return the cost at the closed nodes beside diagonal steps between two closed nodes.

    It is the smallest mean of the two ends of such a step, and infinite at all other nodes.
    """
    height, width = value.shape
    padded = jnp.pad(value, 1, constant_values=jnp.inf)

    def shift(down: int, right: int) -> Array:
        return padded[1 + down : 1 + down + height, 1 + right : 1 + right + width]

    least = jnp.full_like(value, jnp.inf)
    for down in (-1, 1):
        for right in (-1, 1):
            mean = 0.5 * (shift(down, 0) + shift(0, right))
            is_between = jnp.isinf(value) & jnp.isinf(shift(down, right))
            if corners is not None:
                is_between &= neighbour(corners, corner_of((down, right)))
            least = jnp.minimum(least, jnp.where(is_between, mean, jnp.inf))
    return least


def descent(
    value: Float[Array, "H W"], num_layers: int, corners: Bool[Array, "H W"] | None = None
) -> Float[Array, "2 H W"]:
    """Return the unit vectors (row, column) along which a cost-to-go falls; 0 at its minima.

    At an open node the vector is the sum of the slopes towards its lower neighbours, diagonally
    only past `corners`; past all when None. Closed nodes, whose value is infinite, get the mean
    direction of the nodes around them, for `num_layers` layers. So an obstacle does not change the
    direction of the path along it.
    """
    height, width = value.shape

    def shift(padded: Array, down: int, right: int) -> Array:
        return padded[..., 1 + down : 1 + down + height, 1 + right : 1 + right + width]

    around = jnp.pad(value, 1, constant_values=jnp.inf)
    vector = jnp.zeros((2, height, width))
    for down, right in NEIGHBOURS:
        length = (down * down + right * right) ** 0.5
        # Differences with closed neighbours are infinite or NaN, and count as no slope.
        fall = value - shift(around, down, right)
        fall = jnp.where(jnp.isfinite(fall), jnp.maximum(fall, 0.0), 0.0) / length
        if corners is not None and down and right:
            # A node on the other side of a wall may be lower.
            fall = jnp.where(neighbour(corners, corner_of((down, right))), fall, 0.0)
        unit = jnp.asarray([down / length, right / length])
        vector = vector + fall * unit[:, None, None]

    def normalise(vectors: Array) -> Array:
        # The inverse root of infinity is 0: where slopes cancel, the direction is 0 and not NaN.
        square = jnp.sum(vectors * vectors, axis=0)
        return vectors * jax.lax.rsqrt(jnp.where(square > 1e-12, square, jnp.inf))

    def layer(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        current, is_known = carry
        vectors = jnp.pad(current, ((0, 0), (1, 1), (1, 1)))
        known = jnp.pad(is_known, 1)
        total = functools.reduce(jnp.add, [shift(vectors, *step) for step in NEIGHBOURS])
        near = functools.reduce(jnp.logical_or, [shift(known, *step) for step in NEIGHBOURS])
        return jnp.where(is_known, current, normalise(total)), is_known | near

    start = normalise(vector), jnp.isfinite(value)
    filled: tuple[Array, Array] = jax.lax.fori_loop(0, num_layers, layer, start)
    return filled[0]
