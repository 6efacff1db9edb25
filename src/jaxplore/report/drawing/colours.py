"""Colours of the figures and animations."""

import numpy as np

FREE, UNKNOWN, OCCUPIED = (252, 252, 250), (190, 195, 203), (43, 48, 58)
"""Colours of occupancy probabilities of 0, 1/2 and 1."""
MISSED = (209, 73, 91)
"""Colour of a true wall that is missing in the belief."""
OUTLINE = "#4f8fc0"
"""Colour of the outline of the true free space."""
CLOSED, CLOSED_SHARE = (112, 68, 30), 0.5
"""Colour of untraversable ground, and its opacity over the belief."""
TARGET = (91, 42, 134)
"""Colour of targets."""
ALARM = (190, 24, 93)
"""Colour of anomalies."""
MOVER, MOVER_EDGE = (43, 48, 58), (250, 204, 21)
"""Colours of a moving obstacle and of its edge."""
SERIES = ("#1c64be", "#d1495b", "#2b5625", "#b5651d", "#7d5690", "#3f334e")
"""Colours of several curves in a figure, in turn."""


def belief_colours() -> np.ndarray:
    """Return the colours (256, 3) of a belief in 256 levels, from free to occupied."""
    level = np.linspace(0.0, 1.0, 256)
    nodes = np.array([FREE, UNKNOWN, OCCUPIED], np.float64)
    channels = [np.interp(level, [0.0, 0.5, 1.0], nodes[:, channel]) for channel in range(3)]
    return np.round(np.stack(channels, axis=-1)).astype(np.uint8)


def blend(colour: tuple[int, ...], ground: tuple[int, ...], share: float) -> tuple[int, int, int]:
    """Blend a share of one colour over another; only red, green and blue are used."""
    red, green, blue = (
        round(share * over + (1.0 - share) * under)
        for over, under in zip(colour[:3], ground, strict=True)
    )
    return red, green, blue


def shade(colour: tuple[int, int, int]) -> tuple[float, float, float]:
    """Convert a colour from 256 levels to matplotlib's range [0, 1]."""
    red, green, blue = (level / 255.0 for level in colour)
    return red, green, blue
