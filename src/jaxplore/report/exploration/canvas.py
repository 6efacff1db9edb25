"""The parts of an animation that are the same in every frame."""

import dataclasses

import numpy as np

from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD
from jaxplore.report.drawing.picture import FOOTER, MIN_MAP_SIDE, MIN_WIDTH, SUPERSAMPLING, to_frame
from jaxplore.report.exploration.data import ExplorationData, ExplorationFrame
from jaxplore.report.exploration.overlays import closed_cells
from jaxplore.report.exploration.progress import progress
from jaxplore.report.exploration.window import Window

MAX_RATIO = 1.1
"""Greatest height of the map, as a multiple of the picture's width."""


@dataclasses.dataclass(frozen=True)
class Canvas:
    """The parts of an animation that are the same in every frame.

    `scale` is in pixels per metre, `left` is the map's first column; `corners` (4, R, C) are the
    indices of the nodes of the information field around each drawn cell and `shares` their bilinear
    weights; `closed` are the drawn cells of untraversable open ground; `brightest` [nat] is the
    information at which the colour saturates.
    """

    recording: ExplorationData
    window: Window
    width: int
    map_size: tuple[int, int]
    left: int
    scale: float
    sample: tuple[np.ndarray, np.ndarray]
    hidden_walls: np.ndarray
    corners: np.ndarray
    shares: np.ndarray
    closed: np.ndarray
    brightest: float
    progress: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]

    @property
    def height(self) -> int:
        """Height of the picture, map and footer [pixels]."""
        return self.map_size[1] + FOOTER

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Turn world points (..., 2) [m] into columns and rows of the supersampled map."""
        placed = self.window.place(points) * self.scale * SUPERSAMPLING
        placed[..., 1] = self.map_size[1] * SUPERSAMPLING - placed[..., 1]
        return np.asarray(np.clip(placed, -1e4, 1e4))


def make_canvas(recording: ExplorationData, width: int) -> Canvas:
    """Make the canvas of a recording.

    Args:
        recording: recording of the run.
        width: width of the picture [pixels]; less for tall or small maps.

    Raises:
        ValueError: a width below 320 pixels.
    """
    if width < MIN_WIDTH:
        raise ValueError(f"width is {width!r}; accepted: a whole number >= {MIN_WIDTH}")
    window = Window.around_reachable(recording)
    size = np.asarray(window.size)
    scale = min(width / size[0], MAX_RATIO * width / size[1])
    columns, rows = (max(MIN_MAP_SIDE, round(float(side) * scale)) for side in size)
    total = max(MIN_WIDTH, columns)
    # Where cells are smaller than pixels, a subset is enough.
    cells = [
        (np.arange(count) + 0.5) * window.shape[axis] / count
        for axis, count in (
            (axis, min(window.shape[axis], SUPERSAMPLING * (rows, columns)[axis]))
            for axis in (0, 1)
        )
    ]
    sample = (cells[0].astype(int), cells[1].astype(int))
    corners, shares = _field_stencil(recording, window, sample)
    drawn = np.ix_(*sample)
    return Canvas(
        recording=recording,
        window=window,
        width=total,
        map_size=(columns, rows),
        left=(total - columns) // 2,
        scale=scale,
        sample=sample,
        hidden_walls=(window.crop(recording.world, 0.5) > OCCUPIED_THRESHOLD)[drawn],
        closed=closed_cells(recording, window)[drawn],
        corners=corners,
        shares=shares,
        brightest=_brightest(recording.frames),
        progress=progress(recording),
    )


def _field_stencil(
    recording: ExplorationData, window: Window, sample: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return for each drawn cell the flat indices of four nodes and their bilinear weights."""
    nodes = recording.frames[0].information.shape
    y, x = (
        (index + first + 0.5) * window.resolution
        for index, first in zip(sample, window.first, strict=True)
    )
    yaw = float(recording.origin[2])
    cos, sin = np.cos(yaw), np.sin(yaw)
    world = np.stack(
        [
            cos * x[None, :] - sin * y[:, None] + float(recording.origin[0]),
            sin * x[None, :] + cos * y[:, None] + float(recording.origin[1]),
        ],
        axis=-1,
    )
    spot = to_frame(world, recording.field_origin)[..., ::-1] / recording.field_resolution - 0.5
    # Cells beyond the outermost nodes take the value of the nearest one.
    spot = np.clip(spot, 0.0, np.asarray(nodes) - 1.0)
    lower = np.floor(spot).astype(int)
    upper = np.minimum(lower + 1, np.asarray(nodes) - 1)
    share = spot - lower
    corners, shares = [], []
    for down in (False, True):
        for right in (False, True):
            row = (upper if down else lower)[..., 0]
            column = (upper if right else lower)[..., 1]
            corners.append(row * nodes[1] + column)
            across = share[..., 1] if right else 1.0 - share[..., 1]
            shares.append((share[..., 0] if down else 1.0 - share[..., 0]) * across)
    return np.stack(corners), np.stack(shares).astype(np.float32)


def _brightest(frames: tuple[ExplorationFrame, ...]) -> float:
    """Return an information that few nodes exceed in any frame [nat]."""
    highs = [np.percentile(np.nan_to_num(frame.information), 98) for frame in frames]
    return max(float(np.median(highs)), 1e-6)
