"""Cast the rays of a sensor through a grid, and through moving discs."""

import math

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from jaxplore import _checks
from jaxplore._limits import LONGEST_RANGE
from jaxplore.geometry.rays import RayCells, traverse
from jaxplore.maps.occupancy_grid import OccupancyGrid


def fan(
    grid: OccupancyGrid,
    position: Float[Array, "*S 2"],
    angles: Float[Array, " B"],
    max_range: float,
) -> RayCells:
    """Return the cells that rays cross within `max_range` [m] (static), nearest first: `RayCells`
    with a leading axis B. They start at a position (x, y), or each at its own (B, 2) [m]. Angles
    are in the grid's frame. The probabilities of the grid are not read."""
    start = grid.frame.to_grid(position)
    length = max_range / grid.resolution
    if start.ndim == 2:
        return jax.vmap(lambda place, angle: traverse(place, angle, length))(start, angles)
    return jax.vmap(lambda angle: traverse(start, angle, length))(angles)


def first_entry(
    cells: RayCells, is_wanted: Bool[Array, "*B N"], unit: float = 1.0
) -> Float[Array, "*B"]:
    """Return the distance at which each ray enters its first wanted cell, or infinity.

    The cells of a ray are in order, nearest first. `unit` is the length of a cell's side in the
    unit of the result: 1 for cells, the resolution for metres.
    """
    return jnp.where(is_wanted, cells.entry * unit, jnp.inf).min(axis=-1)


def disc_distance(
    position: Float[Array, "*S 2"], angles: Float[Array, " B"], discs: Float[Array, "M *D 3"]
) -> Float[Array, " B"]:
    """Return the distance along each ray to the first of M discs [m].

    With c the centre of a disc relative to the start, u the direction of the ray and r the radius,
    the ray enters the disc at the distance

        c . u - sqrt(r^2 - (c x u)^2)

    The result is 0 inside a disc, and infinite if the ray meets no disc. A disc with a radius <= 0
    or with a value that is not finite is ignored.

    Rays start at a position (x, y), or each at its own (B, 2) [m]. Discs (M, 3) are (x, y, radius)
    [m], or (M, B, 3) where each ray meets them; M may be 0.
    """
    if discs.ndim == 2:
        discs = discs[:, None]
    x, y = discs[..., 0] - position[..., 0], discs[..., 1] - position[..., 1]
    radius = discs[..., 2]
    cos, sin = jnp.cos(angles), jnp.sin(angles)
    along = x * cos + y * sin
    square = radius**2 - (x * sin - y * cos) ** 2
    # Rays that miss a disc have no square root: guard its argument as well as the result, because
    # the gradient of `where` evaluates both.
    is_crossed = (radius > 0.0) & (square > 0.0)
    half = jnp.sqrt(jnp.where(is_crossed, square, 1.0))
    is_met = is_crossed & (along + half > 0.0) & jnp.isfinite(along)
    distance = jnp.where(is_met, jnp.maximum(along - half, 0.0), jnp.inf)
    return distance.min(axis=0, initial=jnp.inf)


def check_range(name: str, value: float) -> float:
    """Return a greatest range [m]; warn if its unit is likely to be another one."""
    reach = _checks.number(name, value, above=0.0, at_most=LONGEST_RANGE)
    _checks.warn_above(name, reach, 1000.0, "a range is in metres, not in millimetres")
    return reach


def check_view(name: str, value: float) -> float:
    """Return a horizontal field of view [rad]; refuse one outside (0, 2 pi]."""
    # 2 pi rounded to float32 is slightly greater than 2 pi.
    return _checks.number(name, value, above=0.0, at_most=2.0 * math.pi + 1e-6)
