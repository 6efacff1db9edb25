"""Clusters of returns along the beams of a scan, and edges behind which something can be hidden."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import Flag, Scalar

SKIPPED = 3
"""A cluster goes on over up to two beams without a point: a beam may return nothing."""

FORTIETH = 40
"""Part of a circle within which points are neighbours, 9 degrees: a point has the same neighbours
among the beams of a lidar as among finer directions, of which most are empty."""


class Clusters(NamedTuple):
    """Clusters of points, in the order of the beams; those beyond the K-th are left out.

    Args:
        middle: mean of the points of each [m].
        width: distance between its first and its last point [m].
        num_points: number of its points; 0 where there is no such cluster.
        is_cut: whether something in front of it may hide a part of it.
        label: cluster of each beam; K for none.
    """

    middle: Float[Array, "K 2"]
    width: Float[Array, " K"]
    num_points: Int[Array, " K"]
    is_cut: Bool[Array, " K"]
    label: Int[Array, " B"]


def cluster_points(
    points: Float[Array, "B 2"],
    ranges: Float[Array, " B"],
    is_point: Bool[Array, " B"],
    gap: Scalar,
    number: int,
    *,
    is_circle: bool,
) -> Clusters:
    """Join neighbouring points of a scan whose distance is at most `gap` [m].

    Beams outside `is_point` do not count. `number` is the greatest number of clusters, K.
    `is_circle` tells whether the first beam is beside the last. Both are static.
    """
    size = points.shape[0]
    index = jnp.arange(size, dtype=jnp.int32)
    former = _find_former(is_point)
    before = former % size
    near = jnp.linalg.norm(points - points[before], axis=-1) <= gap
    is_joined = is_point & near & (index - former <= SKIPPED) & (former > -size)
    if not is_circle:
        is_joined &= former >= 0
    is_first = is_point & ~is_joined
    # Rolled so that the first beam begins a cluster, no cluster crosses the end of the arrays.
    shift = jnp.argmax(is_first)
    order = (index + shift) % size
    label = jnp.maximum(jnp.cumsum(is_first[order], dtype=jnp.int32) - 1, 0)
    label = jnp.where(is_point[order] & (label < number), label, number)
    count = jax.ops.segment_sum(jnp.ones(size, jnp.int32), label, number + 1)[:number]
    total = jax.ops.segment_sum(points[order], label, number + 1)[:number]
    first = jnp.clip(jax.ops.segment_min(index, label, number + 1)[:number], 0, size - 1)
    last = jnp.clip(jax.ops.segment_max(index, label, number + 1)[:number], 0, size - 1)
    left, right = order[first], order[last]
    width = jnp.linalg.norm(points[left] - points[right], axis=-1)
    is_cut = _is_behind(ranges, left, -1, gap, is_circle) | _is_behind(
        ranges, right, 1, gap, is_circle
    )
    return Clusters(
        total / jnp.maximum(count, 1)[:, None].astype(total.dtype),
        jnp.where(count > 0, width, 0.0),
        count,
        is_cut & (count > 0),
        jnp.zeros(size, jnp.int32).at[order].set(label),
    )


def has_neighbour(
    points: Float[Array, "P 2"], is_point: Bool[Array, " P"], gap: Scalar
) -> Bool[Array, " P"]:
    """Check which points (P,) of a circle have a neighbour.

    That is the point before or after, if it is at most `gap` [m] and a fortieth of the circle away.
    The points are in the order of their directions; those outside `is_point` do not count.
    """
    size = points.shape[0]
    former = _find_former(is_point)
    before = former % size
    is_near = jnp.linalg.norm(points - points[before], axis=-1) <= gap
    behind = jnp.arange(size, dtype=jnp.int32) - former
    is_joined = is_point & is_near & (behind <= max(1, size // FORTIETH)) & (former > -size)
    found: Array = is_joined.at[jnp.where(is_joined, before, size)].set(True, mode="drop")
    return found


def _find_former(is_point: Bool[Array, " P"]) -> Int[Array, " P"]:
    """Return the index (P,) of the point before each, less P if it is in the round before."""
    size = is_point.shape[0]
    index = jnp.arange(size, dtype=jnp.int32)
    # A running maximum over two rounds, of which the first one counts backwards from the first.
    marks = jnp.concatenate([jnp.where(is_point, index - size, -2 * size)] * 2)
    marks = marks.at[size:].add(jnp.where(is_point, size, 0))
    former: Array = jnp.roll(jax.lax.cummax(marks), 1)[size:]
    return former


def _is_behind(
    ranges: Float[Array, " B"], edge: Int[Array, " K"], step: int, gap: Scalar, is_circle: bool
) -> Bool[Array, " K"]:
    """Check whether the beam beside an edge ends before it, or there is none."""
    size = ranges.shape[0]
    beside = edge + step
    is_shorter = (ranges[beside % size] < ranges[edge] - gap) & (ranges[beside % size] > 0.0)
    return is_shorter if is_circle else is_shorter | (beside < 0) | (beside >= size)


class Edges(NamedTuple):
    """Edges of things behind which the robot does not see, the nearest first.

    `is_there` tells which of the E positions [m] are edges.
    """

    position: Float[Array, "E 2"]
    is_there: Bool[Array, " E"]

    @classmethod
    def none(cls, number: int) -> "Edges":
        """Return a number of edges that are not there."""
        return cls(jnp.zeros((number, 2)), jnp.zeros(number, bool))


def find_hiding_edges(
    points: Float[Array, "B 2"],
    ranges: Float[Array, " B"],
    is_edge: Bool[Array, " B"],
    width: Scalar,
    number: int,
    *,
    is_circle: bool,
) -> Edges:
    """Find where the range jumps by more than the width of what may be hidden [m]: the nearer
    neighbour is on the edge of something that hides what is behind it, and the farther one tells
    that there is room. Beams that met nothing have the greatest range. `is_edge` masks ends at
    something that does not move. At most `number` edges; `is_circle` if the first beam is beside
    the last; both static."""
    is_valid = ranges > 0.0

    def is_deeper(step: int) -> Bool[Array, " B"]:
        beside = jnp.roll(ranges, step)
        jump: Flag = (beside > ranges + width) & jnp.roll(is_valid, step)
        if not is_circle:
            jump = jump.at[0 if step > 0 else -1].set(False)
        return jump

    is_there = is_edge & is_valid & (is_deeper(1) | is_deeper(-1))
    number = min(number, ranges.shape[0])
    away, index = jax.lax.top_k(jnp.where(is_there, -ranges, -jnp.inf), number)
    return Edges(points[index], jnp.isfinite(away))
