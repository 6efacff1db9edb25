"""What all frames of an exploration share beside the map: where cells and nodes are drawn."""

import dataclasses

import numpy as np

from jaxplore.report.drawing.footer import Entry
from jaxplore.report.drawing.picture import MIN_WIDTH, SUPERSAMPLING, to_frame
from jaxplore.report.exploration.data import ExplorationData, ExplorationFrame
from jaxplore.report.exploration.legend import legend_entries
from jaxplore.report.exploration.map_canvas import MapCanvas, make_map_canvas
from jaxplore.report.exploration.overlays import find_closed_cells
from jaxplore.report.exploration.progress import progress
from jaxplore.report.exploration.window import Window


@dataclasses.dataclass(frozen=True)
class Canvas:
    """The parts of an animation that are the same in every frame.

    `sample` are the drawn rows and columns, and `blocks` the first row and column of the cells that
    each of them stands for; `corners` (4, R, C) are the indices of the nodes of the information
    field around each drawn cell and `shares` their bilinear weights; `closed` are the drawn cells
    of untraversable open ground; `brightest` [nat] is the information at which the colour
    saturates.
    """

    recording: ExplorationData
    map: MapCanvas
    sample: tuple[np.ndarray, np.ndarray]
    blocks: tuple[np.ndarray, np.ndarray]
    legend: tuple[Entry, ...]
    corners: np.ndarray
    shares: np.ndarray
    closed: np.ndarray
    brightest: float

    def any_in_blocks(self, cells: np.ndarray) -> np.ndarray:
        """Return for each drawn cell whether any cell that it stands for is set.

        So a wall of one cell stays visible where several cells share a pixel.
        """
        rows = np.logical_or.reduceat(cells, self.blocks[0], axis=0)
        return np.asarray(np.logical_or.reduceat(rows, self.blocks[1], axis=1))


def make_canvas(recording: ExplorationData, width: int, zoom: float) -> Canvas:
    """Make the canvas of a recording; `zoom` is the scale of the picture.

    The width is in pixels of scale 1, at least 320; tall or small maps have less.
    """
    if width < MIN_WIDTH:
        raise ValueError(f"width is {width!r}; accepted: a whole number >= {MIN_WIDTH}")
    time, coverage, _, path = progress(recording)
    canvas = make_map_canvas(recording, (time, coverage, path), width, zoom)
    window, (columns, rows) = canvas.window, canvas.size
    # Where cells are smaller than pixels, a subset is enough.
    cells = [
        (np.arange(count), window.shape[axis] / count)
        for axis, count in (
            (axis, min(window.shape[axis], SUPERSAMPLING * (rows, columns)[axis]))
            for axis in (0, 1)
        )
    ]
    down, across = (((index + 0.5) * size).astype(int) for index, size in cells)
    sample = (down, across)
    down, across = ((index * size).astype(int) for index, size in cells)
    blocks = (down, across)
    corners, shares = _field_stencil(recording, window, sample)
    closed = find_closed_cells(recording, window)[np.ix_(*sample)]
    return Canvas(
        recording=recording,
        map=canvas,
        sample=sample,
        blocks=blocks,
        legend=legend_entries(recording, has_closed=bool(closed.any())),
        closed=closed,
        corners=corners,
        shares=shares,
        brightest=_brightest(recording.frames),
    )


def _field_stencil(
    recording: ExplorationData, window: Window, sample: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return for each drawn cell the flat indices of four nodes and their bilinear weights."""
    nodes = recording.frames[0].information.shape
    if not all(nodes):
        return np.zeros((4, 0, 0), int), np.zeros((4, 0, 0), np.float32)
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
    fields = [np.nan_to_num(frame.information) for frame in frames if frame.information.size]
    highs = [np.percentile(each, 98) for each in fields]
    return max(float(np.median(highs)), 1e-6) if highs else 1.0
