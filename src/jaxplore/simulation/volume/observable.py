"""What of a volume can be seen at all: from the places where the robot fits, with its sensors."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import Scalar
from jaxplore.information.voxel_table import band

SECTORS = 48
"""Directions around the vertical axis."""
ELEVATIONS = 12
"""Directions of each sector, one above the other."""


def room_around(solid: np.ndarray) -> np.ndarray:
    """Return the radius (D, H, W) of a ball that fits around the centre of each voxel [voxels].

    It is at most half a voxel too small. All beyond the volume is solid.
    """
    # Slow to import, and only needed here.
    from scipy import ndimage

    # From the centre of the nearest solid voxel to its face is half a voxel at least.
    room = ndimage.distance_transform_edt(np.pad(~solid, 1))[1:-1, 1:-1, 1:-1] - 0.5
    return np.asarray(room)


def find_fitting_places(solid: np.ndarray, start: np.ndarray, radius: float) -> np.ndarray:
    """Return the voxels (D, H, W) at whose centre a ball fits, connected with the start.

    The start (z, y, x) and the radius are in voxels. All beyond the volume is solid.
    """
    # Slow to import, and only needed here.
    from scipy import ndimage

    labels, _ = ndimage.label(room_around(solid) >= radius, structure=np.ones((3, 3, 3)))
    # The start fits exactly, though perhaps not at the centre of its own voxel.
    own = np.floor(start).astype(int)
    low, high = np.maximum(own - 2, 0), own + 3
    near = labels[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
    offsets = np.argwhere(near) + low
    if not len(offsets):
        alone = np.zeros(solid.shape, bool)
        alone[tuple(own)] = True
        return alone
    nearest = offsets[np.argmin(np.linalg.norm(offsets + 0.5 - start, axis=1))]
    return np.asarray(labels == labels[tuple(nearest)])


def observable(
    solid: np.ndarray, places: np.ndarray, views: list[tuple[float, float, float]]
) -> np.ndarray:
    """Return the free voxels (D, H, W) that can be seen from some place.

    In each direction, all lines of sight are followed together, plane by plane across the axis
    along which they are steepest: with R the range that is left,

        R(n + 1, p + d_n) = max( R(n, p) - step, range at a place )   in free voxels

    where d_n is the rounded shift from one plane to the next. A line that passes between two voxels
    at a corner is blocked if both are solid. So a voxel counts if any of the directions shows it.

    `places` are the voxels in which a sensor can be. `views` has for each sensor its range
    [voxels], and the elevations of the lower and the upper edge of its view [rad].
    """
    seen = np.zeros(solid.shape, bool)
    free = jnp.asarray(~solid)
    for reach, lowest, highest in views:
        ways, _ = band(SECTORS, ELEVATIONS, lowest, highest)
        ways = ways[::-1].T
        steepest = np.abs(ways).argmax(axis=1)
        for axis in range(3):
            for sign in (1.0, -1.0):
                along = ways[(steepest == axis) & (np.sign(ways[:, axis]) == sign)]
                if not len(along):
                    continue
                step, shift = _steps(along, axis, solid.shape[axis])
                turned = [jnp.moveaxis(each, axis, 0) for each in (free, jnp.asarray(places))]
                if sign < 0.0:
                    turned = [each[::-1] for each in turned]
                found = _see_along(
                    *turned, jnp.asarray(shift), jnp.asarray(step), jnp.float32(reach)
                )
                found = jnp.moveaxis(found[::-1] if sign < 0.0 else found, 0, axis)
                seen |= np.asarray(found)
    return seen


def _steps(ways: np.ndarray, axis: int, planes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the length of a step between two planes for each direction (n,), and the shifts
    (n, planes, 2) of its lines to each plane from the one before it."""
    across = np.delete(ways, axis, axis=1) / np.abs(ways[:, axis, None])
    step = np.sqrt(1.0 + (across**2).sum(axis=1))
    places = np.round(np.arange(planes)[None, :, None] * across[:, None, :])
    return step.astype(np.float32), np.diff(places, axis=1, prepend=0.0).astype(np.int32)


@jax.jit
def _see_along(
    free: Bool[Array, "N h w"],
    places: Bool[Array, "N h w"],
    shifts: Int[Array, "n N 2"],
    steps: Float[Array, " n"],
    reach: Scalar,
) -> Bool[Array, "N h w"]:
    """Return the free voxels seen along lines that rise along the first axis."""

    def shift_by(values: Array, by: Array, fill: float | bool) -> Array:
        wide = jnp.pad(values, 1, constant_values=fill)
        return jax.lax.dynamic_slice(wide, [1 - by[0], 1 - by[1]], values.shape)

    def along(seen: Array, given: tuple[Array, Array]) -> tuple[Array, None]:
        shift, step = given

        def plane(
            before: tuple[Array, Array], now: tuple[Array, Array, Array]
        ) -> tuple[tuple[Array, Array], Array]:
            (left, was_free), (is_free, is_place, by) = before, now
            # Between two planes a line passes beside the voxel ahead of the old one, or beside the
            # one before the new one: it is blocked if both are solid.
            passes = shift_by(is_free, by, False) | was_free
            left = jnp.where(passes, shift_by(left, by, -math.inf) - step, -math.inf)
            left = jnp.where(is_place, reach, left)
            left = jnp.where(is_free & (left >= 0.0), left, -math.inf)
            return (left, is_free), left >= 0.0

        nothing = jnp.full(free.shape[1:], -math.inf), jnp.zeros(free.shape[1:], bool)
        _, found = jax.lax.scan(plane, nothing, (free, places, shift))
        return seen | found, None

    seen, _ = jax.lax.scan(along, jnp.zeros(free.shape, bool), (shifts, steps))
    return seen
