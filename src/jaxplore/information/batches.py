"""A gain of one pose, applied to one or to many."""

from collections.abc import Callable

import jax
from jax import Array
from jaxtyping import Float

from jaxplore._types import Position, Scalar

BATCH = 64
"""Poses evaluated at once: what a batch works on stays in the cache."""


def over_poses(
    gain: Callable[[Position, Scalar], Scalar],
    position: Float[Array, "*N 2"],
    heading: Float[Array, "*N"],
) -> Float[Array, "*N"]:
    """Return the gain of one pose, (2,) and (), or of each of N, (N, 2) and (N,).

    Raises:
        ValueError: shapes that are neither.
    """
    if position.ndim not in (1, 2) or position.shape != (*heading.shape, 2):
        raise ValueError(
            f"position has shape {position.shape}, heading {heading.shape}; accepted: (2,) and () "
            "or (N, 2) and (N,)"
        )
    if position.ndim == 1:
        return gain(position, heading)
    if position.shape[0] <= BATCH:
        return jax.vmap(gain)(position, heading)
    values: Array = jax.lax.map(lambda pose: gain(*pose), (position, heading), batch_size=BATCH)
    return values
