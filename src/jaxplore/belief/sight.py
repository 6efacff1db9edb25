"""Test lines of sight on the robot's map."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore._types import Position, Scalar
from jaxplore.maps.occupancy_grid import FREE_THRESHOLD, OccupancyGrid

SAMPLES = 24
"""Number of points of a line at which it is tested."""


def is_in_sight(
    grid: OccupancyGrid,
    nodes: Float[Array, "rows columns 2"],
    place: Position,
    apart: float,
) -> Bool[Array, "rows columns"]:
    """Return whether the straight line from each node to a place is known to be free.

    `SAMPLES` points of the line are tested. The last `apart` metres are not: cells at the place
    itself may be solid on the robot's map.
    """
    offset = place - nodes
    distance = jnp.linalg.norm(offset, axis=-1)
    share = jnp.maximum(1.0 - apart / jnp.maximum(distance, 1e-3), 0.0)

    def is_clear(part: Scalar) -> Bool[Array, "rows columns"]:
        return grid.at(nodes + (part * share)[..., None] * offset) < FREE_THRESHOLD

    parts = jnp.linspace(0.0, 1.0, SAMPLES)
    clear: Bool[Array, "rows columns"] = jax.lax.fori_loop(
        0,
        SAMPLES,
        lambda k, so_far: so_far & is_clear(parts[k]),
        jnp.ones(distance.shape, bool),
    )
    return clear
