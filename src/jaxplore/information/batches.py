"""Apply a function of one pose to one pose or to many."""

from collections.abc import Callable

import jax
from jax import Array
from jaxtyping import Float

from jaxplore._types import Position, Scalar

BATCH = 64
"""Poses that are evaluated at once: the working memory of a batch fits the CPU's cache."""


def over_poses(
    gain: Callable[[Position, Scalar], Scalar],
    position: Float[Array, "*N 2"],
    heading: Float[Array, "*N"],
) -> Float[Array, "*N"]:
    """Evaluate a function of position [m] and heading [rad] at one pose or at each of N poses."""
    if position.ndim not in (1, 2) or position.shape != (*heading.shape, 2):
        raise ValueError(
            f"position has shape {position.shape}, heading {heading.shape}; accepted: (2,) and () "
            "or (N, 2) and (N,)"
        )
    if position.ndim == 1:
        return gain(position, heading)
    # A single `vmap` over many poses would write its intermediate arrays to main memory.
    if position.shape[0] <= BATCH:
        return jax.vmap(gain)(position, heading)
    values: Array = jax.lax.map(lambda pose: gain(*pose), (position, heading), batch_size=BATCH)
    return values
