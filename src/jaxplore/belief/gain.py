"""Tell how long ago something new was seen."""

from typing import NamedTuple

import jax.numpy as jnp

from jaxplore._types import Flag, Scalar

LEAST_GAIN = 1e-3
"""Rise of a share that counts as progress: noise at walls makes smaller ones for ever."""


class Gain(NamedTuple):
    """The last progress of an exploration: the share of the map that was known, and the time since
    [s]."""

    share: Scalar
    since: Scalar

    def update(self, share: Scalar, period: Scalar, is_sent: Flag | None = None) -> "Gain":
        """Return the last progress one period [s] later, with the share of that time.

        The time of a robot that is sent somewhere does not count.
        """
        if is_sent is not None:
            period = jnp.where(is_sent, 0.0, period)
        is_more: Flag = share >= self.share + LEAST_GAIN
        return Gain(
            jnp.where(is_more, share, self.share),
            jnp.where(is_more, 0.0, self.since + period),
        )
