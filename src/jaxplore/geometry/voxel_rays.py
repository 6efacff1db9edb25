"""Traverse voxels along rays exactly: no step size, and no voxel is missed.

A ray leaves every voxel through a plane of one of three families. The n-th crossing with the planes
of one family has a closed form, so distances do not add up rounding from voxel to voxel. All rays
take their next voxel together.

Source: Amanatides and Woo, "A fast voxel traversal algorithm for ray tracing", Eurographics 1987.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float, Int

from jaxplore.geometry.rays import FAR, TOUCH


class VoxelStep(NamedTuple):
    """The voxel that each of R rays is in.

    Args:
        voxel: (3, R) voxel, along the axes of the grid.
        entry: (R,) distance from the start at which the ray enters it [voxels].
        exit: (R,) distance at which it leaves it [voxels].
        is_crossed: (R,) False if the ray only touches an edge or a corner of the voxel, and where
            the ray has ended.
    """

    voxel: Int[Array, "3 R"]
    entry: Float[Array, " R"]
    exit: Float[Array, " R"]
    is_crossed: Bool[Array, " R"]


def walk[Carry](
    start: Float[Array, "3 R"],
    direction: Float[Array, "3 R"],
    length: Float[Array, " R"],
    visit: Callable[[Carry, VoxelStep], tuple[Carry, Bool[Array, " R"]]],
    carry: Carry,
) -> Carry:
    """Visit the voxels of R rays one after another, all rays in step; return what is carried.

    Starts are in grid coordinates [voxels], and directions are unit vectors along the axes of the
    grid. A ray without a finite direction is not walked. Voxels that are entered within `length`
    [voxels] are visited.

    `visit` takes what was carried so far and the voxels. It returns what is carried on, and which
    rays go on. It is also called for rays that have ended, with `is_crossed` False.
    """
    is_finite = jnp.all(jnp.isfinite(start) & jnp.isfinite(direction), axis=0)
    # Converting NaN to an integer is undefined.
    base = jnp.floor(jnp.where(is_finite, start, 0.0))
    # Work relative to the first voxel, so that distances stay exact far from the grid's corner.
    fraction = start - base
    moves = jnp.abs(direction) > 1e-9
    spacing = jnp.where(moves, 1.0 / jnp.where(moves, jnp.abs(direction), 1.0), FAR)
    to_first = jnp.where(direction > 0, 1.0 - fraction, fraction)
    sign = jnp.where(moves, jnp.sign(direction), 0.0).astype(jnp.int32)
    first, axes = base.astype(jnp.int32), jnp.arange(3)[:, None]
    goes_on = is_finite & (length >= 0.0)

    def step(
        state: tuple[Array, Array, Array, Carry],
    ) -> tuple[Array, Array, Array, Carry]:
        count, entry, goes_on, carried = state
        planes = jnp.where(moves, (to_first + count.astype(start.dtype)) * spacing, FAR)
        through = jnp.argmin(planes, axis=0)
        exit_ = jnp.min(planes, axis=0)
        here = VoxelStep(first + sign * count, entry, exit_, goes_on & (exit_ - entry > TOUCH))
        carried, wanted = visit(carried, here)
        count = count + (axes == through).astype(jnp.int32)
        return count, exit_, goes_on & wanted & (exit_ <= length), carried

    state = (jnp.zeros(direction.shape, jnp.int32), jnp.zeros_like(length), goes_on, carry)
    *_, carried = jax.lax.while_loop(lambda each: jnp.any(each[2]), step, state)
    return carried
