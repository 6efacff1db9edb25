"""Tables of the motions of a car."""

import functools
from typing import NamedTuple

import numpy as np

from jaxplore.geometry.state_lattice import HEADINGS, motions


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
def motions_from(radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of the motions that begin at each heading (N, R), and which are some.

    A heading with fewer motions than others has its first one several times.
    """
    own: list[list[int]] = [[] for _ in HEADINGS]
    for number, each in enumerate(motions(radius)):
        own[each.start].append(number)
    most = max(map(len, own))
    numbers = np.array([each + each[:1] * (most - len(each)) for each in own], np.int32)
    is_motion = np.arange(most) < np.array([[len(each)] for each in own])
    return numbers, is_motion
