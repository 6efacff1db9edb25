"""A picture of the belief with the robot and what its parts show in it."""

import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from PIL import Image, ImageDraw

from jaxplore.report.drawing.colours import belief_colours
from jaxplore.report.drawing.palette import LIDAR_RAY, TRAIL
from jaxplore.report.drawing.picture import SUPERSAMPLING, to_frame
from jaxplore.report.drawing.shapes import draw_body, draw_line
from jaxplore.report.exploration.mission import MissionFrame
from jaxplore.report.part import PartReport

MOST_RAYS = 45


@dataclasses.dataclass(frozen=True)
class Sheet:
    """The transformation from world points to a supersampled picture of a whole grid.

    The grid has the pose `origin` [m, m, rad] and a height [m]. `scale` is the pixels of the
    supersampled picture per metre.
    """

    unit: ClassVar[float] = float(SUPERSAMPLING)

    origin: np.ndarray
    height: float
    scale: float

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Turn world points (..., 2) [m] into columns and rows of the supersampled picture."""
        placed = to_frame(points, self.origin)
        placed[..., 1] = self.height - placed[..., 1]
        return np.asarray(placed * self.scale)


def belief_picture(
    probability: np.ndarray,
    origin: np.ndarray,
    resolution: float,
    *,
    path: np.ndarray,
    heading: float,
    radius: float,
    footprint: np.ndarray,
    scan: np.ndarray,
    parts: Mapping[str, PartReport],
    frame: MissionFrame,
    width: int = 640,
) -> np.ndarray:
    """Draw the belief, the trail, the last scan, the parts and the robot (rows, columns, 3) in 256
    levels.

    As in the animation of a run, a target is a star until it is found, then a ring with a check
    mark: a spectator sees the places of all targets. `frame` has what `parts` show now. The trail
    `path` (N, 2) ends at the present position, and `scan` (B, 2) are the ends of the beams [m]. The
    width is rounded to a multiple of that of a cell.
    """
    rows, columns = probability.shape
    side = max(1, round(width / columns))
    level = np.round(255.0 * probability).astype(np.uint8)
    # Row 0 of a grid is at the bottom, row 0 of a picture at the top.
    image = Image.fromarray(belief_colours()[level[::-1]])
    size = (columns * side * SUPERSAMPLING, rows * side * SUPERSAMPLING)
    image = image.resize(size, Image.Resampling.NEAREST)
    draw = ImageDraw.Draw(image, "RGBA")
    sheet = Sheet(
        np.asarray(origin, np.float64), rows * resolution, SUPERSAMPLING * side / resolution
    )
    for end in scan[:: max(1, len(scan) // MOST_RAYS)]:
        draw_line(sheet, draw, np.stack([path[-1], end]), LIDAR_RAY, 0.5)
    draw_line(sheet, draw, path, TRAIL, 1.5)
    for part in parts.values():
        part.draw(sheet, draw, None, frame)
    draw_body(sheet, draw, footprint, radius, path[-1], heading)
    return np.asarray(image.reduce(SUPERSAMPLING))
