"""Recording of a run as an MCAP file, which Foxglove opens."""

import os
import warnings
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import BinaryIO

import jax

from jaxplore import _checks, _kinds
from jaxplore._optional import import_optional
from jaxplore._version import __version__
from jaxplore.control.base import Controller
from jaxplore.report.folder import whole_file
from jaxplore.report.recording import Recording
from jaxplore.simulation.monitor import Monitor, Update
from jaxplore.tasks.registry import how_shown
from jaxplore.topics.channels import Channels
from jaxplore.topics.messages import EXTRA

SUFFIX = ".mcap"
UPDATE_SECONDS = 0.1
"""Simulated time between the frames of a recording [s]."""
PROFILE = "jaxplore"


class RecordingWarning(UserWarning):
    """A recording that could not be written, while the run went on."""


class McapRecorder(Monitor):
    """Writes a run to an MCAP file while it goes on.

    The file appears at the end of the run, completely or not at all. A run that the user stops
    counts as a whole one. A run that fails leaves no file. If the disk is full, the run goes on,
    `failure` says so, and there is a warning.

    Foxglove shows the file without further files: it holds the schemas of all topics.

    Args:
        path: the file, which ends in .mcap.
        overwrite: whether a file that exists is replaced.
        began: time of the start of the run since the epoch [s]; 0 for simulated time.

    Raises:
        ValueError: another kind of file, one that exists, a folder that does not exist or cannot be
            written, a missing `foxglove-sdk`.
    """

    @_kinds.check_arguments
    def __init__(
        self, path: str | os.PathLike[str], *, overwrite: bool = False, began: float = 0.0
    ) -> None:
        _kinds.flag("overwrite", overwrite)
        self.path = check_recording(path, overwrite=overwrite)
        self.failure: str | None = None
        """Why there is no file; None if there is one, or the run has not ended."""
        self._began = _checks.number("began", began, at_least=0.0)
        self._open: ExitStack | None = None

    def begin(self, recording: Recording, controller: Controller) -> None:
        """Open the file, and write the world and the first frame.

        Raises:
            ValueError: the file cannot be written.
        """
        sdk = import_optional("foxglove", EXTRA)
        mcap = import_optional("foxglove.mcap", EXTRA)
        with ExitStack() as stack:
            temporary = stack.enter_context(whole_file(self.path, "recording"))
            self._sink = _Sink(stack.enter_context(temporary.open("wb")))
            # Called after the writer has been closed, whose end of the file may not fit any more.
            stack.callback(self._sink.check)
            context = sdk.Context()
            options = mcap.MCAPWriteOptions(
                compression=mcap.MCAPCompression.Zstd,
                profile=PROFILE,
                disable_seeking=True,
                # Without it the writer starts threads beside those of the simulation.
                compression_threads=0,
            )
            writer = sdk.open_mcap(self._sink, context=context, writer_options=options)
            stack.callback(writer.close)
            writer.write_metadata("jaxplore", {"version": __version__})
            channels = Channels(context, self._began)
            stack.callback(channels.close)
            self._content = how_shown(recording).content(channels, recording, controller)
            self._content.write_start()
            for frame in recording.frames[:1]:
                self._content.write_frame(frame)
            # A run that is continued begins at a later step.
            self._step = recording.frames[0].step if recording.frames else 0
            self._open = stack.pop_all()

    def is_due(self, simulated: float, elapsed: float) -> bool:
        """Check whether a tenth of a simulated second has passed."""
        return simulated > UPDATE_SECONDS - 1e-6

    def show(self, update: Update) -> None:
        """Write the steps and the frame of an update."""
        if self._open is None or self._sink.error is not None:
            return
        self._content.write_steps(update.records, update.time, update.text)
        self._content.write_frame(update.frame)
        self._step = update.frame.step

    def end(self, recording: Recording | None) -> None:
        """Write the rest of the run and put the file in its place; remove it if the run failed."""

        def write_rest() -> None:
            if recording is None:
                raise _Failed
            self._write_rest(recording)
            if self._sink.error is None:
                self._content.write_end(recording)

        self._close(write_rest)

    def stop(self) -> None:
        """Put the file in its place with what was written so far, while the run goes on."""
        self._close(lambda: None)

    def _close(self, write: Callable[[], None]) -> None:
        """Write what is left and put the file in its place; once."""
        if self._open is None:
            return
        stack, self._open = self._open, None
        try:
            with stack:
                write()
        except _Failed:
            return
        except (ValueError, RuntimeError) as error:
            # The run is worth more than its recording.
            self.failure = " ".join(str(error).split())
            warnings.warn(self.failure, RecordingWarning, stacklevel=2)

    def _write_rest(self, recording: Recording) -> None:
        """Write the steps since the last update."""
        done, rest = recording.num_steps, slice(self._step, None)
        if done <= self._step or self._sink.error is not None:
            return
        records = jax.tree.map(lambda rows: rows[rest], recording.records)
        self._content.write_steps(records, recording.time[1:][rest])
        if recording.frames and recording.frames[-1].step == done:
            self._content.write_frame(recording.frames[-1])


def check_recording(
    path: str | os.PathLike[str], *, overwrite: bool = False, name: str = "path"
) -> Path:
    """Check before a long run whether a recording can be written; return its path.

    It raises what `McapRecorder` does. `name` is that of the path in messages.
    """
    import_optional("foxglove", EXTRA)
    file = Path(path)
    if file.suffix.lower() != SUFFIX or "\0" in str(file):
        raise ValueError(f"{name} is {str(file)!r}; accepted: a file that ends in {SUFFIX}")
    if not file.parent.is_dir():
        raise ValueError(f"{name} is {str(file)!r}; accepted: a file in a folder that exists")
    if file.is_dir() or (file.exists() and not overwrite):
        raise ValueError(f"{name} is {str(file)!r}, which exists; accepted: a new file, or "
                         "to overwrite a file")  # fmt: skip
    if not os.access(file.parent, os.W_OK):
        raise ValueError(f"{name} is {str(file)!r}; accepted: a file in a folder that you can "
                         "write to")  # fmt: skip
    return file


class _Failed(Exception):
    """A run that failed: its file is given up."""


class _Sink:
    """A file that never fails: the first error is kept until `check`.

    An error within the writer of the SDK would end the process.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._size = file, 0
        self.error: OSError | None = None

    def write(self, data: bytes) -> int:
        """Append bytes."""
        self._size += len(data)
        try:
            if self.error is None:
                self._file.write(data)
        except OSError as error:
            self.error = error
        return len(data)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Return the size: the writer only appends."""
        return self._size

    def flush(self) -> None:
        """Write what is buffered."""
        try:
            if self.error is None:
                self._file.flush()
        except OSError as error:
            self.error = error

    def check(self) -> None:
        """Raise the first error."""
        self.flush()
        if self.error is not None:
            raise self.error
