"""Rows of numbers that are appended for hours."""

import numpy as np


class Rows:
    """Rows of numbers in one array, which doubles when it is full.

    A list of objects would take ten times the memory, and a drive goes on for hours. Another thread
    may read while one appends.
    """

    def __init__(self, width: int) -> None:
        self._array = np.zeros((64, width))
        self._count = 0

    def __len__(self) -> int:
        return self._count

    def add(self, *values: float) -> None:
        """Append a row."""
        if self._count == len(self._array):
            self._array = np.concatenate([self._array, np.zeros_like(self._array)])
        self._array[self._count] = values
        self._count += 1

    @property
    def array(self) -> np.ndarray:
        """All rows (N, width)."""
        # The count first: the array that is read after it has at least as many rows.
        count = self._count
        return self._array[:count]
