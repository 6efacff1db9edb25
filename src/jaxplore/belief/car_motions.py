"""Tables of the motions of a car, by the heading at which they begin or which they pass."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jaxplore.geometry.state_lattice import HEADINGS, NUM_HEADINGS, motions

Row = tuple[tuple[int, ...], float]
"""Six integers of a motion or a rest of one, and its length [node spacings]."""


@functools.cache
def rests(radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the rests of motions (N, R, 6) by the heading at which they begin, and their lengths.

    The six columns are the number of the motion, the heading of its end, rows and columns from its
    start, and rows and columns to its end. The lengths (N, R) [node spacings] are infinite where a
    heading has fewer rests than others.
    """
    by_heading: list[list[Row]] = [[] for _ in HEADINGS]
    for number, each in enumerate(motions(radius)):
        for at in each.via:
            to_end = (each.down - at.down, each.right - at.right)
            row = (number, each.end, at.down, at.right, *to_end)
            by_heading[at.heading].append((row, at.left))
    return _table(by_heading)


class MotionTable(NamedTuple):
    """The motions of a car as arrays, one row a motion.

    Args:
        start: (M,) heading at the start [rad].
        end: (M,) index of the heading at the end.
        down: (M,) rows from start to end.
        right: (M,) columns from start to end.
        length: (M,) length [node spacings].
        before: (M,) length of the straight piece before the circle [node spacings].
        turn: (M,) angle by which it turns [rad].
        via: (M, L, 3) rows and columns from the start, and heading, of the states that it passes,
            with the first one.
    """

    start: np.ndarray
    end: np.ndarray
    down: np.ndarray
    right: np.ndarray
    length: np.ndarray
    before: np.ndarray
    turn: np.ndarray
    via: np.ndarray


@functools.cache
def motion_table(radius: float) -> MotionTable:
    """Return the motions of a car with a turning radius [node spacings] as arrays."""
    found = motions(radius)
    # The first pose is one of them, and fills up the list.
    longest = 1 + max(len(each.via) for each in found)
    via = [
        [*(state[:3] for state in each.via), *[(0, 0, each.start)] * (longest - len(each.via))]
        for each in found
    ]
    whole = np.array([[each.end, each.down, each.right] for each in found], np.int32)
    end, down, right = whole.T
    real = [(HEADINGS[each.start], each.length, each.before, each.turn) for each in found]
    start, length, before, turn = np.array(real, np.float32).T
    via_array = np.array(via, np.int32).reshape(len(found), longest, 3)
    return MotionTable(start, end, down, right, length, before, turn, via_array)


@functools.cache
def continuations(radius: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the motions that begin at each heading, and after them the rests of motions.

    The arrays are like those of `rests`. The number is that of the whole motions of a heading.
    """
    by_heading: list[list[Row]] = [[] for _ in HEADINGS]
    for number, each in enumerate(motions(radius)):
        row = (number, each.end, 0, 0, each.down, each.right)
        by_heading[each.start].append((row, each.length))
    rows, lengths = _table(by_heading)
    more, left = rests(radius)
    joined = np.concatenate([rows, more], axis=1), np.concatenate([lengths, left], axis=1)
    return *joined, rows.shape[1]


def _table(by_heading: Sequence[Sequence[Row]]) -> tuple[np.ndarray, np.ndarray]:
    """Return rows (N, R, 6) and lengths (N, R), which are infinite where a heading has fewer."""
    most = max(map(len, by_heading))
    rows = np.zeros((NUM_HEADINGS, most, 6), np.int32)
    lengths = np.full((NUM_HEADINGS, most), np.inf, np.float32)
    for heading, own in enumerate(by_heading):
        for place, (row, length) in enumerate(own):
            rows[heading, place], lengths[heading, place] = row, length
    return rows, lengths
