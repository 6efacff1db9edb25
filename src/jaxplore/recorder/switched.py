"""A recorder that is switched on and off while a run goes on."""

import dataclasses
import os
import time
from collections.abc import Callable
from pathlib import Path

from jaxplore import _checks, _kinds
from jaxplore._optional import import_optional
from jaxplore.control.base import Controller
from jaxplore.recorder.recorder import SUFFIX, McapRecorder
from jaxplore.report.folder import in_one_line
from jaxplore.report.recording import Recording
from jaxplore.simulation.chunks import CHUNK_SECONDS
from jaxplore.simulation.monitor import WATCHED_SECONDS, Monitor, Requests, Update
from jaxplore.topics.messages import EXTRA

NAME = "recording"
"""First part of the names of files."""


class SwitchedRecorder(Monitor):
    """Records parts of a run to MCAP files, from `start` to `stop`.

    Each file is whole: it begins with the world, and has the steps and frames from then on, up to a
    tenth of a simulated second before `stop`. The end of the run ends a recording as well, with
    all steps unless the run fails. Until then the file has a hidden name.

    `start` and `stop` may be called from any thread; the run does it at its next step. Switched
    off, the recorder costs nothing.

    Args:
        folder: folder of the files, which is made when it is missing.
        name: first part of the names of files; the time of the start follows.
        began: time of the start of the run since the epoch [s]; 0 for simulated time.

    Raises:
        ValueError: an argument of another type; a name with a slash; a negative time.
    """

    @_kinds.check_arguments
    def __init__(
        self, folder: str | os.PathLike[str] = "runs", *, name: str = NAME, began: float = 0.0
    ) -> None:
        _kinds.instance("name", name, str)
        if not name or Path(name).name != name or "\0" in name:
            raise ValueError(f"name is {name!r}; accepted: the first part of a file name")
        self.path: Path | None = None
        """File of the present or the last recording; None before the first."""
        self.on_change: Callable[[], None] = lambda: None
        """Called when the state has changed, in the thread of the run or of `start` and `stop`."""
        self._folder, self._name = Path(folder), name
        self._began = _checks.number("began", began, at_least=0.0)
        self._is_wanted, self._result = False, ""
        self._recorder: McapRecorder | None = None
        self._run: tuple[Recording, Controller] | None = None

    @property
    def is_on(self) -> bool:
        """Whether it records, or will with the next step."""
        return self._is_wanted

    @property
    def message(self) -> str:
        """State of the recording in one line, with its path; empty before the first."""
        if self._recorder is not None:
            return f"Recording to {self._recorder.path}"
        return "Recording starts with the next step." if self._is_wanted else self._result

    def start(self) -> None:
        """Record from the next step on.

        Raises:
            ValueError: no run goes on; a missing `foxglove-sdk`.
        """
        import_optional("foxglove", EXTRA)
        if self._run is None:
            raise ValueError("no run goes on; accepted: to record while one does")
        self._is_wanted = True
        self.on_change()

    def stop(self) -> None:
        """End the recording: the run puts the file in its place."""
        self._is_wanted = False
        self.on_change()

    def begin(self, recording: Recording, controller: Controller) -> None:
        """Take note of a run that begins."""
        self._run = recording, controller

    def is_due(self, simulated: float, elapsed: float) -> bool:
        """Check whether a recording begins, or its next frame is due."""
        if self._recorder is None:
            return self._is_wanted
        return self._recorder.is_due(simulated, elapsed)

    def longest_chunk(self, pace: float) -> float:
        """Return the longest time between two frames of a recording; the longest without one."""
        return WATCHED_SECONDS if self._is_wanted else CHUNK_SECONDS

    def show(self, update: Update) -> None:
        """Begin the recording with the first update, and write the following ones."""
        if self._recorder is not None:
            self._recorder.show(update)
        elif self._is_wanted:
            try:
                self._open(update)
            except ValueError as error:
                # The run is worth more than its recording.
                self._is_wanted, self._result = False, " ".join(str(error).split())
            self.on_change()

    def requests(self) -> Requests:
        """Close a recording that was stopped, also in a pause; nothing is asked of the run."""
        if not self._is_wanted:
            self._close()
        return Requests()

    def end(self, recording: Recording | None) -> None:
        """Write the rest of the run and close the file; without the rest if the run failed."""
        self._run, self._is_wanted = None, False
        self._close(recording)
        self.on_change()

    def _open(self, update: Update) -> None:
        assert self._run is not None
        blank, controller = self._run
        with in_one_line("recording", self._folder):
            self._folder.mkdir(parents=True, exist_ok=True)
        recorder = McapRecorder(self._free_path(), began=self._began)
        recorder.begin(dataclasses.replace(blank, frames=(update.frame,)), controller)
        self._recorder, self.path = recorder, recorder.path

    def _close(self, recording: Recording | None = None) -> None:
        if self._recorder is None:
            return
        recorder = self._recorder
        if recording is None:
            recorder.stop()
        else:
            recorder.end(recording)
        self._result = recorder.failure or f"Recorded to {recorder.path}"
        self._recorder = None
        self.on_change()

    def _free_path(self) -> Path:
        """Return a path by the present time at which there is no file yet."""
        first = f"{self._name}-{time.strftime('%Y%m%d-%H%M%S')}"
        path, number = self._folder / f"{first}{SUFFIX}", 1
        while path.exists():
            number += 1
            path = self._folder / f"{first}-{number}{SUFFIX}"
        return path
