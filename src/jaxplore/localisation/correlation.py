"""Blur of walls, by which grids of two maps are correlated; host code."""

import numpy as np
from numpy.typing import NDArray

BLUR, WIDEST_BLUR = 0.7, 5
"""Standard deviation and greatest reach of the blur of walls [cells]."""
Grid = NDArray[np.float32]


def blur_walls(walls: Grid) -> Grid:
    """Return values of walls (..., H, W) that fade to the sides; a wall in one cell keeps its own.

    Cells of walls side by side become greater than one alone.
    """
    from scipy.ndimage import gaussian_filter  # slow to import, and few need it

    alone = np.zeros((2 * WIDEST_BLUR + 1,) * 2, np.float32)
    alone[WIDEST_BLUR, WIDEST_BLUR] = 1.0
    greatest = float(gaussian_filter(alone, BLUR).max())
    stds = (0.0,) * (walls.ndim - 2) + (BLUR, BLUR)
    blurred: Grid = gaussian_filter(walls, stds) / greatest
    return blurred
