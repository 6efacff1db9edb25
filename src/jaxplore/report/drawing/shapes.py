"""Shapes that all animations draw: lines, rollouts, the robot."""

from typing import Protocol, runtime_checkable

import numpy as np
from PIL import ImageDraw

from jaxplore.report.drawing.palette import FAINT, PAPER, REFERENCE, ROBOT, STRONG, Colour
from jaxplore.report.drawing.picture import outline_at, pairs

STRONG_SHARE = 0.02
"""Rollouts with at least this share of the greatest weight are drawn bold."""
LEAST_RADIUS = 6.5
"""Size to which a smaller robot is enlarged [pixels of scale 1]."""

STAR = 7.0
"""Radius of the sign of a target [pixels of scale 1]."""
_ANGLES = np.pi * (np.arange(10) / 5.0 - 0.5)
_SPIKES = np.where(np.arange(10) % 2, 0.42, 1.0)[:, None] * np.stack(
    [np.cos(_ANGLES), np.sin(_ANGLES)], axis=-1
)


@runtime_checkable
class Surface(Protocol):
    """A transformation from world points to a supersampled picture."""

    @property
    def scale(self) -> float:
        """Pixels of the supersampled picture per metre."""

    @property
    def unit(self) -> float:
        """Supersampled pixels per pixel of scale 1, in which widths of lines are given."""

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Turn world points (..., 2) [m] into columns and rows of the supersampled picture."""


def draw_line(
    surface: Surface,
    draw: ImageDraw.ImageDraw,
    points: np.ndarray,
    colour: Colour,
    thickness: float,
) -> None:
    """Draw a line through world points (N, 2) [m]; points that are not finite are left out.

    The thickness is in pixels of scale 1.
    """
    whole = points[np.isfinite(points).all(axis=-1)]
    if len(whole) > 1:
        draw.line(pairs(surface.pixels(whole)), colour, round(thickness * surface.unit), "curve")


def draw_rollouts(
    surface: Surface, draw: ImageDraw.ImageDraw, samples: np.ndarray, weights: np.ndarray
) -> None:
    """Draw rollouts (S, T, 2) [m], those of great weight (S,) bold and on top; NaN weighs 0."""
    known = np.nan_to_num(weights)
    bold = STRONG_SHARE * known.max(initial=0.0)
    for index in np.argsort(known):
        is_strong = known[index] > 0.0 and known[index] >= bold
        colour, thickness = (STRONG, 1.5) if is_strong else (FAINT, 1.0)
        draw_line(surface, draw, samples[index], colour, thickness)


def draw_body(
    surface: Surface,
    draw: ImageDraw.ImageDraw,
    footprint: np.ndarray,
    radius: float,
    position: np.ndarray,
    heading: float,
    colour: Colour = ROBOT,
) -> None:
    """Draw a robot, a rectangle with corners (4, 2) in its own frame or a disc (0, 2), with an
    arrow in its heading. A small one is enlarged, and keeps its shape. If the heading is not
    finite, it is a disc without an arrow."""
    middle, edge = surface.pixels(position), round(1.2 * surface.unit)
    reach = max(radius * surface.scale, LEAST_RADIUS * surface.unit)
    is_turned = bool(np.isfinite(heading))
    if len(footprint) and is_turned:
        width = float(np.ptp(footprint[:, 1]))
        larger = max(1.0, LEAST_RADIUS * surface.unit / (0.5 * width * surface.scale))
        corners = surface.pixels(outline_at(larger * footprint, position, heading))
        draw.polygon(pairs(corners), colour, PAPER, edge)
        middle, reach = corners.mean(axis=0), 0.5 * larger * width * surface.scale
    else:
        x, y = middle.tolist()
        draw.ellipse((x - reach, y - reach, x + reach, y + reach), colour, PAPER, edge)
    if is_turned:
        unit = np.array([np.cos(heading), np.sin(heading)])
        # The direction is measured in pixels, because a surface may be rotated or flipped.
        ahead = surface.pixels(position + unit) - surface.pixels(position)
        ahead /= max(float(np.hypot(*ahead)), 1e-6)
        aside = np.array([ahead[1], -ahead[0]])
        tips = [middle + 0.72 * reach * ahead]
        tips += [middle + reach * (-0.35 * ahead + side * 0.5 * aside) for side in (-1.0, 1.0)]
        draw.polygon(pairs(np.stack(tips)), PAPER)


def draw_star(
    surface: Surface, draw: ImageDraw.ImageDraw, middle: np.ndarray, colour: Colour
) -> None:
    """Draw a target that is still to be found, a star with a white rim, at a pixel (2,)."""
    star = STAR * surface.unit * _SPIKES
    draw.polygon(pairs(middle + 1.35 * star), PAPER)
    draw.polygon(pairs(middle + star), colour)


def draw_goal(surface: Surface, draw: ImageDraw.ImageDraw, goal: np.ndarray) -> None:
    """Draw a goal (2,) [m] as rings."""
    x, y = surface.pixels(goal)
    for size, colour in ((7.0, REFERENCE), (4.0, PAPER), (2.0, REFERENCE)):
        reach = size * surface.unit
        draw.ellipse((x - reach, y - reach, x + reach, y + reach), colour)


def draw_targets(
    surface: Surface,
    draw: ImageDraw.ImageDraw,
    targets: np.ndarray,
    is_found: np.ndarray,
    colour: Colour,
) -> None:
    """Draw targets (M, 2) [m]: a star until it is found, then a ring with a check mark."""
    for middle, found in zip(surface.pixels(targets), is_found, strict=True):
        (draw_found if found else draw_star)(surface, draw, middle, colour)


def draw_found(
    surface: Surface, draw: ImageDraw.ImageDraw, middle: np.ndarray, colour: Colour
) -> None:
    """Draw a target that was found: a ring with a check mark, as `draw_star`."""
    reach, unit = 0.95 * STAR * surface.unit, surface.unit
    x, y = middle.tolist()
    draw.ellipse((x - reach, y - reach, x + reach, y + reach), PAPER, colour, round(1.8 * unit))
    tick = np.array([[-0.42, 0.0], [-0.12, 0.34], [0.46, -0.36]])
    draw.line(pairs(middle + reach * tick), colour, round(1.8 * unit), "curve")
