"""Frames of a drive at even times."""

from collections.abc import Callable
from typing import Any

from jaxplore.simulation.chunks import are_too_many

FRAME_SECONDS = 0.5
"""Time between two frames at the start [s]."""


class EvenFrames:
    """Frames for an animation of a drive whose length nobody knows.

    The time between them doubles with the frames that are dropped, so they stay evenly spaced.
    """

    def __init__(self) -> None:
        self._frames: list[Any] = []
        self._last: Any = None
        self._period, self._next = FRAME_SECONDS, 0.0

    @property
    def all(self) -> tuple[Any, ...]:
        """All frames, the last one at the end."""
        return (*self._frames, *(() if self._last is None else (self._last,)))

    def add_when_due(self, time: float, make: Callable[[], Any]) -> None:
        """Make a frame if it is time for one.

        Args:
            time: time since the start [s].
            make: function that makes a frame.
        """
        if time < self._next:
            return
        self._frames.append(make())
        if are_too_many(self._frames):
            self._frames, self._period = self._frames[::2], 2.0 * self._period
        self._next = time + self._period

    def add_last(self, frame: Any) -> None:
        """Add the frame of the end."""
        self._last = frame
