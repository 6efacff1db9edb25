"""A picture of the belief with the robot and the targets in it."""

import dataclasses
from typing import ClassVar

import numpy as np
from PIL import Image, ImageDraw

from jaxplore.report.drawing.colours import TARGET, belief_colours
from jaxplore.report.drawing.palette import LIDAR_RAY, TRAIL
from jaxplore.report.drawing.picture import SUPERSAMPLING, to_frame
from jaxplore.report.drawing.shapes import draw_body, draw_line, draw_targets

MOST_RAYS = 45


@dataclasses.dataclass(frozen=True)
class Sheet:
    """The transformation from world points to a supersampled picture of a whole grid.

    Args:
        origin: pose of the grid [m, m, rad].
        height: height of the grid [m].
        scale: pixels of the supersampled picture per metre.
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
    targets: np.ndarray,
    is_found: np.ndarray,
    width: int = 640,
) -> np.ndarray:
    """Draw the belief, the trail, the last scan, the targets and the robot (rows, columns, 3).

    It is in 256 levels. As in the animation of a run, a target is a star until it is found, then a
    ring with a check mark: a spectator sees the places of all targets.

    Args:
        probability: (H, W) occupancy probability of the belief.
        origin: pose of the grid [m, m, rad].
        resolution: side of a cell [m].
        path: (N, 2) past positions of the robot, the last row its present one [m].
        heading: heading of the robot [rad].
        radius: radius of the robot [m].
        footprint: (4, 2) corners of a rectangle in the robot's frame [m]; (0, 2) of a disc.
        scan: (B, 2) end points of the beams [m].
        targets: (M, 2) positions of the targets [m].
        is_found: (M,) whether each target was found.
        width: width of the picture [pixels], rounded to a multiple of the width of a cell.
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
    draw_targets(sheet, draw, targets, is_found, TARGET)
    draw_body(sheet, draw, footprint, radius, path[-1], heading)
    return np.asarray(image.reduce(SUPERSAMPLING))
