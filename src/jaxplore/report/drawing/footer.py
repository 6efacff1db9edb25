"""The footer of an animation: fonts, the legend, a curve over time."""

from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jaxplore.report.drawing.palette import (
    HIDDEN_WALL,
    INK,
    PALE,
    PAPER,
    TRAIL,
    Colour,
)
from jaxplore.report.drawing.picture import FOOTER, SUPERSAMPLING, pairs

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont

LEGEND, COLUMN, CURVE, LEAST_CURVE = 190, 108, 190, 120
"""Left end of the legend, width of its columns, width of the curve beside it, and least width
that leaves room for the legend [pixels]."""


def fonts() -> tuple[Font, Font]:
    """Return the large and the small font."""
    return ImageFont.load_default(size=21), ImageFont.load_default(size=13)


def draw_legend(image: Image.Image, entries: Sequence[tuple[str, Colour]]) -> int:
    """Draw a legend into the middle of a wide enough footer; return its right end [pixels].

    Args:
        image: picture of the whole frame.
        entries: names and colours, at most nine.
    """
    # Two lines of three; with more entries the lines move closer together.
    lines, above, apart = (2, 20, 30) if len(entries) <= 6 else (3, 11, 23)
    end = LEGEND + COLUMN * -(-len(entries) // lines)
    # In a narrow picture the curve takes the place of the legend.
    if image.width - end < LEAST_CURVE:
        return LEGEND - 22
    draw, (_, small) = ImageDraw.Draw(image), fonts()
    top = image.height - FOOTER
    for index, (name, colour) in enumerate(entries):
        x, y = LEGEND + COLUMN * (index // lines), top + above + apart * (index % lines)
        draw.rounded_rectangle((x, y + 2, x + 16, y + 11), 3, colour)
        draw.text((x + 22, y - 1), name, INK, small)
    return end


def draw_curve(
    image: Image.Image,
    time: np.ndarray,
    shares: np.ndarray,
    step: int,
    *,
    left: int,
    level: float | None = None,
) -> None:
    """Draw a curve up to the present time into the lower right corner.

    Args:
        image: picture of the whole frame.
        time: (N,) times of the whole run [s].
        shares: (N,) heights of the curve, from 0 to 1.
        step: index of the present time.
        left: column from which the strip is free [pixels].
        level: share that a horizontal line marks; none when absent.
    """
    width = min(CURVE, image.width - 12 - left)
    height = FOOTER - 24
    # Pillow draws lines without smoothing, so they are drawn larger and reduced.
    factor = 2 * SUPERSAMPLING
    box = Image.new("RGB", (width * factor, height * factor), PAPER)
    draw = ImageDraw.Draw(box)
    # A run without a step has no duration to divide by.
    duration = float(time[-1]) or 1.0

    def spots(seconds: np.ndarray, share: np.ndarray) -> list[tuple[float, float]]:
        x = 4 + (width - 8) * seconds / duration
        y = height - 4 - (height - 8) * share
        return pairs(np.stack([x, y], axis=-1) * factor)

    ends = np.array([0.0, duration])
    draw.line(spots(ends, np.zeros(2)), PALE, factor)
    if level is not None:
        draw.line(spots(ends, np.full(2, level)), HIDDEN_WALL, factor)
    # More than a few points per column of pixels cannot be seen.
    kept = np.unique(np.linspace(0, step, min(step + 1, 4 * width)).round().astype(int))
    curve = spots(time[kept], shares[kept])
    if len(curve) > 1:
        draw.line(curve, TRAIL, 2 * factor, "curve")
    x, y = curve[-1]
    draw.ellipse((x - 3 * factor, y - 3 * factor, x + 3 * factor, y + 3 * factor), TRAIL)
    image.paste(box.reduce(factor), (image.width - width - 12, image.height - FOOTER + 12))
