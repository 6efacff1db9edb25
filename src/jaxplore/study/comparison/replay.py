"""Compact replay of a run: the time at which each cell was first seen."""

import io
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from jaxplore._files import MALFORMED

NEVER = 255
"""Level of cells that were never seen. Eight bits leave 255 levels for the frames, more than a run
has."""


class Replay(NamedTuple):
    """Times at which the cells of a map were first seen.

    Args:
        times: (N,) times of the frames [s], at most 255.
        picture: a grey PNG, top row first. The level of a cell is the index of the first frame in
            which it was known, or `NEVER`. None if all were known from the beginning.
    """

    times: list[float]
    picture: bytes | None


def decode_cells(picture: bytes | None, shape: tuple[int, int]) -> np.ndarray | None:
    """Return the levels of a replay's picture, row 0 at the bottom; None if it is none of a map.

    The PNG may have more rows at the top and more columns at the right than the map. Without one
    all cells were seen in the first frame.
    """
    if picture is None:
        return np.zeros(shape, np.uint8)
    try:
        cells = np.asarray(Image.open(io.BytesIO(picture), formats=("PNG",)))
    except (*MALFORMED, OSError, EOFError, SyntaxError, Image.DecompressionBombError):
        # Pillow raises errors of many kinds for damaged pictures.
        return None
    is_map = cells.ndim == 2 and cells.dtype == np.uint8
    cells = cells[::-1][: shape[0], : shape[1]]
    return cells if is_map and cells.shape == shape else None


def make_replay(frames: Sequence[Any], known: Callable[[Any], np.ndarray]) -> Replay:
    """Compute the first of the frames in which each cell was known.

    `known` returns the cells (H, W) that are known in a frame.
    """
    first: np.ndarray | None = None
    for index, frame in enumerate(frames[:NEVER]):
        cells = known(frame)
        first = np.full(cells.shape, NEVER, np.uint8) if first is None else first
        first[cells & (first == NEVER)] = index
    assert first is not None  # a recording has a frame at its end
    file = io.BytesIO()
    # Row 0 of a map is at the bottom, row 0 of a picture at the top.
    Image.fromarray(first[::-1]).save(file, format="PNG", optimize=True)
    return Replay([frame.time for frame in frames[:NEVER]], file.getvalue())
