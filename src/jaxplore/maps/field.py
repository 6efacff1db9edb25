"""Values on the nodes of a regular lattice, looked up in between."""

from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore._types import Count, Flag, Position, Scalar
from jaxplore.maps.frame import GridFrame


class Stencil(NamedTuple):
    """The four nodes around a point: `nodes` of the flattened lattice, `weight` adding up to 1, and
    whether the point is on the lattice at all.

    Numbers and not vectors of four: a look-up is mapped over thousands of points, where to take a
    vector apart is a transposition.
    """

    nodes: tuple[Count, Count, Count, Count]
    weight: tuple[Scalar, Scalar, Scalar, Scalar]
    is_inside: Flag

    def of_each(self, count: int, index: Count) -> "Stencil":
        """Return the stencil of the `index`-th of `count` values that a node has side by side."""
        a, b, c, d = (node * count + index for node in self.nodes)
        return self._replace(nodes=(a, b, c, d))


def stencil(shape: tuple[int, int], grid: Float[Array, "2"], margin: float = 0.5) -> Stencil:
    """Return the bilinear weights of the nodes around a point.

    Node (row, column) is at the middle of its cell, at grid coordinates
    `(row + 1/2, column + 1/2)`. Up to `margin` beyond the outermost nodes the edge value holds,
    farther out is outside, and so is a coordinate that is not finite.

    Args:
        shape: rows and columns of the lattice.
        grid: (row, column) [cells].
        margin: [cells]; at 1/2 the lattice covers its cells, at 0 it ends with its nodes.
    """
    height, width = shape
    row, column = jnp.unstack(grid - 0.5)
    # Positions of nodes come rounded: an outermost node is on the lattice.
    slack = margin + 1e-4
    inside = (row >= -slack) & (row <= height - 1 + slack)
    inside &= (column >= -slack) & (column <= width - 1 + slack)
    row = jnp.clip(jnp.where(inside, row, 0.0), 0.0, height - 1.0)
    column = jnp.clip(jnp.where(inside, column, 0.0), 0.0, width - 1.0)
    first_row = jnp.minimum(row.astype(jnp.int32), max(height - 2, 0))
    first_column = jnp.minimum(column.astype(jnp.int32), max(width - 2, 0))
    down, right = min(1, height - 1) * width, min(1, width - 1)
    v = row - first_row.astype(row.dtype)
    u = column - first_column.astype(row.dtype)
    corner = first_row * width + first_column
    return Stencil(
        (corner, corner + right, corner + down, corner + (down + right)),
        ((1 - v) * (1 - u), (1 - v) * u, v * (1 - u), v * u),
        inside,
    )


def gather(
    values: Float[Array, "*S"], around: Stencil, outside: Scalar | float, channel: Count | int = 0
) -> Scalar:
    """Return the interpolated value of one channel.

    Args:
        values: (H, W) or (C, H, W) node values.
        around: from `stencil`.
        outside: what a point off the lattice gets.
        channel: which of the C channels.
    """
    height, width = values.shape[-2:]
    # One flat index: multi-dimensional gathers cost a multiplication and a bounds check each.
    flat, first = values.reshape(-1), channel * (height * width)
    total = jnp.zeros(())
    for node, weight in zip(around.nodes, around.weight, strict=True):
        at_node = flat.at[first + node]
        total = total + weight * at_node.get(mode="promise_in_bounds", wrap_negative_indices=False)
    return jnp.where(around.is_inside, total, outside)


def bilinear(
    values: Float[Array, "H W"], grid: Float[Array, "2"], outside: Scalar | float
) -> Scalar:
    """Interpolate node values at a point: see `stencil` for the lattice and its edge."""
    height, width = values.shape
    return gather(values, stencil((height, width), grid), outside)


class ScalarField(eqx.Module):
    """A scalar on a regular lattice, read by bilinear interpolation in O(1).

    Args:
        values: (H, W) node values; node (row, column) is the centre of that cell of `frame`.
        frame: where the lattice is.
        outside: value off the lattice.
        margin: how far the lattice goes beyond its outermost nodes [cells]; static.
    """

    values: Float[Array, "H W"]
    frame: GridFrame
    outside: Scalar
    margin: float = eqx.field(static=True, default=0.5)

    def __call__(self, position: Position) -> Scalar:
        """Return the value at a world position (x, y) [m]."""
        height, width = self.values.shape
        around = stencil((height, width), self.frame.to_grid(position), self.margin)
        return gather(self.values, around, self.outside)
