"""The rays of a sensor: the cells that they cross, and how far it is to the first of something."""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from jaxplore._types import Position
from jaxplore.geometry.rays import RayCells, traverse
from jaxplore.maps.occupancy_grid import OccupancyGrid


def fan(
    grid: OccupancyGrid, position: Position, angles: Float[Array, " B"], max_range: float
) -> RayCells:
    """Return the cells that rays cross, nearest first: (B, N) of everything in `RayCells`.

    Args:
        grid: whose cells.
        position: start of the rays (x, y) in the world [m].
        angles: directions in the grid's frame [rad].
        max_range: static; at least the cells entered within it are returned [m].
    """
    start = grid.frame.to_grid(position)
    length = max_range / grid.resolution
    return jax.vmap(lambda angle: traverse(start, angle, length))(angles)


def first_entry(
    cells: RayCells, is_wanted: Bool[Array, "*B N"], unit: float = 1.0
) -> Float[Array, "*B"]:
    """Return where each ray enters the first cell that is wanted, infinity where it enters none.

    `unit` is what a cell's side is in the unit of the answer: 1 for cells, the resolution for
    metres.
    """
    return jnp.where(is_wanted, cells.entry * unit, jnp.inf).min(axis=-1)


def disc_distance(
    position: Position, angles: Float[Array, " B"], discs: Float[Array, "M 3"]
) -> Float[Array, " B"]:
    """Return how far it is along each ray to the first of some discs [m].

    With c the centre as seen from the start, u the ray's direction and r the radius, the ray enters
    the disc after

        c . u - sqrt(r^2 - (c x u)^2)

    It is 0 inside a disc and infinite where the ray meets none. A disc whose radius is not above 0,
    or that is not finite, is none.

    Args:
        position: start of the rays (x, y) [m].
        angles: directions (B,) [rad].
        discs: x, y and radius (M, 3) [m]; M may be 0.
    """
    x, y, radius = (
        column[:, None]
        for column in (discs[:, 0] - position[0], discs[:, 1] - position[1], discs[:, 2])
    )
    cos, sin = jnp.cos(angles), jnp.sin(angles)
    along = x * cos + y * sin
    square = radius**2 - (x * sin - y * cos) ** 2
    is_crossed = (radius > 0.0) & (square > 0.0)
    half = jnp.sqrt(jnp.where(is_crossed, square, 1.0))
    is_met = is_crossed & (along + half > 0.0) & jnp.isfinite(along)
    distance = jnp.where(is_met, jnp.maximum(along - half, 0.0), jnp.inf)
    return distance.min(axis=0, initial=jnp.inf)
