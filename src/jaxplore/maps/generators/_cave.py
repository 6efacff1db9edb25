"""Generate caves, for `generate_map`."""

import math

import numpy as np
from numpy.typing import NDArray

from jaxplore.maps.generators._clutter import Mask, interpolate, wall_cells, widest_part

_LATTICE = 0.25
"""Node spacing of the noise [m]; it is fixed so that a seed gives one cave at any resolution."""
_STEPS = 8
"""Bisection steps for the level of the noise."""


def cave(rng: np.random.Generator, occupied: Mask, difficulty: float, resolution: float) -> None:
    """Carve a cave where smooth noise exceeds a level, with passages as wide as the robot needs."""
    from scipy import ndimage  # slow to import, and few need it

    rise = _noise(rng, occupied.shape, interpolate(1.3, 0.7, difficulty), resolution)
    wall = wall_cells(resolution)
    inner = np.pad(np.ones(np.subtract(occupied.shape, 2 * wall), bool), wall)
    # Lower the noise towards the edge of the map, so that the cave does not end in straight walls.
    rim = ndimage.distance_transform_edt(inner) * resolution
    rise -= 2.5 * np.exp(-rim / 0.9)
    radius = interpolate(0.75, 0.45, difficulty)
    wanted = interpolate(0.6, 0.45, difficulty) * occupied.size
    # Bisect for the least share of open noise whose connected part has the wanted area.
    low, high = 0.3, 0.95
    best, was_enough = np.zeros_like(occupied), False
    for _ in range(_STEPS):
        share = (low + high) / 2
        part = widest_part(inner & (rise > np.quantile(rise, 1.0 - share)), radius, resolution)
        is_enough = bool(np.count_nonzero(part) >= wanted)
        # If no share is enough, the greatest one is taken.
        if is_enough or not was_enough:
            best = part
        was_enough |= is_enough
        low, high = (low, share) if is_enough else (share, high)
    occupied[:] = ~best


def _noise(
    rng: np.random.Generator, shape: tuple[int, ...], length: float, resolution: float
) -> NDArray[np.float64]:
    """Return smooth noise on the cells of a map: coarse with unit variance plus 0.3 of finer."""
    from scipy import ndimage  # slow to import, and few need it

    lattice = [math.ceil(side * resolution / _LATTICE) for side in shape]
    noise = np.zeros(lattice)
    for scale, weight in ((length, 1.0), (0.35 * length, 0.3)):
        part = ndimage.gaussian_filter(rng.standard_normal(lattice), scale / _LATTICE)
        noise += weight * part / part.std()
    zoomed: NDArray[np.float64] = ndimage.zoom(
        noise, np.divide(shape, lattice).tolist(), order=1, mode="nearest", grid_mode=True
    )
    return zoomed
