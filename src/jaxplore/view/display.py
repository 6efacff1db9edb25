"""The page of a view: a scene, curves, and a panel whose other parts are added by its owner."""

import io
import threading
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxplore.maps.datum import ORIGIN, Datum, move_points
from jaxplore.report.recording import Frame, Recording
from jaxplore.scenes.picture import PictureScene
from jaxplore.scenes.scene import Scene
from jaxplore.tasks.registry import how_shown
from jaxplore.view.history import History, plain
from jaxplore.view.rollouts import RolloutColours

if TYPE_CHECKING:
    import viser
import time

from jaxplore.report.drawing.colours import SERIES
from jaxplore.view.history import Plot

SECONDS = 0.5
"""Least time between two updates of the curves [s]."""
HEIGHT = 190
"""Height of a figure [pixels]."""


class Curves:
    """The figures of a panel; a click on a name in the legend hides its curve."""

    def __init__(self, server: "viser.ViserServer", container: Any) -> None:
        self._server, self._container = server, container
        self._figures: dict[tuple[str, ...], Any] = {}
        self._at = -np.inf

    def is_due(self) -> bool:
        """Check whether the curves may be drawn again."""
        return time.monotonic() - self._at >= SECONDS

    def draw(self, plots: tuple[Plot, ...]) -> None:
        """Draw plots; one without two rows waits."""
        self._at = time.monotonic()
        for plot in plots:
            if len(plot.rows) < 2:
                continue
            data = tuple(np.ascontiguousarray(column) for column in plot.rows.T)
            key = (plot.title, *plot.names)
            if key in self._figures:
                self._figures[key].data = data
                continue
            series: list[Any] = [{"label": "time [s]"}]
            for i, name in enumerate(plot.names):
                series.append({"label": name, "stroke": SERIES[i % len(SERIES)], "width": 2})
            with self._container:
                self._figures[key] = self._server.gui.add_uplot(
                    data,
                    tuple(series),
                    title=plot.title,
                    scales={"x": {"time": False}},
                    height=HEIGHT,
                )

    def clear(self) -> None:
        """Remove all figures."""
        for figure in self._figures.values():
            figure.remove()
        self._figures.clear()
        self._at = -np.inf


class Display:
    """The page of a view.

    The first tab of its panel tells the time and the progress; `run_tab` is the place for buttons.
    The given tabs follow. The last tab shows and hides layers. The curves stand below all tabs.
    """

    def __init__(self, server: "viser.ViserServer", *tabs: str) -> None:
        gui = server.gui
        self.server = server
        self.history: History | None = None
        self._scene: Scene | None = None
        self._frame: Frame | None = None
        # Pages draw in single precision: what they show is relative to it.
        self._datum = ORIGIN
        # A page may choose other colours while a frame is drawn.
        self._drawing = threading.RLock()
        group = gui.add_tab_group()
        self.run_tab: Any = group.add_tab("Run")
        self.tabs: dict[str, Any] = {name: group.add_tab(name) for name in tabs}
        self._layers_tab: Any = group.add_tab("Layers")
        with self.run_tab:
            self._time: Any = gui.add_text("Time", initial_value="", disabled=True)
            self._progress: Any = gui.add_text("Progress", initial_value="", disabled=True)
            self._rollouts = RolloutColours(server, self._recolour)
            self.buttons: Any = gui.add_folder("Control")
        # Not in a tab: a page that changes tabs makes plots anew, and viser then shows their first
        # second, until somebody moves the axis.
        self._curves = Curves(server, gui.add_folder("Curves"))
        self._layers: list[Any] = []

    def begin(self, recording: Recording) -> None:
        """Show another run, with or without steps."""
        self._curves.clear()
        positions: Any = getattr(recording, "positions", None)
        self.history = History(recording)
        with self._drawing:
            if self._scene is not None:
                self._scene.clear()
            self._datum = ORIGIN
            shown = how_shown(recording)
            if shown.is_relative:
                self._datum = Datum.near(*positions[0].tolist())
            local = recording.move(-self._datum.offset)
            self._scene, self._frame = shown.scene(self.server, local), None
            self._rollouts.offer(next(iter(recording.frames), None))
        self._list_layers(self._scene)

    def draw(self, frame: Frame, text: str, trail: np.ndarray | None = None) -> None:
        """Draw a frame and the progress in words; a trail of None is that of the history."""
        assert self._scene is not None
        assert self.history is not None
        # Pages show all of it at once.
        with self._drawing, self.server.atomic():
            self._frame = frame
            if isinstance(self._scene, PictureScene):
                self._scene.recording = self.history.recording_at(frame)
            trail = self.history.trail if trail is None else trail
            self._scene.draw(self._to_view(frame), move_points(trail, -self._datum.offset))
            self._draw_rollouts()
            self._time.value = f"{frame.time:.2f} s"
            self._progress.value = plain(text)

    def _draw_rollouts(self) -> None:
        frame: Any = self._frame
        if self._scene is not None and frame is not None and "rollouts" in self._scene.layers:
            self._scene.rollouts(self._to_view(frame).samples, self._rollouts.colours(frame))

    def _to_view(self, frame: Frame) -> Any:
        """Return a frame relative to the datum of the view."""
        names = getattr(self.history.recording, "state_names", ()) if self.history else ()
        return frame.move(-self._datum.offset, names)

    def _recolour(self) -> None:
        """Draw the rollouts of the frame that is shown in the colours that a page has chosen."""
        with self._drawing, self.server.atomic():
            self._draw_rollouts()

    def draw_curves(self, *, at_once: bool = False) -> None:
        """Draw the curves, unless that was a moment ago."""
        assert self.history is not None
        if at_once or self._curves.is_due():
            self._curves.draw(self.history.plots())

    def tell(self, text: str) -> None:
        """Show a message in place of the progress."""
        self._progress.value = plain(text)

    def picture(self) -> tuple[str, bytes] | None:
        """Return a file name and a PNG of the frame that is shown, drawn as in the animation; None
        before the first frame."""
        if self._frame is None or self.history is None:
            return None
        recording = self.history.recording_at(self._frame)
        stream = io.BytesIO()
        recording.frame_image(self._frame, scale=2.0).save(stream, "PNG")
        return f"jaxplore-{self._frame.time:.2f}s.png", stream.getvalue()

    def add_picture_button(self) -> None:
        """Add a button that downloads a picture."""
        with self.buttons:
            button = self.server.gui.add_button("Save picture", hint="PNG of the frame")

        def save(event: Any) -> None:
            made = self.picture()
            if made is not None and event.client is not None:
                event.client.send_file_download(*made, save_immediately=True)

        button.on_click(save)

    def _list_layers(self, scene: Scene) -> None:
        """List the layers of the scene; those that were hidden before stay hidden."""
        known = {each.label: each for each in self._layers}
        if list(known) != list(scene.layers):
            for each in self._layers:
                each.remove()
            with self._layers_tab:
                self._layers = [
                    self.server.gui.add_checkbox(name, initial_value=True) for name in scene.layers
                ]
            for box in self._layers:
                box.on_update(self._show_layer)
        for box in self._layers:
            scene.show(box.label, is_shown=box.value)

    def _show_layer(self, event: Any) -> None:
        if self._scene is not None:
            self._scene.show(event.target.label, is_shown=event.target.value)
