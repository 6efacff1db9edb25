"""Ways of a car that drives in one direction: a circle, a straight piece and a circle."""

import math

import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

ROUNDING = 1e-3
"""An angle so little below a whole turn is none: in single precision it may be rounded [rad]."""


def find_ways(
    x: Float[Array, "*N"], y: Float[Array, "*N"], turn: Float[Array, "*N"]
) -> tuple[Float[Array, "2 *N"], Float[Array, "3 *N"]]:
    """Return the shortest ways to poses: the sides of their circles, and the lengths of the pieces.

    A side is 1 for a circle on the left and -1 for one on the right. All lengths are in turning
    radii. A pose is x ahead of the car and y on its left, and `turn` is its heading relative to
    that of the car [rad]. The ways of three circles are left out: they are shorter only to poses
    within four radii, and turn by more than half a circle.

    Source: Dubins, "On curves of minimal length with a constraint on average curvature, and with
    prescribed initial and terminal positions and tangents", American Journal of Mathematics 1957.
    """
    ways = []
    for side in (1.0, -1.0):
        # Mirrored ways lead to mirrored poses.
        up, angle = side * y, side * turn
        sin, cos = jnp.sin(angle), jnp.cos(angle)
        # Both circles are on one side.
        ahead, beside = x - sin, up - 1.0 + cos
        straight = jnp.hypot(ahead, beside)
        # A straight piece without a length has no direction, and needs no circle before it.
        first = jnp.where(straight < ROUNDING, 0.0, _whole(jnp.arctan2(beside, ahead)))
        ways.append((side, side, first, straight, _whole(angle - first)))
        # They are on different sides, and do not overlap.
        ahead, beside = x + sin, up - 1.0 - cos
        squared = ahead**2 + beside**2 - 4.0
        straight = jnp.sqrt(jnp.maximum(squared, 0.0))
        first = _whole(jnp.arctan2(beside, ahead) + jnp.arctan2(2.0, straight))
        last = jnp.where(squared >= 0.0, _whole(first - angle), jnp.inf)
        ways.append((side, -side, first, straight, last))
    pieces = jnp.stack([jnp.stack(each[2:]) for each in ways])
    best = jnp.argmin(pieces.sum(axis=1), axis=0)
    sides = jnp.moveaxis(jnp.asarray([each[:2] for each in ways])[best], -1, 0)
    return sides, jnp.take_along_axis(pieces, best[None, None], axis=0)[0]


def place_on(
    sides: Float[Array, "2 *N"], pieces: Float[Array, "3 *N"], along: Array
) -> tuple[Array, Array, Array]:
    """Return the pose (x, y, turn) on ways after a length `along`; see `find_ways`."""
    first = jnp.minimum(along, pieces[0])
    straight = jnp.clip(along - pieces[0], 0.0, pieces[1])
    last = jnp.clip(along - pieces[0] - pieces[1], 0.0, pieces[2])
    before = sides[0] * first
    turn = before + sides[1] * last
    sin, cos = jnp.sin(before), jnp.cos(before)
    x = sides[0] * sin + straight * cos + sides[1] * (jnp.sin(turn) - sin)
    y = sides[0] * (1.0 - cos) + straight * sin - sides[1] * (jnp.cos(turn) - cos)
    return x, y, turn


def _whole(angle: Array) -> Array:
    """Return an angle as a way ahead, in [0, 2 pi)."""
    turned = jnp.mod(angle, math.tau)
    return jnp.where(turned > math.tau - ROUNDING, 0.0, turned)
