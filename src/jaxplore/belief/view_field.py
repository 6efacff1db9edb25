"""Information of a volume by position and heading, and what each heading sees of the sectors."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore._types import Scalar
from jaxplore.maps.volume_field import VolumeField


class ViewField(eqx.Module):
    """Information of a scan by position and heading, read in O(1): the expected gain of each voxel
    in view times its volume, so that it does not depend on the resolution.

    Args:
        values: (A, D, H, W) information for A equally spaced headings at the nodes [nat m^3].
        origin: position (x, y, z) of node (0, 0, 0) [m].
        spacing: distance between nodes [m]; static.
    """

    values: Float[Array, "A D H W"]
    origin: Float[Array, "3"]
    spacing: float = eqx.field(static=True)

    def __call__(self, position: Float[Array, "3"], heading: Scalar) -> Scalar:
        """Return the information at a position (x, y, z) [m] and a heading [rad]."""
        number = self.values.shape[0]
        turns = jnp.where(jnp.isfinite(heading), heading, 0.0) * (number / (2.0 * math.pi))
        low = jnp.floor(turns)
        share = turns - low
        first = low.astype(jnp.int32) % number
        nothing = jnp.zeros(())

        def at(index: Array) -> Scalar:
            # One lattice with the headings side by side along z would interpolate across them, so
            # each heading is a field of its own.
            return VolumeField(self.values[index], self.origin, self.spacing, nothing)(position)

        return (1.0 - share) * at(first) + share * at((first + 1) % number)


def sectors_in_view(number: int, view: float) -> np.ndarray:
    """Return the share (A, A) of each sector that is in view with each heading."""
    headings = np.arange(number) * 2.0 * math.pi / number
    width = 2.0 * math.pi / number
    shares = np.zeros((number, number))
    for h, heading in enumerate(headings):
        for a in range(number):
            for turn in (-2.0 * math.pi, 0.0, 2.0 * math.pi):
                low, high = a * width + turn, (a + 1) * width + turn
                shares[h, a] += max(
                    0.0, min(high, heading + view / 2.0) - max(low, heading - view / 2.0)
                )
    return (shares / width).astype(np.float32)


def turn_shares(number: int) -> np.ndarray:
    """Return `(1 + cos(h - h_a)) / 2` (A, A) of each heading and the middle of each sector."""
    headings = np.arange(number) * 2.0 * math.pi / number
    gap = headings[:, None] - (headings + math.pi / number)[None, :]
    return (0.5 + 0.5 * np.cos(gap)).astype(np.float32)


NEAR = 0.6
"""Distance within which time counts in full as time near a viewpoint, and not at all at twice that
[m]."""
ASIDE = 0.1
"""Share of the time near a viewpoint that counts for sectors out of view."""


def time_near(
    before: Float[Array, "A D H W"],
    distance: Float[Array, "D H W"],
    in_view: Float[Array, "A A"],
    heading: Scalar,
    elapsed: Scalar,
    memory: Scalar,
) -> Float[Array, "A D H W"]:
    """Return the time near each node with each sector in view [s], with the last one added.

    `in_view` is the share of each sector in view at each heading, and `memory` the time constant
    with which the time is forgotten [s].
    """
    near = jnp.clip(2.0 - distance / NEAR, 0.0, 1.0)
    number = len(in_view)
    angle = jnp.where(jnp.isfinite(heading), heading, 0.0)
    index = jnp.round(angle * (number / (2.0 * math.pi))).astype(jnp.int32) % number
    # Also where the robot does not look, so that it leaves a place at which it need not turn.
    shares = jnp.maximum(in_view[index], ASIDE)[:, None, None, None]
    is_known = jnp.isfinite(distance) & jnp.isfinite(heading)
    more = jnp.where(is_known, elapsed * shares * near, 0.0)
    return before * jnp.exp(-elapsed / memory) + more
