"""Standard streams of the program: closed, without a reader, or on a full disk."""

import io
import os
import sys
from collections.abc import Buffer
from typing import TextIO


class _Output(io.FileIO):
    """A stream that is written no further once it has failed.

    Its reader may have left, as that of `| head` does. What it has read is all that it wanted, so
    this is no error. Another failure is one if the stream is required, and only once: Python would
    write again when it shuts down.
    """

    def __init__(self, number: int, *, is_required: bool) -> None:
        super().__init__(number, "w", closefd=False)
        self._is_required = is_required

    def write(self, data: Buffer) -> int:
        try:
            return super().write(data)
        except OSError as error:
            _open_nothing(self.fileno())
            if self._is_required and not isinstance(error, BrokenPipeError):
                raise OSError(
                    f"standard output cannot be written: {error.strerror}; accepted: a file on a "
                    "disk with space left, or a terminal"
                ) from None
            return memoryview(data).nbytes


def open_streams() -> None:
    """Prepare the standard streams of this process."""
    if os.name != "posix":
        return
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            # The next file that is opened would get this number, and be written to by messages.
            _open_nothing(number)
    sys.stdout = _text(1, sys.stdout)
    sys.stderr = _text(2, sys.stderr)


def _open_nothing(number: int) -> None:
    nothing = os.open(os.devnull, os.O_RDWR)
    # In a closed process the lowest free number is this one.
    if nothing != number:
        os.dup2(nothing, number)
        os.close(nothing)


def _text(number: int, former: TextIO | None) -> TextIO:
    if former is not None and former.isatty():
        return former
    stream = io.BufferedWriter(_Output(number, is_required=number == 1))
    encoding = "utf-8" if former is None else former.encoding
    errors = "backslashreplace" if former is None else former.errors
    return io.TextIOWrapper(stream, encoding=encoding, errors=errors, line_buffering=number == 2)
