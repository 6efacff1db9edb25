"""Gradient ascent on a field, as a reference of positions."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore import _checks
from jaxplore._limits import MOST_STEPS_AHEAD
from jaxplore._types import ArrayLike, Flag, Position, Scalar
from jaxplore.maps.field import ScalarField, gather, stencil
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD, OccupancyGrid

FLAT = 1e-5
"""Slope below which a field counts as flat, in greatest values per node spacing."""


class GradientReference(eqx.Module):
    """Gradient ascent on a field at constant speed:

        x_{t+1} = x_t + speed dt g(x_t) / |g(x_t)|

    with g the interpolated central differences between nodes. The reference stands still where the
    field is flat, at a maximum, off the field, and where the next step would leave the map or enter
    a cell known to be occupied. Along a wall it slides as long as the field rises. Steps longer
    than half a map cell are divided, so that no wall is stepped over and bends are followed.

    Source: the two-layer controller of the quadrotor design notes.

    Args:
        speed: speed of the reference [m/s].
        num_steps: number of positions, T; static.
        dt: time between positions [s].
        reverse_speed: speed where a car drives backwards, see `descend` [m/s]; `speed` when absent.

    Raises:
        ValueError: a value that is not positive.
    """

    speed: Scalar
    reverse_speed: Scalar
    dt: Scalar
    num_steps: int = eqx.field(static=True)

    def __init__(
        self,
        speed: ArrayLike = 2.0,
        num_steps: int = 40,
        dt: ArrayLike = 0.05,
        reverse_speed: ArrayLike | None = None,
    ) -> None:
        self.speed = _checks.scalar("speed", speed, above=0.0)
        self.reverse_speed = (
            self.speed
            if reverse_speed is None
            else _checks.scalar("reverse_speed", reverse_speed, above=0.0)
        )
        self.dt = _checks.scalar("dt", dt, above=0.0)
        self.num_steps = _checks.positive_int("num_steps", num_steps, at_most=MOST_STEPS_AHEAD)

    def __call__(
        self, field: ScalarField, grid: OccupancyGrid, start: Float[Array, "3"]
    ) -> Float[Array, "T 3"]:
        """Compute the positions (x, y, z) after 1 ...

        T steps [m] that ascend a field, such as `LocalFieldSensor(...).field(...).best`, on the map
        that the robot knows; z is kept.
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
    """Take one short step up the field; stand still where none is allowed."""
    rows, columns = field.values.shape
    nodes = stencil((rows, columns), field.frame.to_grid(position), field.margin)
    up_row, up_column = (gather(slopes, nodes, 0.0, axis) for axis in (0, 1))
    slope = jnp.sqrt(up_row * up_row + up_column * up_column)
    scale = jnp.where(slope > flat, length / jnp.where(slope > flat, slope, 1.0), 0.0)
    up = scale * _rotate(up_column, up_row, field.frame.origin[2])
    # Try the gradient first. Where it is blocked, slide along the map axis that rises more, then
    # along the other one.
    yaw = grid.frame.origin[2]
    along_x, along_y = _rotate(up[0], up[1], -yaw)
    by_x = _rotate(length * jnp.sign(along_x), jnp.zeros(()), yaw)
    by_y = _rotate(jnp.zeros(()), length * jnp.sign(along_y), yaw)
    is_x = jnp.abs(along_x) >= jnp.abs(along_y)
    # All three at once: one program, of which each look-up is compiled once.
    moves = jnp.stack([up, jnp.where(is_x, by_x, by_y), jnp.where(is_x, by_y, by_x)])
    after = position + moves
    is_clear = jax.vmap(functools.partial(_is_clear, grid, position))(after)
    # The field must rise too: a step over the top of a maximum would lead back and forth.
    is_allowed = is_clear & (jax.vmap(field)(after) > field(position)) & (scale > 0.0)
    result: Array = jnp.where(is_allowed.any(), after[jnp.argmax(is_allowed)], position)
    return result


def _rotate(x: Scalar, y: Scalar, yaw: Scalar) -> Position:
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)
    return jnp.stack([cos * x - sin * y, sin * x + cos * y])


def _is_clear(grid: OccupancyGrid, before: Position, after: Position) -> Flag:
    """Return whether a step of at most half a cell keeps out of cells known to be occupied.

    A diagonal step passes one of the two cells between. Both must be clear.
    """
    (row, column), (next_row, next_column) = (
        grid.frame.to_cell(position) for position in (before, after)
    )
    rows = jnp.stack([row, next_row, row, next_row])
    columns = jnp.stack([column, next_column, next_column, column])
    cells = jnp.stack([rows, columns], axis=-1)
    return jnp.all(grid.at_cell(cells) <= OCCUPIED_THRESHOLD)
