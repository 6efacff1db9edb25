"""A reference that climbs an information field."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float

from jaxplore import _checks
from jaxplore._types import Flag, Position, Scalar
from jaxplore.maps.field import ScalarField, gather, stencil
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD, OccupancyGrid

FLAT = 1e-5
"""Slope below which a field is flat, of its greatest value over a node spacing."""


class GradientReference(eqx.Module):
    """Positions of a robot that climbs a field at constant speed:

        x_{t+1} = x_t + speed dt g(x_t) / |g(x_t)|

    with g the central differences between nodes, interpolated. It stands still where the field is
    flat and on top of it, off the field, and where the way up leads off the map or into a cell
    known to be occupied; along a wall it goes on sideways as long as that leads up. Steps longer
    than half a map cell are made of shorter ones, so no wall is stepped over, and the reference
    follows a bend within a step.

    The reference of the two-layer controller of the quadrotor design notes.

    Args:
        speed: [m/s].
        num_steps: T; static.
        dt: time between positions [s].

    Raises:
        ValueError: a value that is not positive.
    """

    speed: Scalar
    dt: Scalar
    num_steps: int = eqx.field(static=True)

    def __init__(self, speed: ArrayLike = 2.0, num_steps: int = 40, dt: ArrayLike = 0.05) -> None:
        self.speed = _checks.scalar("speed", speed, above=0.0)
        self.dt = _checks.scalar("dt", dt, above=0.0)
        self.num_steps = _checks.positive_int("num_steps", num_steps)

    def __call__(
        self, field: ScalarField, grid: OccupancyGrid, start: Float[Array, "3"]
    ) -> Float[Array, "T 3"]:
        """Return the positions after 1 ... T steps.

        Args:
            field: to be climbed, such as `LocalFieldSensor(...).field(...).best`.
            grid: what is known.
            start: (x, y, z) [m]; z is kept.
        """
        along_row, along_column = jnp.gradient(field.values, field.frame.resolution)
        slopes = jnp.stack([along_row, along_column])
        flat = FLAT * jnp.abs(field.values).max() / field.frame.resolution
        length = self.speed * self.dt
        pieces = jnp.maximum(jnp.ceil(length / (0.5 * grid.resolution)), 1.0)

        def piece(_: Array, position: Array) -> Array:
            return _climb(field, slopes, flat, grid, position, length / pieces)

        def step(position: Array, _: None) -> tuple[Array, Array]:
            after = jax.lax.fori_loop(0, pieces.astype(jnp.int32), piece, position)
            return after, after

        _, path = jax.lax.scan(step, start[:2], length=self.num_steps)
        height = jnp.broadcast_to(start[2], (self.num_steps, 1))
        return jnp.concatenate([path, height], axis=1)


def _climb(
    field: ScalarField,
    slopes: Array,
    flat: Scalar,
    grid: OccupancyGrid,
    position: Position,
    length: Scalar,
) -> Position:
    """Return where one short step up leads."""
    rows, columns = field.values.shape
    around = stencil((rows, columns), field.frame.to_grid(position), field.margin)
    up_row, up_column = (gather(slopes, around, 0.0, axis) for axis in (0, 1))
    slope = jnp.sqrt(up_row * up_row + up_column * up_column)
    scale = jnp.where(slope > flat, length / jnp.where(slope > flat, slope, 1.0), 0.0)
    up = scale * _turned(up_column, up_row, field.frame.origin[2])
    # The way up first; where it is blocked, along the map's axis that rises more, then the other.
    yaw = grid.frame.origin[2]
    along_x, along_y = _turned(up[0], up[1], -yaw)
    by_x = _turned(length * jnp.sign(along_x), jnp.zeros(()), yaw)
    by_y = _turned(jnp.zeros(()), length * jnp.sign(along_y), yaw)
    is_x = jnp.abs(along_x) >= jnp.abs(along_y)
    here = field(position)
    result, is_done = position, scale <= 0.0
    for move in (up, jnp.where(is_x, by_x, by_y), jnp.where(is_x, by_y, by_x)):
        after = position + move
        is_allowed = _is_clear(grid, position, after) & (field(after) > here)
        result = jnp.where(is_allowed & ~is_done, after, result)
        is_done = is_done | is_allowed
    return result


def _turned(x: Scalar, y: Scalar, yaw: Scalar) -> Position:
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)
    return jnp.stack([cos * x - sin * y, sin * x + cos * y])


def _is_clear(grid: OccupancyGrid, before: Position, after: Position) -> Flag:
    """Say whether a step of at most half a cell keeps out of what is known to be occupied.

    Diagonally it passes one of the two cells between: both must be clear.
    """
    (row, column), (next_row, next_column) = (
        grid.frame.to_cell(position) for position in (before, after)
    )
    rows = jnp.stack([row, next_row, row, next_row])
    columns = jnp.stack([column, next_column, next_column, column])
    cells = jnp.stack([rows, columns], axis=-1)
    return jnp.all(grid.at_cell(cells) <= OCCUPIED_THRESHOLD)
