"""The rows that a run records: in memory up to a bound, and in files beyond it."""

import math
import tempfile
import weakref
from typing import IO, Any

import jax
import numpy as np

MEMORY_LIMIT = 2**22
"""Size of the rows above which they are written to files [bytes]."""


class RecordBuffer:
    """Rows of a pytree of arrays, which are appended chunk by chunk.

    Up to `limit` bytes the rows are in memory. Beyond it they are appended to files, one for each
    array of the pytree, and the memory that they take does not grow any more. The files have no
    name: the operating system removes them when nobody reads them any more, and also after a crash.
    They are in Python's temporary folder, which the environment variable `TMPDIR` sets. If a file
    cannot be written, because the disk is full, the rows from there on stay in memory. `blank` has
    no rows (0, ...), and their structure, shapes and types.
    """

    def __init__(self, blank: Any, limit: int = MEMORY_LIMIT) -> None:
        leaves, self._structure = jax.tree.flatten(blank)
        size = sum(_row_size(leaf) for leaf in leaves)
        # The buffers of all arrays are written at the same row, so each has its share of the limit.
        most = max(1, limit // max(1, size))
        self._columns = [_Column(leaf, most) for leaf in leaves]
        self.append(blank)

    def append(self, rows: Any) -> None:
        """Append a copy of some rows, a pytree of arrays (n, ...)."""
        # A copy: rows that the loop returned are part of a buffer on the device, with room for a
        # whole chunk, which would live as long as they do.
        for column, leaf in zip(self._columns, jax.tree.leaves(rows), strict=True):
            column.append(leaf)

    @property
    def num_rows(self) -> int:
        """Number of rows."""
        return self._columns[0].num_rows if self._columns else 0

    def rows(self) -> Any:
        """Return all rows, in NumPy. Those in files are mapped into memory when they are read."""
        return jax.tree.unflatten(self._structure, [column.rows() for column in self._columns])


def _row_size(leaf: np.ndarray) -> int:
    return int(leaf.dtype.itemsize * math.prod(leaf.shape[1:]))


class _Column:
    """Rows of one array, with the row shape and type of `like`; at most `most` are in memory."""

    def __init__(self, like: np.ndarray, most: int) -> None:
        self._kept = np.empty((0, *like.shape[1:]), like.dtype)
        self._most: float = most
        self._num_kept = self._num_written = 0
        self._file: IO[bytes] | None = None

    @property
    def num_rows(self) -> int:
        return self._num_written + self._num_kept

    def append(self, rows: np.ndarray) -> None:
        # A former run may be longer than what is kept in memory.
        while len(rows) > self._most:
            most = int(self._most)
            self._append(rows[:most])
            rows = rows[most:]
        self._append(rows)

    def _append(self, rows: np.ndarray) -> None:
        needed = self._num_kept + len(rows)
        if needed > self._most:
            self._write()
            needed = self._num_kept + len(rows)
        if needed > len(self._kept):
            # Twice the room each time, so that a row is copied twice on average.
            grown = np.empty((max(needed, 2 * len(self._kept)), *rows.shape[1:]), rows.dtype)
            grown[: self._num_kept] = self._kept[: self._num_kept]
            self._kept = grown
        self._kept[self._num_kept : needed] = rows
        self._num_kept = needed

    def _write(self) -> None:
        """Move the rows from memory to the end of the file."""
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
                weakref.finalize(self, self._file.close)
            # A former attempt may have written a part.
            self._file.seek(self._num_written * _row_size(self._kept))
            left = memoryview(self._kept[: self._num_kept].reshape(-1).view(np.uint8))
            while left:
                left = left[self._file.write(left) :]
        except OSError:
            # Nothing is lost while there is memory.
            self._most = math.inf
            return
        self._num_written, self._num_kept = self.num_rows, 0

    def rows(self) -> np.ndarray:
        kept = self._kept[: self._num_kept]
        if self._num_written == 0 or self._file is None:
            return kept.copy()
        if math.isfinite(self._most):
            self._write()
            kept = self._kept[: self._num_kept]
        # Copied on write: a caller may change the rows, as those in memory. The map lives on when
        # the file is closed.
        shape = (self._num_written, *self._kept.shape[1:])
        mapped: np.ndarray = np.asarray(np.memmap(self._file, self._kept.dtype, "c", 0, shape))
        return np.concatenate([mapped, kept]) if len(kept) else mapped
