"""Palettes of animations."""

from collections.abc import Sequence

from PIL import Image

Colour = tuple[int, int, int] | tuple[int, int, int, int]

NUM_COLOURS = 64
HEAT_LEVELS, MAX_HEAT = 6, 0.75
"""Number of levels of the information's colour, few for a small file, and its opacity."""

PAPER, INK, PALE = (255, 255, 255), (43, 48, 58), (125, 132, 143)
HIDDEN_WALL = (112, 119, 131)
"""Colour of a true wall that the robot has not seen."""
LEVEL = (172, 178, 188)
"""Colour of a level that a curve shall reach."""
HEAT = (255, 166, 33)
LIDAR_AREA, LIDAR_RAY = (40, 185, 132, 26), (40, 185, 132, 64)
TRAIL = (33, 123, 182)
FAINT, STRONG = (132, 94, 194, 70), (117, 56, 194, 235)
PLAN, ROBOT = (218, 39, 78), (218, 39, 78)
REFERENCE = (25, 91, 38)


def fit_palette(given: Sequence[Colour], pictures: Sequence[Image.Image]) -> Image.Image:
    """Compute a palette of the given colours and the most frequent others of some frames.

    The given colours are opaque and kept unchanged. The frames are all of one size.
    """
    width, height = pictures[0].size
    sheet = Image.new("RGB", (width, height * len(pictures)))
    for index, picture in enumerate(pictures):
        sheet.paste(picture, (0, index * height))
    # One of the entries stays free: in a GIF it marks unchanged pixels.
    found = sheet.quantize(NUM_COLOURS - 1 - len(given), dither=Image.Dither.NONE).getpalette()
    palette = Image.new("P", (1, 1))
    palette.putpalette([channel for colour in given for channel in colour] + (found or []))
    return palette
