"""What a robot had seen when: a run's map as it grew, in one small picture."""

import io
from typing import NamedTuple

import numpy as np
from PIL import Image

from jaxplore.report.exploration.data import ExplorationData

NEVER = 255
"""Level of cells that were not seen."""


class Replay(NamedTuple):
    """How a map grew.

    Args:
        times: (N,) instants at which the map was looked at [s], at most 255.
        picture: a grey PNG, top row first: each cell's level is the index of the first instant at
            which it was known, free or occupied (`4 p (1 - p) <= 1/2`), or `NEVER`.
    """

    times: list[float]
    picture: bytes


def replay_of(recording: ExplorationData) -> Replay:
    """Return how a run's map grew: at the run's looks, every half second, or in a long run (in a
    batch the longest) at 120 instants at least."""
    first = np.full(recording.world.shape, NEVER, np.uint8)
    for index, frame in enumerate(recording.frames[:NEVER]):
        p = frame.probability / 255.0
        is_new = (4.0 * p * (1.0 - p) <= 0.5) & (first == NEVER)
        first[is_new] = index
    file = io.BytesIO()
    Image.fromarray(first[::-1]).save(file, format="PNG", optimize=True)
    return Replay([frame.time for frame in recording.frames[:NEVER]], file.getvalue())
