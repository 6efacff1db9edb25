"""Colours of an animation, and the few that all of its frames share."""

from collections.abc import Sequence

from PIL import Image

from jaxplore.report.drawing.colours import (
    CLOSED,
    CLOSED_SHARE,
    FREE,
    MOVER_EDGE,
    TARGET,
    UNKNOWN,
    blend,
)
from jaxplore.simulation.recording import Recording

Colour = tuple[int, int, int] | tuple[int, int, int, int]

NUM_COLOURS = 64
HEAT_LEVELS, MAX_HEAT = 6, 0.75
"""Steps of the information's colour, few so that small changes cost no bytes; its opacity."""

PAPER, INK, PALE = (255, 255, 255), (43, 48, 58), (125, 132, 143)
HIDDEN_WALL = (172, 178, 188)
HEAT = (255, 166, 33)
LIDAR_AREA, LIDAR_RAY = (42, 170, 150, 26), (42, 170, 150, 64)
TRAIL = (31, 111, 178)
FAINT, STRONG = (132, 94, 194, 70), (118, 56, 190, 235)
PLAN, ROBOT = (214, 40, 85), (214, 40, 85)
REFERENCE = (64, 145, 62)


def shared_palette(recording: Recording, looks: Sequence[Image.Image]) -> Image.Image:
    """Return the colours that all frames share.

    Thin lines are few pixels, which a choice by frequency would sacrifice: their colours are given,
    pure and as they fade into the ground; the rest is found from a few frames side by side.

    Args:
        recording: of the run; what is not in it needs no colour.
        looks: some of the frames, all of one size.
    """
    lines = (PLAN, REFERENCE, STRONG[:3], FAINT[:3], TRAIL, LIDAR_RAY[:3])
    given: list[Colour] = [PAPER, FREE, UNKNOWN, HIDDEN_WALL, INK, PALE, *lines]
    given += [blend(line, FREE, share) for line in lines for share in (0.35, 0.7)]
    given += [blend(HEAT, FREE, k / HEAT_LEVELS * MAX_HEAT) for k in range(1, HEAT_LEVELS + 1)]
    if recording.traversable is not None:
        given += [blend(CLOSED, ground, CLOSED_SHARE) for ground in (FREE, UNKNOWN)]
    if len(recording.targets):
        given.append(TARGET)
    if len(recording.mover_radii):
        given.append(MOVER_EDGE)
    return fitted_palette(given, looks)


def fitted_palette(given: Sequence[Colour], looks: Sequence[Image.Image]) -> Image.Image:
    """Return so many given colours, and those that some frames need besides.

    Args:
        given: that are kept as they are, opaque.
        looks: some of the frames, all of one size.
    """
    width, height = looks[0].size
    sheet = Image.new("RGB", (width, height * len(looks)))
    for index, look in enumerate(looks):
        sheet.paste(look, (0, index * height))
    # One entry stays free: it stands for "as before".
    found = sheet.quantize(NUM_COLOURS - 1 - len(given), dither=Image.Dither.NONE).getpalette()
    palette = Image.new("P", (1, 1))
    palette.putpalette([channel for colour in given for channel in colour] + (found or []))
    return palette
