"""The footer of an animation: numbers, a scale bar, a curve over time and the legend."""

import dataclasses
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from jaxplore.report.drawing.palette import INK, LEVEL, PALE, PAPER, TRAIL, Colour
from jaxplore.report.drawing.picture import MIN_WIDTH, SUPERSAMPLING, pairs, round_length
from jaxplore.report.drawing.shapes import draw_found, draw_star

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont
Sign = Literal["area", "line", "dashes", "bar", "disc", "cross", "star", "found"]

STRIP, LINE, COLUMN, EDGE = 100, 21, 112, 16
"""Height of the strip of numbers, height of a line and width of a column of the legend, and margin
at the left and right [pixels of scale 1]."""
CURVE_LEFT = 196
"""Left end of the curve [pixels of scale 1]."""
BAR_TOP, LONGEST_BAR = 82, 90
"""Place and greatest length of the scale bar [pixels of scale 1]."""


def fonts(scale: float) -> tuple[Font, Font]:
    """Return the large and the small font of a picture's scale."""
    return ImageFont.load_default(size=21 * scale), ImageFont.load_default(size=13 * scale)


class Entry(NamedTuple):
    """An entry of the legend: what is drawn, in which colour and in which shape.

    `edge` is the colour of the edge of a disc; None draws no edge.
    """

    name: str
    colour: Colour
    sign: Sign = "area"
    edge: Colour | None = None


def footer_height(width: float, num_entries: int) -> int:
    """Return the height of a footer of some width [pixels of scale 1]."""
    return STRIP + LINE * -(-num_entries // _columns(width)) + 6


def _columns(width: float) -> int:
    return max(1, int((width - 2 * EDGE) // COLUMN))


@dataclasses.dataclass(frozen=True)
class _Signs:
    """The surface of the legend's signs, which are drawn larger and reduced."""

    unit: float
    scale: float = 1.0

    def pixels(self, points: np.ndarray) -> np.ndarray:
        return points


class Footer:
    """A picture with a footer, which is drawn in pixels of scale 1 from its upper left corner."""

    def __init__(self, ground: Image.Image, scale: float, entries: Sequence[Entry]) -> None:
        """Make the picture of a supersampled ground with room for the footer below it."""
        columns, self.top = (side // SUPERSAMPLING for side in ground.size)
        width = max(round(MIN_WIDTH * scale), columns)
        self.scale, self.entries, self.width = scale, entries, width / scale
        height = round(footer_height(self.width, len(entries)) * scale)
        self.image = Image.new("RGB", (width, self.top + height), PAPER)
        self.image.paste(ground.reduce(SUPERSAMPLING), ((width - columns) // 2, 0))
        self.draw, self.fonts = ImageDraw.Draw(self.image), fonts(scale)

    def text(
        self,
        x: int | float,
        y: int | float,
        words: str,
        colour: Colour = INK,
        *,
        large: bool = False,
    ) -> float:
        """Write words; return their right end."""
        font = self.fonts[0 if large else 1]
        self.draw.text((x * self.scale, self.top + y * self.scale), words, colour, font)
        return x + self.draw.textlength(words, font) / self.scale

    def headline(self, number: str, name: str) -> None:
        """Write the main number large, and its name."""
        end = self.text(EDGE, 8, number, large=True)
        self.text(end + 8, 14, name, PALE)

    def scale_bar(self, pixels_per_metre: float) -> None:
        """Draw a bar of a round length, given the picture's pixels per metre of the map."""
        length = round_length(LONGEST_BAR * self.scale / pixels_per_metre)
        left, right = EDGE * self.scale, EDGE * self.scale + length * pixels_per_metre
        y, tick, thick = self.top + BAR_TOP * self.scale, 4 * self.scale, round(2 * self.scale)
        self.draw.line([(left, y), (right, y)], INK, thick)
        for x in (left, right):
            self.draw.line([(x, y - tick), (x, y + tick)], INK, thick)
        self.text(right / self.scale + 8, BAR_TOP - 8, f"{length:g} m")

    def legend(self) -> None:
        """Draw the legend below the strip, all of its entries."""
        columns = _columns(self.width)
        factor = 2 * SUPERSAMPLING
        size = (round(26 * self.scale), round(18 * self.scale))
        for index, entry in enumerate(self.entries):
            x, y = EDGE + COLUMN * (index % columns), STRIP + LINE * (index // columns)
            sign = Image.new("RGB", (size[0] * factor, size[1] * factor), PAPER)
            _draw_sign(ImageDraw.Draw(sign), _Signs(factor * self.scale), entry)
            self.image.paste(
                sign.reduce(factor), (round((x - 2) * self.scale), self.top + round(y * self.scale))
            )
            self.text(x + 27, y + 1, entry.name)

    def curve(
        self, time: np.ndarray, shares: np.ndarray, step: int, *, level: float | None = None
    ) -> None:
        """Draw a curve up to the present time, right of the numbers.

        `time` (N,) covers the whole run [s], and `step` is the index of the present time. The
        shares (N,) are heights from 0 to 1. A horizontal line marks a level; None draws none.
        """
        across, height = self.width - EDGE - CURVE_LEFT, STRIP - 22
        # Pillow draws lines without smoothing, so they are drawn larger and reduced.
        factor = 2 * SUPERSAMPLING
        size = (round(across * self.scale), round(height * self.scale))
        box = Image.new("RGB", (size[0] * factor, size[1] * factor), PAPER)
        draw, unit = ImageDraw.Draw(box), factor * self.scale
        # A run without a step has no duration to divide by.
        duration = float(time[-1]) or 1.0

        def spots(seconds: np.ndarray, share: np.ndarray) -> list[tuple[float, float]]:
            x = 4 + (across - 8) * seconds / duration
            y = height - 4 - (height - 8) * share
            return pairs(np.stack([x, y], axis=-1) * unit)

        ends = np.array([0.0, duration])
        draw.line(spots(ends, np.zeros(2)), PALE, round(unit))
        if level is not None:
            draw.line(spots(ends, np.full(2, level)), LEVEL, round(unit))
        # More than a few points per column of pixels cannot be seen.
        most = int(4 * across * self.scale)
        kept = np.unique(np.linspace(0, step, min(step + 1, most)).round().astype(int))
        curve = spots(time[kept], shares[kept])
        if len(curve) > 1:
            draw.line(curve, TRAIL, round(2 * unit), "curve")
        (x, y), reach = curve[-1], 3 * unit
        draw.ellipse((x - reach, y - reach, x + reach, y + reach), TRAIL)
        place = (round(CURVE_LEFT * self.scale), self.top + round(12 * self.scale))
        self.image.paste(box.reduce(factor), place)


def _draw_sign(draw: ImageDraw.ImageDraw, signs: _Signs, entry: Entry) -> None:
    """Draw the sign of an entry into a box of 26 by 18 pixels of scale 1."""
    unit = signs.unit
    middle, colour = np.array([12.0, 9.0]) * unit, entry.colour
    left, right = (2 * unit, 9 * unit), (22 * unit, 9 * unit)
    if entry.sign == "star":
        draw_star(signs, draw, middle, colour)
    elif entry.sign == "found":
        draw_found(signs, draw, middle, colour)
    elif entry.sign == "disc":
        x, y = middle.tolist()
        reach = 6.5 * unit
        box = (x - reach, y - reach, x + reach, y + reach)
        draw.ellipse(box, colour, entry.edge, round(1.5 * unit) if entry.edge else 1)
    elif entry.sign == "cross":
        for arm in (np.array([5.0, 5.0]), np.array([5.0, -5.0])):
            draw.line(pairs(np.stack([middle - arm * unit, middle + arm * unit])), colour,
                      round(2.5 * unit))  # fmt: skip
    elif entry.sign == "dashes":
        for start in (2, 9, 16):
            draw.line([(start * unit, 9 * unit), ((start + 5) * unit, 9 * unit)], colour,
                      round(2 * unit))  # fmt: skip
    elif entry.sign in ("line", "bar"):
        draw.line([left, right], colour, round((2 if entry.sign == "line" else 4) * unit))
    else:
        draw.rounded_rectangle((3 * unit, 4 * unit, 21 * unit, 14 * unit), 3 * unit, colour)
