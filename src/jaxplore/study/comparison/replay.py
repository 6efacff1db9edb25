"""Compact replay of a run: the time at which each cell was first seen."""

import io
from typing import NamedTuple

import numpy as np
from PIL import Image

from jaxplore._files import MALFORMED
from jaxplore.report.exploration.data import ExplorationData

NEVER = 255
"""Level of cells that were never seen. Eight bits leave 255 levels for the frames, more than a run
has."""


class Replay(NamedTuple):
    """Times at which the cells of a map were first seen.

    Args:
        times: (N,) times of the frames [s], at most 255.
        picture: a grey PNG, top row first. The level of a cell is the index of the first frame in
            which it was known, free or occupied (`4 p (1 - p) <= 1/2`), or `NEVER`.
    """

    times: list[float]
    picture: bytes


def decode_cells(picture: bytes, shape: tuple[int, int]) -> np.ndarray | None:
    """Return the levels of a replay's picture, row 0 at the bottom; None if it is none of a map.

    The PNG may have more rows at the top and more columns at the right than the map.
    """
    try:
        cells = np.asarray(Image.open(io.BytesIO(picture), formats=("PNG",)))
    except (*MALFORMED, OSError, EOFError, SyntaxError, Image.DecompressionBombError):
        # Pillow raises errors of many kinds for damaged pictures.
        return None
    is_map = cells.ndim == 2 and cells.dtype == np.uint8
    cells = cells[::-1][: shape[0], : shape[1]]
    return cells if is_map and cells.shape == shape else None


def make_replay(recording: ExplorationData) -> Replay:
    """Compute the first frame in which each cell was known."""
    first = np.full(recording.world.shape, NEVER, np.uint8)
    for index, frame in enumerate(recording.frames[:NEVER]):
        p = frame.probability / 255.0
        is_new = (4.0 * p * (1.0 - p) <= 0.5) & (first == NEVER)
        first[is_new] = index
    file = io.BytesIO()
    # Row 0 of a map is at the bottom, row 0 of a picture at the top.
    Image.fromarray(first[::-1]).save(file, format="PNG", optimize=True)
    return Replay([frame.time for frame in recording.frames[:NEVER]], file.getvalue())
