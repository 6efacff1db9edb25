"""Finished runs in the browser, with a slider of time."""

import time
from bisect import bisect_right
from typing import Any

import numpy as np

from jaxplore.report.recording import Recording
from jaxplore.view.display import Display
from jaxplore.view.history import MOST_POINTS
from jaxplore.view.server import HOST, close_server, link, open_server

TICK_SECONDS = 0.05
"""Time between two looks at the slider [s]."""
SPEEDS = {f"{factor:g} x real time": factor for factor in (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)}
"""Speeds of playback, as multiples of real time."""
LONGEST_FILM = 20.0
"""Greatest duration of a playback at the speed that is chosen first [s]."""


class Replay:
    """Shows a finished run in the browser.

    Args:
        recording: the run.
        host: address to listen at; `127.0.0.1` is the own machine.
        port: port; 0 for a free one.
        label: title of the page's panel.

    Raises:
        ValueError: a run without frames; one whose parts do not fit together, as in a run folder
            that was changed; viser is not installed; an address or a port that cannot be used.
    """

    def __init__(
        self, recording: Recording, *, host: str = HOST, port: int = 0, label: str = "jaxplore"
    ) -> None:
        if not recording.frames:
            raise ValueError("recording has no frames; accepted: a run with frames")
        self._frames = recording.frames
        self._times = [frame.time for frame in self._frames]
        self._server = open_server(host, port, label=label)
        self._shown = -1
        try:
            self._display = Display(self._server)
            self._display.begin(recording)
            self._positions = getattr(recording, "positions", np.zeros((0, 2)))
            self._add_controls()
            self._draw(0)
            self._display.draw_curves(at_once=True)
        except (ValueError, TypeError, LookupError, AttributeError, AssertionError) as error:
            close_server(self._server)
            reason = " ".join(str(error).split())
            raise ValueError(
                f"recording cannot be drawn ({reason}); accepted: a run as Run.save writes it"
            ) from None

    @property
    def link(self) -> str:
        """Address to open in a browser."""
        return link(self._server)

    def tick(self, elapsed: float) -> None:
        """Draw what the slider asks for.

        Args:
            elapsed: time since the last call [s], by which a playback advances.
        """
        if self._play.value:
            end = self._times[-1]
            now = min(self._slider.value + SPEEDS.get(self._speed.value, 1.0) * elapsed, end)
            self._slider.value = now
            if now >= end:
                self._play.value = False
        # A page could send anything.
        now = min(max(self._slider.value, self._times[0]), self._times[-1])
        index = bisect_right(self._times, now + 1e-9) - 1
        if index != self._shown:
            self._draw(index)

    def serve(self) -> None:
        """Show the run until Ctrl-C."""
        before = time.monotonic()
        while True:
            time.sleep(TICK_SECONDS)
            now = time.monotonic()
            self.tick(now - before)
            before = now

    def close(self) -> None:
        """Stop the server; open pages lose their connection."""
        close_server(self._server)

    def _add_controls(self) -> None:
        gui, first, last = self._server.gui, self._times[0], self._times[-1]
        names = tuple(SPEEDS)
        enough = [name for name in names if (last - first) / SPEEDS[name] <= LONGEST_FILM]
        with self._display.buttons:
            step = max((last - first) / 1000.0, 1e-3)
            self._slider: Any = gui.add_slider(
                "Time [s]", min=first, max=max(last, first + step), step=step, initial_value=first
            )
            self._play: Any = gui.add_checkbox("Play", initial_value=False)
            self._speed = gui.add_dropdown("Speed", names, initial_value=[*enough, names[-1]][0])
            again = gui.add_button("Play from the start")

        def play(_: object) -> None:
            self._slider.value = first
            self._play.value = True

        again.on_click(play)
        self._display.add_picture_button()

    def _draw(self, index: int) -> None:
        frame = self._frames[index]
        trail = self._positions[: frame.step + 1]
        thinned = trail[:: -(-len(trail) // MOST_POINTS)] if len(trail) else trail
        self._display.draw(frame, f"frame {index + 1} of {len(self._frames)}", thinned)
        self._shown = index
