"""What a view keeps of a run so far: the trail, the curves and the records."""

import dataclasses
import re
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxplore.report.recording import Frame, Recording
from jaxplore.simulation.record_buffer import RecordBuffer

MOST_POINTS = 2000
"""Greatest number of points of the trail."""
MOST_SAMPLES = 500
"""Greatest number of samples of a curve."""
LONGEST_NAME = 60
"""Longest name that is shown [characters]."""


class Plot(NamedTuple):
    """Curves over time in one figure; the title tells the unit.

    Each of the `rows` (N, 1 + K) has the time [s] and the value of each curve.
    """

    title: str
    names: tuple[str, ...]
    rows: np.ndarray


class Thinned:
    """Rows that arrive one after the other; evenly spaced ones, at most `most`, are kept."""

    def __init__(self, width: int, most: int) -> None:
        self._kept = np.zeros((0, width))
        self._newest = self._kept
        self._most, self._stride, self._count = most, 1, 0

    def add(self, rows: np.ndarray) -> None:
        """Append rows (N, width)."""
        if not len(rows):
            return
        kept = rows[-self._count % self._stride :: self._stride]
        self._kept = np.concatenate([self._kept, kept])
        self._count += len(rows)
        self._newest = rows[-1:]
        while len(self._kept) > self._most:
            self._kept, self._stride = self._kept[::2], self._stride * 2

    @property
    def rows(self) -> np.ndarray:
        """Rows that are kept, the newest one included."""
        if (self._count - 1) % self._stride == 0:
            return self._kept
        return np.concatenate([self._kept, self._newest])


class History:
    """What a view keeps of a run so far; steps that the recording already has are included."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self._records = RecordBuffer(_none_of(recording.records))
        self._curve: Thinned | None = None
        self._terms: Thinned | None = None
        self._term_names = tuple[str, ...]()
        self._state = getattr(recording, "start", None)
        start: Any = recording
        first = dataclasses.replace(start, records=_none_of(recording.records))
        self._curves = first.live_curves
        if self._curves is not None:
            self._curve = Thinned(1 + len(self._curves.names), MOST_SAMPLES)
        # A task may have no positions.
        place = getattr(first, "positions", np.zeros((0, 2)))
        self._trail = Thinned(place.shape[1], MOST_POINTS)
        self._trail.add(place[:1])
        self.add(recording.records, recording.time[1:])
        for frame in recording.frames:
            self.add_frame(frame)

    @property
    def trail(self) -> np.ndarray:
        """Positions (N, 2) of the robot so far [m], (N, 3) in a volume; none where the task has no
        positions."""
        return self._trail.rows

    def add(self, records: Any, time: np.ndarray) -> None:
        """Append the records of steps and the time after each of them [s]."""
        if not len(time):
            return
        self._records.append(records)
        run: Any = self.recording
        begin = {} if self._state is None else {"start": self._state}
        part = dataclasses.replace(run, records=records, **begin)
        if hasattr(part, "positions"):
            self._trail.add(part.positions[1:])
        curves = part.live_curves
        if self._curve is not None and curves is not None:
            rows = np.stack([time, *curves.values], axis=-1)
            self._curve.add(rows.astype(np.float64))
        if self._state is not None and hasattr(records, "state"):
            self._state = records.state[-1]

    def catch_up(self, recording: Recording) -> None:
        """Append the steps of the whole run that were not added yet."""
        done = self._records.num_rows
        rest = jax.tree.map(lambda rows: rows[done:], recording.records)
        self.add(rest, recording.time[1 + done :])

    def add_frame(self, frame: Frame) -> None:
        """Note the cost terms of the plan, where the frame has them."""
        terms = getattr(frame, "terms", {})
        if not terms:
            return
        if self._terms is None:
            self._term_names = tuple(terms)
            self._terms = Thinned(1 + len(terms), MOST_SAMPLES)
        # The frame at the start comes with the recording and as the first one to draw.
        is_new = not len(self._terms.rows) or frame.time > self._terms.rows[-1, 0]
        if is_new and tuple(terms) == self._term_names:
            self._terms.add(np.array([[frame.time, *map(float, terms.values())]]))

    def plots(self) -> tuple[Plot, ...]:
        """Return the curves so far."""
        found = []
        if self._curve is not None and self._curves is not None:
            found.append(Plot(self._curves.title, self._curves.names, self._curve.rows))
        if self._terms is not None:
            names = tuple(map(plain, self._term_names))
            found.append(Plot("cost of the plan by term", names, self._terms.rows))
        return tuple(found)

    def recording_at(self, frame: Frame) -> Recording:
        """Return the recording of the run so far with one frame, for pictures of it."""
        return dataclasses.replace(self.recording, records=self._records.rows(), frames=(frame,))


def _none_of(records: Any) -> Any:
    return jax.tree.map(lambda rows: rows[:0], records)


def plain(name: str) -> str:
    """Return a name without characters that a page could take for markup.

    Names of costs may come from a file that nobody has looked at.
    """
    return re.sub(r"[^\w .,:/()+*%^\[\]-]", "?", name)[:LONGEST_NAME]
