"""Descent of a cost-to-go in a volume, as a reference of positions."""

import itertools
import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._limits import MOST_STEPS_AHEAD
from jaxplore._types import ArrayLike, Scalar
from jaxplore.maps.volume_field import VolumeField

FLAT = 1e-4
"""Slope below which a cost-to-go counts as flat [m/m]: along a path it is 1 or more."""


class VolumeReference(eqx.Module):
    """Descent of a cost-to-go in a volume at constant speed:

        x_{t+1} = x_t - speed dt g(x_t) / |g(x_t)|

    with g the central differences of the interpolated field over a node spacing. A step is allowed
    if the cost falls and the clearance is at least the needed one, or no less than before where the
    robot is closer to a wall already. Where the step down the gradient is not allowed, the
    reference slides: it takes the one of 26 directions, those to the neighbours on a lattice, in
    which the cost falls most. It stands still where the field is flat, at a minimum, off the field,
    and where no step is allowed. Steps longer than half a voxel are divided, so that no wall is
    stepped over.

    Source: `GradientReference`, the same in the plane.

    Args:
        speed: speed of the reference [m/s].
        num_steps: number of positions, T; static.
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
        self.num_steps = _checks.positive_int("num_steps", num_steps, at_most=MOST_STEPS_AHEAD)

    def __call__(
        self,
        guidance: VolumeField,
        clearance: VolumeField,
        required: Scalar,
        start: Float[Array, "3"],
    ) -> Float[Array, "T 3"]:
        """Compute the positions (x, y, z) after 1 ...

        T steps [m], z up, that descend a cost-to-go [m] and keep the clearance that the robot needs
        from voxels that are not known to be free [m].
        """
        length = self.speed * self.dt
        pieces = jnp.maximum(jnp.ceil(length / (0.5 * clearance.spacing)), 1.0)

        def piece(_: Array, position: Array) -> Array:
            return _descend(guidance, clearance, required, position, length / pieces)

        def step(position: Array, _: None) -> tuple[Array, Array]:
            after = jax.lax.fori_loop(0, pieces.astype(jnp.int32), piece, position)
            return after, after

        path: Array
        _, path = jax.lax.scan(step, start, length=self.num_steps)
        return path


def _descend(
    guidance: VolumeField,
    clearance: VolumeField,
    required: Scalar,
    position: Float[Array, "3"],
    length: Scalar,
) -> Float[Array, "3"]:
    """Take one short step down the field; stand still where none is allowed."""
    cost: Callable[[Array], Array] = jax.vmap(guidance)
    room: Callable[[Array], Array] = jax.vmap(clearance)
    half = 0.5 * guidance.spacing * jnp.eye(3)
    beside = cost(position + jnp.concatenate([half, -half]))
    slope = (beside[:3] - beside[3:]) / guidance.spacing
    steep = jnp.sqrt(jnp.sum(slope * slope))
    is_steep = steep > FLAT
    down = -slope * jnp.where(is_steep, 1.0 / jnp.where(is_steep, steep, 1.0), 0.0)
    after = position + length * jnp.concatenate([down[None], _DIRECTIONS])
    # The first row is where the robot is: all at once is one program.
    places = jnp.concatenate([position[None], after])
    costs, rooms = cost(places), room(places)
    is_allowed = (costs[1:] < costs[0]) & (rooms[1:] >= jnp.minimum(required, rooms[0]))
    best = jnp.argmin(jnp.where(is_allowed, costs[1:], jnp.inf))
    best = jnp.where(is_allowed[0] & is_steep, 0, best)
    return jnp.where(is_allowed.any(), after[best], position)


_DIRECTIONS = np.asarray(
    [
        [each / math.hypot(*move) for each in move]
        for move in itertools.product((-1, 0, 1), repeat=3)
        if any(move)
    ],
    np.float32,
)
"""Unit vectors (26, 3) to the neighbours on a lattice."""
