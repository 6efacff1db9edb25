"""Interpolate values that are stored at the nodes of a regular lattice."""

from typing import TYPE_CHECKING, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore._types import Count, Flag, Position, Scalar
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.lattice_figure import lattice_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Stencil(NamedTuple):
    """The four nodes around a point as indices into the flattened lattice, their bilinear weights,
    and whether it is on the lattice. They are tuples of scalars instead of vectors of four: mapped
    over thousands of points, unpacking a vector would be a transposition."""

    nodes: tuple[Count, Count, Count, Count]
    weight: tuple[Scalar, Scalar, Scalar, Scalar]
    is_inside: Flag

    def of_each(self, count: int, index: Count) -> "Stencil":
        """Return the stencil of value `index` on a lattice that stores `count` values per node."""
        a, b, c, d = (node * count + index for node in self.nodes)
        return self._replace(nodes=(a, b, c, d))


def stencil(shape: tuple[int, int], grid: Float[Array, "2"], margin: float = 0.5) -> Stencil:
    """Return the nodes around a point (row, column) [cells] and their bilinear weights.

    Node (row, column) is at the centre of its cell, at grid coordinates
    `(row + 1/2, column + 1/2)`. Up to `margin` [cells] beyond the outermost nodes the value of the
    edge is used: with 1/2 the lattice covers its cells, with 0 it ends at its nodes. A point
    farther out is outside, and so is a point with a coordinate that is not finite.
    """
    height, width = shape
    row, column = jnp.unstack(grid - 0.5)
    # Tolerate rounding: the position of an outermost node must count as inside.
    slack = margin + 1e-4
    inside = (row >= -slack) & (row <= height - 1 + slack)
    inside &= (column >= -slack) & (column <= width - 1 + slack)
    # A point outside, which may be NaN, still needs valid nodes; `gather` replaces its value.
    row = jnp.clip(jnp.where(inside, row, 0.0), 0.0, height - 1.0)
    column = jnp.clip(jnp.where(inside, column, 0.0), 0.0, width - 1.0)
    # On the last node take the interval before it, and on an axis of one node the node itself.
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
    """Return one channel of node values (H, W) or (C, H, W), interpolated at a point.

    Off the lattice it is `outside`.
    """
    height, width = values.shape[-2:]
    # Use one flat index: a multi-dimensional gather needs a multiplication and a bounds check per
    # axis.
    flat, first = values.reshape(-1), channel * (height * width)
    total = jnp.zeros(())
    for node, weight in zip(around.nodes, around.weight, strict=True):
        at_node = flat.at[first + node]
        total = total + weight * at_node.get(mode="promise_in_bounds", wrap_negative_indices=False)
    return jnp.where(around.is_inside, total, outside)


def bilinear(
    values: Float[Array, "H W"], grid: Float[Array, "2"], outside: Scalar | float
) -> Scalar:
    """Return the bilinear interpolation of node values (H, W) at a point (row, column) [cells].

    Off the lattice it is `outside`; see `stencil`.
    """
    height, width = values.shape
    return gather(values, stencil((height, width), grid), outside)


class ScalarField(eqx.Module):
    """Scalar field on a regular lattice, read by bilinear interpolation in O(1).

    Args:
        values: node values (H, W); node (row, column) is the centre of that cell of `frame`.
        frame: pose and node spacing of the lattice.
        outside: value off the lattice.
        margin: width of the border beyond the outermost nodes that still counts as inside [cells];
            static.
    """

    values: Float[Array, "H W"]
    frame: GridFrame
    outside: Scalar
    margin: float = eqx.field(static=True, default=0.5)

    dimensions: ClassVar[int] = 2
    """Number of components of a position."""

    def __call__(self, position: Position) -> Scalar:
        """Return the value at a world position (x, y) [m]."""
        height, width = self.values.shape
        around = stencil((height, width), self.frame.to_grid(position), self.margin)
        return gather(self.values, around, self.outside)

    def plot(self, label: str = "value") -> "Figure":
        """Draw the field in the world, with a colour bar.

        Args:
            label: label of the colour bar, with the unit.
        """
        return lattice_figure(self.values, self.frame, label)
