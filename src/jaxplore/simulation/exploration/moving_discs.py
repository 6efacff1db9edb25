"""What moves in a true world at a moment."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

START_OF_MOVING = 2**31 - 1
"""Number folded into a random key for all that moving obstacles draw: into the key of a run for
their start, into that of a step for their measurement. It is never the number of a step or of a
sensor, so the draws are independent of theirs."""


class MovingDiscs(NamedTuple):
    """Positions (M, 2) [m], velocities (M, 2) [m/s] and radii (M,) [m] of discs at a moment.

    In a volume they are upright cylinders.
    """

    positions: Float[Array, "M 2"]
    velocities: Float[Array, "M 2"]
    radius: Float[Array, " M"]

    @property
    def discs(self) -> Float[Array, "M 3"]:
        """(x, y, radius) of each disc [m]."""
        return jnp.concatenate([self.positions, self.radius[:, None]], axis=-1)

    @classmethod
    def join(cls, several: Sequence["MovingDiscs | None"]) -> "MovingDiscs | None":
        """Return all discs of several, in their order; None without any."""
        found = [each for each in several if each is not None]
        if len(found) < 2:
            return found[0] if found else None
        return cls(*(jnp.concatenate(each) for each in zip(*found, strict=True)))
