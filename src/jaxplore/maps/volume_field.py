"""Values at the nodes of a lattice in a volume, interpolated trilinearly."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxplore._types import Scalar


class VolumeField(eqx.Module):
    """Scalar field in a volume, read in O(1); `ScalarField` of the plane in three dimensions.

    `origin` is the position of node (0, 0, 0), `spacing` (static) that of nodes [m], and `outside`
    the value farther than half a spacing off the lattice, and at what is not finite.
    """

    values: Float[Array, "D H W"]
    origin: Float[Array, "3"]
    spacing: float = eqx.field(static=True)
    outside: Scalar

    dimensions: ClassVar[int] = 3
    """Number of components of a position."""

    def __call__(self, position: Float[Array, "3"]) -> Scalar:
        """Return the value at a world position (x, y, z), z up [m]."""
        x, y, z = jnp.unstack(position)
        depth, height, width = self.values.shape
        # Scalars instead of vectors of three: mapped over thousands of points, unpacking a vector
        # would be a transposition.
        u = (x - self.origin[0]) / self.spacing
        v = (y - self.origin[1]) / self.spacing
        w = (z - self.origin[2]) / self.spacing
        slack = 0.5 + 1e-4
        inside = (u >= -slack) & (u <= width - 1 + slack)
        inside &= (v >= -slack) & (v <= height - 1 + slack)
        inside &= (w >= -slack) & (w <= depth - 1 + slack)
        # A point outside, which may be NaN, still needs valid nodes.
        i, a = _interval(jnp.where(inside, u, 0.0), width)
        j, b = _interval(jnp.where(inside, v, 0.0), height)
        k, c = _interval(jnp.where(inside, w, 0.0), depth)
        flat = self.values.reshape(-1)
        right, up = min(1, width - 1), min(1, height - 1) * width
        top = min(1, depth - 1) * height * width
        corner = (k * height + j) * width + i
        total = jnp.zeros(())
        for step_z, share_z in ((0, 1.0 - c), (top, c)):
            for step_y, share_y in ((0, 1.0 - b), (up, b)):
                for step_x, share_x in ((0, 1.0 - a), (right, a)):
                    node = corner + (step_z + step_y + step_x)
                    at_node = flat.at[node].get(
                        mode="promise_in_bounds", wrap_negative_indices=False
                    )
                    total = total + share_z * share_y * share_x * at_node
        return jnp.where(inside, total, self.outside)

    def place(self, node: Int[Array, "3"]) -> Float[Array, "3"]:
        """Return the position (x, y, z) of a node (k, j, i) [m]."""
        return self.origin + self.spacing * jnp.flip(node).astype(jnp.float32)


def _interval(along: Scalar, size: int) -> tuple[Array, Scalar]:
    """Return the first node of the interval with a coordinate, and the share of the way in it."""
    bounded = jnp.clip(along, 0.0, size - 1.0)
    first = jnp.minimum(bounded.astype(jnp.int32), max(size - 2, 0))
    return first, bounded - first.astype(bounded.dtype)
