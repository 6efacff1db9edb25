"""The part of a map that figures show, and its coordinates."""

import dataclasses
from typing import Protocol, runtime_checkable

import numpy as np

from jaxplore.report.drawing.picture import to_frame

MARGIN = 1.0
"""Margin around the reachable cells [m]."""


@runtime_checkable
class MapData(Protocol):
    """A run on a map of which a part is drawn, of any task."""

    @property
    def world(self) -> np.ndarray:
        """Probability (H, W) of the true map."""

    @property
    def reachable(self) -> np.ndarray:
        """Cells (H, W) that count for coverage."""

    @property
    def origin(self) -> np.ndarray:
        """Pose of the grid [m, m, rad]."""

    @property
    def resolution(self) -> float:
        """Side of a cell [m]."""


@dataclasses.dataclass(frozen=True)
class Window:
    """The part of a grid that is drawn; it may reach beyond the grid.

    `first` is the row and column of its first cell, and `shape` its number of rows and columns. The
    grid has the pose `origin` [m, m, rad] and cells of side `resolution` [m].
    """

    first: tuple[int, int]
    shape: tuple[int, int]
    origin: np.ndarray
    resolution: float

    @classmethod
    def around_reachable(cls, recording: MapData) -> "Window":
        """Return the box of the reachable cells, or of the grid without any, and a margin."""
        cells = recording.reachable
        rows, columns = np.nonzero(cells if cells.any() else np.ones_like(cells, bool))
        margin = round(MARGIN / recording.resolution)
        first = (int(rows.min()) - margin, int(columns.min()) - margin)
        last = (int(rows.max()) + margin, int(columns.max()) + margin)
        shape = (last[0] - first[0] + 1, last[1] - first[1] + 1)
        return cls(first, shape, recording.origin, recording.resolution)

    @property
    def size(self) -> tuple[float, float]:
        """Extent along the grid's x and y axes [m]."""
        return self.shape[1] * self.resolution, self.shape[0] * self.resolution

    @property
    def is_turned(self) -> bool:
        """Whether the grid is rotated in the world."""
        return bool(self.origin[2] != 0.0)

    @property
    def corner(self) -> np.ndarray:
        """First corner (2,) of the window on the drawn axes [m].

        The drawn axes are the world's, or the grid's own if it is rotated.
        """
        corner = np.asarray(self.first[::-1], np.float64) * self.resolution
        return corner if self.is_turned else corner + self.origin[:2]

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top of the window on the drawn axes [m]."""
        (left, bottom), (right, top) = self.corner, self.corner + np.asarray(self.size)
        return float(left), float(right), float(bottom), float(top)

    def crop(self, cells: np.ndarray, fill: float | bool) -> np.ndarray:
        """Cut the window out of a grid; cells beyond the grid are `fill`."""
        rows, columns = (
            np.arange(start, start + count)
            for start, count in zip(self.first, self.shape, strict=True)
        )
        inside = np.ix_(
            (rows >= 0) & (rows < cells.shape[0]), (columns >= 0) & (columns < cells.shape[1])
        )
        cropped = np.full(self.shape, fill, cells.dtype)
        cropped[inside] = cells[
            np.ix_(
                rows[(rows >= 0) & (rows < cells.shape[0])],
                columns[(columns >= 0) & (columns < cells.shape[1])],
            )
        ]
        return cropped

    def place(self, points: np.ndarray) -> np.ndarray:
        """Transform world points (..., 2) to metres from the window's corner on the grid's axes."""
        return to_frame(points, self.origin) - np.asarray(self.first[::-1]) * self.resolution
