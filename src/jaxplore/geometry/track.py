"""Generate random closed race tracks."""

import numpy as np

from jaxplore import _checks
from jaxplore._limits import MOST_BENDS
from jaxplore.geometry.curves import path_through
from jaxplore.geometry.path import Path

MAX_ATTEMPTS = 40
"""Attempts with ever smaller bends before the track is refused as too wide for its length."""


def race_track(
    seed: int = 0,
    length: float = 60.0,
    half_width: float = 1.1,
    min_radius: float = 1.5,
    num_bends: int = 6,
) -> Path:
    """Generate a closed track with random bends, by default of F1TENTH's size.

        r(angle) = 1 + flat * sum_k a_k cos(k angle + p_k),  k = 2 ... num_bends

    in polar coordinates around (0, 0), with random a_k and p_k, scaled to the given length. The
    factor `flat` is reduced until no bend is too tight and no two stretches of the track overlap.
    The track starts where its curvature is smallest.

    Args:
        seed: seed of the shape; equal seeds give equal tracks.
        length: length of the centre line [m].
        half_width: free width on either side of the centre line [m].
        min_radius: smallest radius of curvature of the centre line [m]; at least the half width.
        num_bends: highest frequency of the shape; a greater number gives a more winding track.

    Raises:
        ValueError: a negative seed, numbers that are not positive, a minimum radius below the half
            width, a track that would be too wide for its length.
    """
    total = _checks.number("length", length, above=0.0)
    side = _checks.number("half_width", half_width, above=0.0)
    tightest = _checks.number("min_radius", min_radius, at_least=side)
    bends = _checks.whole_number("num_bends", num_bends, at_least=2, at_most=MOST_BENDS)
    rng = np.random.default_rng(_checks.whole_number("seed", seed, at_least=0))
    waves = np.arange(2, bends + 1)
    # Amplitudes fall with the frequency, whose square the curvature grows with.
    sizes = rng.uniform(0.3, 1.0, len(waves)) / waves
    phases = rng.uniform(0.0, 2.0 * np.pi, len(waves))
    # With 40 corners per shortest wave, the spline bends little more between corners than at them.
    angles = np.linspace(0.0, 2.0 * np.pi, 40 * bends, endpoint=False)
    wave = (sizes * np.cos(np.outer(angles, waves) + phases)).sum(axis=1)
    # |wave| <= 1 and flat < 1 keep the radius positive.
    wave /= np.abs(wave).max()
    for flat in 0.75 * 0.93 ** np.arange(MAX_ATTEMPTS):
        radius = 1.0 + flat * wave
        ring = np.stack([radius * np.cos(angles), radius * np.sin(angles)], axis=-1)
        ring *= total / np.hypot(*(np.roll(ring, -1, axis=0) - ring).T).sum()
        bend = np.abs(_curvatures(ring))
        if bend.max() <= 1.0 / tightest and _is_apart(ring, 2.0 * side, total):
            start = int(np.argmin(bend))
            ring = np.roll(ring, -start, axis=0)
            return path_through(ring, is_closed=True, half_widths=[side, side])
    raise ValueError(
        f"half_width is {side:g} m and min_radius {tightest:g} m; accepted: less, or a greater "
        f"length than {total:g} m"
    )


def _curvatures(ring: np.ndarray) -> np.ndarray:
    """Return the curvature (N,) at each corner of a closed polygon [1/m]: that of the circle
    through the corner and its two neighbours (Menger curvature)."""
    before, after = ring - np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0) - ring
    cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
    sides = np.hypot(*before.T) * np.hypot(*after.T) * np.hypot(*(before + after).T)
    return np.asarray(2.0 * cross / sides)


def _is_apart(ring: np.ndarray, gap: float, total: float) -> bool:
    """Return whether stretches that are not neighbours along the track are more than `gap` apart.

    Points nearer than a half circle of the gap's diameter along the track count as neighbours.
    """
    from scipy.spatial import KDTree  # slow to import, and few need it

    along = np.arange(len(ring)) * (total / len(ring))
    near = KDTree(ring).query_pairs(1.1 * gap, output_type="ndarray")
    way = np.abs(along[near[:, 0]] - along[near[:, 1]])
    return bool((np.minimum(way, total - way) < 0.5 * np.pi * 1.1 * gap).all())
