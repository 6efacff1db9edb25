"""A value for every position and heading, on a lattice."""

import math

import equinox as eqx
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore._types import Position, Scalar
from jaxplore.maps.field import ScalarField, gather, stencil
from jaxplore.maps.frame import GridFrame


class HeadingField(eqx.Module):
    """A scalar over positions and headings, read by trilinear interpolation in O(1).

    Exact at its nodes, 0 outside, which begins right behind the outermost ones; differentiable.

    Args:
        values: (H, W, N) node values; node (row, column) is the centre of that cell of `frame`, and
            heading n is `n 2 pi / N` from the lattice's x axis.
        frame: where the lattice is.
    """

    values: Float[Array, "H W N"]
    frame: GridFrame

    def __call__(self, position: Position, heading: Scalar) -> Scalar:
        """Return the value at a world position (x, y) [m] and heading [rad]."""
        height, width, count = self.values.shape
        around = stencil((height, width), self.frame.to_grid(position), 0.0)
        is_finite = jnp.isfinite(heading)
        angle = jnp.where(is_finite, heading, 0.0) - self.frame.origin[2]
        turn = angle * (count / (2.0 * math.pi))
        floor = jnp.floor(turn)
        share = turn - floor
        first = jnp.mod(floor.astype(jnp.int32), count)
        # Headings are next to each other: a node's two come with one line of the cache.
        flat = self.values.reshape(-1, 1)
        before, after = (
            gather(flat, around.of_each(count, heading), 0.0)
            for heading in (first, jnp.mod(first + 1, count))
        )
        return jnp.where(is_finite, before + share * (after - before), 0.0)

    @property
    def headings(self) -> Float[Array, " N"]:
        """The headings of the nodes, in the world [rad]."""
        count = self.values.shape[-1]
        steps = jnp.arange(count, dtype=jnp.float32)
        return self.frame.origin[2] + steps * (2.0 * math.pi / count)

    @property
    def best(self) -> ScalarField:
        """The greatest value over the headings, by position; 0 outside the nodes."""
        return ScalarField(self.values.max(axis=-1), self.frame, jnp.zeros(()), 0.0)

    @property
    def origin(self) -> Position:
        """World position (x, y) of node (0, 0) [m]."""
        return self.frame.to_world(jnp.full(2, 0.5))
