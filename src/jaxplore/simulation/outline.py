"""Corners of a robot's footprint for recordings."""

import numpy as np

from jaxplore.geometry.footprint import Footprint, Rectangle


def footprint_corners(footprint: Footprint) -> np.ndarray:
    """Return the corners (4, 2) of a rectangle in the robot's frame [m]; (0, 2) otherwise."""
    if not isinstance(footprint, Rectangle):
        return np.zeros((0, 2))
    front, rear, half = (
        float(footprint.front),
        -float(footprint.rear),
        0.5 * float(footprint.width),
    )
    return np.array([[front, half], [rear, half], [rear, -half], [front, -half]])
