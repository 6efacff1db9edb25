"""What was found of a volume, in space: its surface, and a picture of it from any side."""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from jaxplore.report.drawing.palette import PAPER, PLAN, REFERENCE, ROBOT, Colour

MOST_POINTS = 30_000
"""Greatest number of voxels of a figure or a page."""
_LOW, _MIDDLE, _HIGH = (46, 79, 119), (74, 160, 137), (243, 208, 100)
"""Colours of the lowest, the middle and the highest voxels."""
BARRED = (192, 57, 43)
"""Colour of the edges of keep-out boxes."""
_CEILING = 2
"""Upper layers that are left out: the ceiling, with what noise makes of it, would hide the rest."""

Colours = NDArray[np.uint8]


def surface(
    occupied: np.ndarray, free: np.ndarray | None = None, most: int = MOST_POINTS
) -> np.ndarray:
    """Return the voxels (N, 3) as (k, j, i) that are drawn: occupied ones below the ceiling.

    With the free voxels (D, H, W), only those are drawn that have a free neighbour above or beside
    them. Of more than `most`, evenly chosen ones are returned.
    """
    shown = occupied.copy()
    if free is not None:
        beside = np.zeros_like(occupied)
        for axis, step in ((0, -1), (1, 1), (1, -1), (2, 1), (2, -1)):
            beside |= np.roll(free, step, axis)
        shown &= beside
    shown[-_CEILING:] = False
    voxels = np.argwhere(shown)
    chosen = np.linspace(0, max(0, len(voxels) - 1), min(len(voxels), most)).astype(int)
    return np.asarray(voxels[chosen])


def box_edges(box: np.ndarray) -> list[np.ndarray]:
    """Return the twelve edges (2, 3) of a box (x_min, y_min, z_min, x_max, y_max, z_max) [m]."""
    corners = list(itertools.product((0, 1), repeat=3))
    ends = box.reshape(2, 3)
    return [
        np.array([[ends[side, axis] for axis, side in enumerate(each)] for each in pair])
        for pair in itertools.combinations(corners, 2)
        if np.abs(np.subtract(*pair)).sum() == 1
    ]


def height_colours(heights: np.ndarray, low: float, high: float) -> Colours:
    """Return the colours (N, 3) of heights [m] between a lowest and a highest one."""
    share = (heights - low) / max(high - low, 1e-9)
    nodes = np.array([_LOW, _MIDDLE, _HIGH], np.float64)
    channels = [np.interp(share, [0.0, 0.5, 1.0], nodes[:, channel]) for channel in range(3)]
    return np.round(np.stack(channels, axis=-1)).astype(np.uint8)


class SpacePicture:
    """Draws a box in space from any side, in parallel projection, all sides at one scale.

    `low` and `high` are the lowest and the highest corner (x, y, z) of the box [m]. `width` is that
    of the pictures [pixels], and `elevation` the angle of the view above the horizon [rad].
    """

    def __init__(
        self, low: np.ndarray, high: np.ndarray, width: int, elevation: float = math.radians(40.0)
    ) -> None:
        self._middle = 0.5 * (low + high)
        size = high - low
        across = math.hypot(size[0], size[1])
        self._sin, self._cos = math.sin(elevation), math.cos(elevation)
        self._pixels = 0.96 * width / across
        height = self._pixels * (across * self._sin + size[2] * self._cos) / 0.96
        self.size = width, math.ceil(height)

    def project(self, points: np.ndarray, azimuth: float) -> tuple[np.ndarray, np.ndarray]:
        """Return the pixels (N, 2) of points (N, 3) [m], and how near to the viewer each is [m].

        `azimuth` is the direction in which the viewer looks, around the vertical axis [rad].
        """
        x, y, z = (points - self._middle).T
        right = math.sin(azimuth) * x - math.cos(azimuth) * y
        away = math.cos(azimuth) * x + math.sin(azimuth) * y
        up = self._cos * z + self._sin * away
        pixels = np.stack([right, -up], axis=-1) * self._pixels + np.array(self.size) / 2.0
        return pixels, self._sin * z - self._cos * away

    def draw(
        self,
        points: np.ndarray,
        colours: Colours,
        side: float,
        path: np.ndarray,
        azimuth: float,
        plan: np.ndarray | None = None,
        goal: np.ndarray | None = None,
        edges: Sequence[np.ndarray] = (),
        marks: Sequence[tuple[np.ndarray, Colour]] = (),
    ) -> Image.Image:
        """Draw voxels by their middles (N, 3), the farthest first, and over them the path (M, 3)
        and the plan (T, 3), seen in the direction `azimuth` [rad]. `edges` (2, 3) are those of
        keep-out boxes, and `marks` the places (3,) and colours of squares [m]."""
        width, height = self.size
        image = np.full((height, width, 3), 255, np.uint8)
        pixels, near = self.project(points, azimuth)
        order = np.argsort(near, kind="stable")
        corner = np.floor(pixels[order] - 0.5 * side * self._pixels).astype(int)
        shown = colours[order]
        # A voxel is a square as wide as its cube, shaded at its lower and left edges.
        extent = max(2, math.ceil(1.25 * side * self._pixels))
        depth = np.full((height, width), -1)
        for row in range(extent):
            for column in range(extent):
                place = corner + np.array([column, row])
                is_in = ((place >= 0) & (place < [width, height])).all(axis=1)
                index = np.flatnonzero(is_in)
                at = place[index]
                flat = at[:, 1] * width + at[:, 0]
                # Later voxels are nearer and win.
                np.maximum.at(depth.reshape(-1), flat, index)
        filled = depth >= 0
        image[filled] = shown[depth[filled]]
        # Edges between voxels at different depths are darker, so that shapes stand out.
        gap = np.zeros((height, width), bool)
        ordered = near[order]
        behind = np.where(filled, ordered[np.maximum(depth, 0)], -np.inf) if len(ordered) else None
        if behind is not None:
            jump = np.abs(np.diff(np.where(np.isfinite(behind), behind, behind.max()), axis=1))
            gap[:, 1:] = jump > 4.0 * side
            image[gap & filled] = (0.6 * image[gap & filled]).astype(np.uint8)
        picture = Image.fromarray(image)
        draw = ImageDraw.Draw(picture)
        for line, colour, thick in ((path, ROBOT, 2), (plan, PLAN, 2)):
            if line is not None and len(line) > 1:
                flat_line, _ = self.project(line, azimuth)
                draw.line(list(map(tuple, flat_line.tolist())), fill=colour[:3], width=thick)
        for edge in edges:
            flat_line, _ = self.project(edge, azimuth)
            draw.line(list(map(tuple, flat_line.tolist())), fill=BARRED, width=2)
        if goal is not None:
            (x, y), radius = self.project(goal[None], azimuth)[0][0].tolist(), 7
            draw.regular_polygon((x, y, radius), 4, 45, REFERENCE[:3])
        for place, fill in marks:
            (x, y), reach = self.project(place[None], azimuth)[0][0].tolist(), 6
            draw.rectangle((x - reach, y - reach, x + reach, y + reach), fill, PAPER, 2)
        if len(path):
            (x, y), radius = self.project(path[-1:], azimuth)[0][0].tolist(), 4
            draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=ROBOT[:3])
        return picture
