"""A reference of positions with the times at which they are due."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Scalar


class TimedReference(eqx.Module):
    """What beliefs with the reference of a strategic layer have in common; abstract.

    Args:
        reference: (T, 3) reference positions [m]; row i is due in
            `(i + 1) reference_period - reference_age` seconds.
        reference_period: time between the rows of the reference [s].
        reference_age: time since the reference was made [s].
    """

    reference: eqx.AbstractVar[Float[Array, "T 3"]]
    reference_period: eqx.AbstractVar[Scalar]
    reference_age: eqx.AbstractVar[Scalar]

    dimensions: ClassVar[int] = 2
    """Number of components of the reference that count: a reference in the plane has no height."""

    def reference_at(self, t: Scalar) -> Float[Array, "3"]:
        """Interpolate the reference position `t` seconds from now [m].

        Linear between rows; before the first and after the last row, that row.
        """
        # Row 0 is due one period after the reference was made, not when it was made.
        last = self.reference.shape[0] - 1
        row = jnp.clip((t + self.reference_age) / self.reference_period - 1.0, 0.0, last)
        before = jnp.floor(row)
        index = before.astype(jnp.int32)
        start, end = self.reference[index], self.reference[jnp.minimum(index + 1, last)]
        return start + (row - before) * (end - start)
