"""A live view: a monitor that shows a run in the browser, and hands on what a page asks for."""

import math
import threading
import time
import warnings
from typing import Any, NamedTuple

from jaxplore import _kinds
from jaxplore.control.base import Controller
from jaxplore.parameters import get_parameters
from jaxplore.recorder.switched import SwitchedRecorder
from jaxplore.report.recording import Frame, Recording
from jaxplore.simulation.chunks import CHUNK_SECONDS
from jaxplore.simulation.monitor import Monitor, Requests, Update
from jaxplore.view.display import Display
from jaxplore.view.server import HOST, close_server, link, open_server
from jaxplore.view.sliders import Sliders

FRAME_SECONDS, IDLE_SECONDS = 0.1, 1.0
"""Least time between two frames while a page is open, and without one [s]."""
EARLY = 0.8
"""Share of the time between two frames after which one may come."""
FRAME_SHARE = 0.08
"""Greatest share of the wall-clock time that the loop spends on frames: slow frames come less
often."""
SPEEDS = {
    "as fast as possible": math.inf,
    **{f"{factor:g} x real time": factor for factor in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)},
}
"""Speeds of a simulation that a page can ask for."""
MOST_SEED = 2**32 - 1
RELOAD_SECONDS = 5.0
"""Time after which a page that does not come back counts as closed [s]."""


class _Begin(NamedTuple):
    recording: Recording
    controller: Controller


class _Mail:
    """What the run has told and the view has not shown."""

    def __init__(self) -> None:
        self.begin: _Begin | None = None
        self.pieces: list[tuple[Any, Any]] = []
        self.frames: list[Frame] = []
        self.text = ""
        self.end: Recording | None = None
        self.is_end, self.is_closed = False, False

    def __bool__(self) -> bool:
        return bool(self.begin or self.frames or self.text) or self.is_end or self.is_closed


class LiveView(Monitor):
    """Shows a run in the browser, and hands on what a page asks for.

    The run only puts its newest frame into a box; another thread draws and sends it. Frames that
    come faster than that are skipped. Neither a slow page nor a closed one slows the run.

    A page can move the parameters of the controller, pause the run and take single steps. That of a
    simulation can also set its speed, stop it and ask for another seed.

    Args:
        host: address to listen at; `127.0.0.1` is the own machine.
        port: port; 0 for a free one.
        label: title of the page's panel.
        is_simulation: whether the run is a simulation, and no robot.
        recorder: recorder that a button of the page switches on and off; another monitor of the
            run. There is no button without one.

    Raises:
        ValueError: viser is not installed; an address or a port that cannot be used.
    """

    @_kinds.check_arguments
    def __init__(
        self,
        *,
        host: str = HOST,
        port: int = 0,
        label: str = "jaxplore",
        is_simulation: bool = True,
        recorder: SwitchedRecorder | None = None,
    ) -> None:
        self.recorder = recorder
        self._server = open_server(host, port, label=label)
        self._display = Display(self._server, "Parameters")
        self._sliders: Sliders | None = None
        self._is_paused, self._is_stopped = False, False
        self._single_steps = 0
        self._seed: int | None = None
        self._speed: Any = None
        self._add_buttons(is_simulation=is_simulation)
        # Cost of the last frame for the run [s], and when the run was told to make one.
        self._cost, self._told = 0.0, 0.0
        self._mail, self._news = _Mail(), threading.Condition()
        self._thread = threading.Thread(target=self._work, name="jaxplore view", daemon=True)
        self._thread.start()

    @property
    def link(self) -> str:
        """Address to open in a browser."""
        return link(self._server)

    @property
    def num_pages(self) -> int:
        """Number of open pages."""
        return len(self._server.get_clients())

    def begin(self, recording: Recording, controller: Controller) -> None:
        """Show a run that begins; sliders that were moved stay where they are."""
        self._is_stopped, self._seed, self._single_steps = False, None, 0
        with self._news:
            self._mail = _Mail()
            self._mail.begin = _Begin(recording, controller)
            self._mail.frames = list(recording.frames[-1:])
            self._news.notify()

    def is_due(self, simulated: float, elapsed: float) -> bool:
        """Check whether a frame is due; every one is in a pause, so that the page is exact."""
        # A chunk that ends a little early must not wait for the next one.
        least = EARLY * FRAME_SECONDS if self.num_pages else IDLE_SECONDS
        is_due = elapsed >= max(least, self._cost / FRAME_SHARE) or self._is_paused
        if is_due:
            self._told = time.monotonic()
        return is_due

    def longest_chunk(self, pace: float) -> float:
        """Return the simulated time between two frames; without a page nobody waits for any."""
        return min(pace * FRAME_SECONDS, CHUNK_SECONDS) if self.num_pages else CHUNK_SECONDS

    def show(self, update: Update) -> None:
        """Take an update; a frame that was not drawn yet is skipped."""
        with self._news:
            self._mail.pieces.append((update.records, update.time))
            self._mail.frames = [update.frame]
            self._mail.text = update.text
            self._news.notify()
        self._cost = time.monotonic() - self._told

    def requests(self) -> Requests:
        """Return what the pages ask of the run now."""
        sliders = self._sliders
        return Requests(
            parameters={} if sliders is None else sliders.values(),
            is_paused=self._is_paused,
            single_steps=self._single_steps,
            # A page could send anything.
            speed=math.inf if self._speed is None else SPEEDS.get(self._speed.value, math.inf),
            is_stopped=self._is_stopped,
        )

    def refuse(self, message: str) -> None:
        """Show why a request was not accepted."""
        with self._news:
            self._mail.text = message
            self._news.notify()

    def end(self, recording: Recording | None) -> None:
        """Show the end of the run."""
        with self._news:
            self._mail.is_end = True
            if recording is None:
                self._mail.text = "the run failed"
            else:
                self._mail.frames = list(recording.frames[-1:])
                self._mail.end = recording
                how = "stopped" if recording.is_interrupted else "finished"
                self._mail.text = f"{how} after {recording.time[-1]:.1f} s"
            self._news.notify()

    def seed_request(self) -> int | None:
        """Return the seed with which a page has asked to start again; None if none has."""
        return self._seed

    def wait_for_restart(self) -> int | None:
        """Wait while pages are open.

        Returns:
            The seed with which a page asks to start again; None if the last page was closed or
            one asked to stop.
        """
        seen = time.monotonic() if self.num_pages else -math.inf
        while self._seed is None and not self._is_stopped:
            now = time.monotonic()
            seen = now if self.num_pages else seen
            if now - seen > RELOAD_SECONDS:
                break
            time.sleep(FRAME_SECONDS)
        return self._seed

    def close(self) -> None:
        """Stop the server; open pages lose their connection, and a recording ends."""
        if self.recorder is not None:
            self.recorder.on_change = lambda: None
            self.recorder.stop()
        with self._news:
            self._mail.is_closed = True
            self._news.notify()
        self._thread.join()
        close_server(self._server)

    def _add_buttons(self, *, is_simulation: bool) -> None:
        gui, display = self._server.gui, self._display
        with display.buttons:
            pause = gui.add_button("Pause")
            step = gui.add_button("Single step", hint="in a pause: one control period")

        def toggle(_: Any) -> None:
            self._is_paused = not self._is_paused
            pause.label = "Continue" if self._is_paused else "Pause"

        def take_step(_: Any) -> None:
            if not self._is_paused:
                toggle(None)
            self._single_steps += 1

        pause.on_click(toggle)
        step.on_click(take_step)
        if is_simulation:
            self._add_simulation_buttons()
        display.add_picture_button()
        if self.recorder is not None:
            self._add_record_button(self.recorder)
        with display.tabs["Parameters"]:
            gui.add_button("Reset all").on_click(self._reset)

    def _add_simulation_buttons(self) -> None:
        gui = self._server.gui
        with self._display.buttons:
            self._speed = gui.add_dropdown("Speed", tuple(SPEEDS), initial_value=next(iter(SPEEDS)))
            seed: Any = gui.add_number("Seed", initial_value=1, min=0, max=MOST_SEED, step=1)
            again = gui.add_button("Restart", hint="the same settings with this seed")
            stop = gui.add_button("Stop", hint="end the run and save it", color="red")

        def restart(_: Any) -> None:
            # The seed is set first: the run looks at both.
            self._seed = min(max(int(seed.value), 0), MOST_SEED)
            seed.value = min(self._seed + 1, MOST_SEED)
            self._is_stopped = True

        def end(_: Any) -> None:
            self._is_stopped = True

        again.on_click(restart)
        stop.on_click(end)

    def _add_record_button(self, recorder: SwitchedRecorder) -> None:
        gui = self._server.gui
        with self._display.buttons:
            button = gui.add_button("Record", hint="to an MCAP file, for Foxglove")
            told: Any = gui.add_text("Recording", initial_value="", multiline=True, disabled=True)

        # The run and a page may tell of a change at once: the newer state is shown last.
        showing = threading.Lock()

        def show() -> None:
            with showing:
                button.label = "Stop recording" if recorder.is_on else "Record"
                told.value = recorder.message

        def switch(_: Any) -> None:
            try:
                if recorder.is_on:
                    recorder.stop()
                else:
                    recorder.start()
            except ValueError as error:
                told.value = str(error)

        button.on_click(switch)
        recorder.on_change = show

    def _reset(self, _: Any) -> None:
        if self._sliders is not None:
            self._sliders.reset()

    def _work(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: bool(self._mail))
                mail, self._mail = self._mail, _Mail()
            if mail.is_closed:
                return
            try:
                self._deliver(mail)
            except Exception as error:  # the run goes on without its view
                warnings.warn(
                    f"the view could not show a frame: {type(error).__name__}: {error}",
                    stacklevel=1,
                )

    def _deliver(self, mail: _Mail) -> None:
        display = self._display
        if mail.begin is not None:
            display.begin(mail.begin.recording)
            self._make_sliders(mail.begin.controller)
        assert display.history is not None
        for records, times in mail.pieces:
            display.history.add(records, times)
        if mail.end is not None:
            display.history.catch_up(mail.end)
        for frame in mail.frames:
            display.history.add_frame(frame)
            display.draw(frame, mail.text)
        if mail.text and not mail.frames:
            display.tell(mail.text)
        display.draw_curves(at_once=mail.is_end)

    def _make_sliders(self, controller: Controller) -> None:
        """Make the sliders of a controller, unless they are there: a restart keeps their values."""
        parameters = get_parameters(controller)
        if self._sliders is not None:
            if self._sliders.fit(parameters):
                return
            self._sliders.remove()
        self._sliders = Sliders(self._server, self._display.tabs["Parameters"], parameters)
