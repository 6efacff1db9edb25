"""Interpolate a scalar over position and heading from values on a lattice."""

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore import _checks
from jaxplore._types import Position, Scalar
from jaxplore.maps.field import ScalarField, gather, stencil
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.lattice_figure import lattice_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class HeadingField(eqx.Module):
    """Scalar field over position and heading, read by trilinear interpolation in O(1).

    It is exact at the nodes, 0 beyond the outermost nodes, and differentiable.

    Args:
        values: node values (H, W, N); node (row, column) is the centre of that cell of `frame`, and
            heading n is `n 2 pi / N` from the lattice's x axis.
        frame: pose and node spacing of the lattice.
    """

    values: Float[Array, "H W N"]
    frame: GridFrame

    def __call__(self, position: Position, heading: Scalar) -> Scalar:
        """Return the value at a world position (x, y) [m] and heading [rad]."""
        height, width, count = self.values.shape
        around = stencil((height, width), self.frame.to_grid(position), 0.0)
        is_finite = jnp.isfinite(heading)
        # Converting NaN to an index is undefined, so a heading that is not finite is replaced here
        # and masked at the end.
        angle = jnp.where(is_finite, heading, 0.0) - self.frame.origin[2]
        turn = angle * (count / (2.0 * math.pi))
        floor = jnp.floor(turn)
        share = turn - floor
        first = jnp.mod(floor.astype(jnp.int32), count)
        # The headings of a node are adjacent in memory: both come with one cache line.
        flat = self.values.reshape(-1, 1)
        before, after = (
            gather(flat, around.of_each(count, heading), 0.0)
            for heading in (first, jnp.mod(first + 1, count))
        )
        return jnp.where(is_finite, before + share * (after - before), 0.0)

    @property
    def headings(self) -> Float[Array, " N"]:
        """World headings of the nodes [rad]."""
        count = self.values.shape[-1]
        steps = jnp.arange(count, dtype=jnp.float32)
        return self.frame.origin[2] + steps * (2.0 * math.pi / count)

    @property
    def best(self) -> ScalarField:
        """Field of the maximum over headings; 0 beyond the outermost nodes."""
        return ScalarField(self.values.max(axis=-1), self.frame, jnp.zeros(()), 0.0)

    def plot(self, heading: float | None = None) -> "Figure":
        """Draw the field in the world, with a colour bar.

        Args:
            heading: heading of the sensor [rad]; the best one at each node when absent.

        Raises:
            ValueError: a heading that is not finite.
        """
        if heading is None:
            return lattice_figure(self.best.values, self.frame, "information, best heading [nat]")
        angle = _checks.scalar("heading", heading)
        return at_nodes_figure(self, self.frame, self.best.values.shape, angle)

    @property
    def origin(self) -> Position:
        """World position (x, y) of node (0, 0) [m]."""
        return self.frame.to_world(jnp.full(2, 0.5))


def at_nodes_figure(
    field: Callable[[Position, Scalar], Scalar],
    frame: GridFrame,
    shape: tuple[int, ...],
    heading: Scalar,
) -> "Figure":
    """Draw what a field of position [m] and heading [rad] reads at its nodes with one heading."""
    nodes = frame.cell_centre(jnp.stack(jnp.mgrid[: shape[0], : shape[1]], axis=-1))
    values = jax.vmap(jax.vmap(lambda position: field(position, heading)))(nodes)
    return lattice_figure(values, frame, f"information, heading {float(heading):.2f} rad [nat]")
