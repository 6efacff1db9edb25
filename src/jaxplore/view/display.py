"""The page of a view: a scene, curves, colours of rollouts, and a panel for further parts."""

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

if TYPE_CHECKING:
    import viser
import time
from collections.abc import Callable

from jaxplore.report.drawing.colours import FREE, SERIES, blend
from jaxplore.report.drawing.palette import FAINT, STRONG, Colour
from jaxplore.report.drawing.rollout_costs import (
    COST_COLOURS,
    NOT_FINITE,
    WEIGHT,
    cost_colours,
    cost_names,
    cost_range,
    costs_of_rollouts,
)
from jaxplore.report.drawing.shapes import STRONG_SHARE
from jaxplore.view.history import Plot

FAINT_SHARE, BOLD_SHARE = 0.4, 0.95
"""Opacities of rollouts without weight and of those of great weight."""
SECONDS = 0.5
"""Least time between two updates of the curves [s]."""
HEIGHT = 190
"""Height of a figure [pixels]."""


class RolloutColours:
    """The choice of what colours the rollouts, and a legend with the range of the costs.

    `on_change` is called when a page has chosen something else.
    """

    def __init__(self, server: "viser.ViserServer", on_change: Callable[[], None]) -> None:
        gui = server.gui
        self._names = {WEIGHT: WEIGHT}
        self._choice: Any = gui.add_dropdown(
            "Colour rollouts by", (WEIGHT,), initial_value=WEIGHT, hint="darker: heavier or cheaper"
        )
        self._legend: Any = gui.add_html("")
        self._choice.on_update(lambda _: on_change())

    def offer(self, frame: Any) -> None:
        """Offer what a frame knows of its rollouts; a choice that is still offered stays."""
        names = {WEIGHT: WEIGHT}
        for name in cost_names(frame):
            label = plain(name)
            # Long names may begin alike.
            while label in names:
                label += "*"
            names[label] = name
        self._names = names
        if tuple(self._choice.options) != tuple(names):
            self._choice.options = tuple(names)
        has_rollouts = np.size(getattr(frame, "samples", ())) > 0
        self._choice.visible = self._legend.visible = has_rollouts

    def colours(self, frame: Any) -> np.ndarray:
        """Return the colours (S, 3) of the rollouts of a frame, and write their legend."""
        # A page could send anything.
        name = self._names.get(self._choice.value, WEIGHT)
        if name == WEIGHT or not cost_names(frame):
            known = len(self._names) > 1
            self._write("" if known else _note("This controller tells no costs of its rollouts."))
            return weight_colours(frame.weights)
        costs = costs_of_rollouts(frame, name)
        self._write(legend(costs))
        return cost_colours(costs)

    def _write(self, text: str) -> None:
        if self._legend.content != text:
            self._legend.content = text


def legend(costs: np.ndarray) -> str:
    """Return the legend of costs (S,) as HTML: the colours between the least and the greatest."""
    ends = cost_range(costs)
    if ends is None:
        return _note("No cost is finite.")
    low, high = (f"{each:.4g}" for each in ends)
    colours = ", ".join(map(_css, COST_COLOURS))
    bar = f"height:0.7em; border-radius:0.2em; background:linear-gradient(to right, {colours})"
    row = "display:flex; justify-content:space-between"
    rest = int(np.sum(~np.isfinite(costs)))
    more = _note(f"{rest} not finite", _css(NOT_FINITE)) if rest else ""
    return (
        f'<div style="padding:0 1em; font-size:0.85em"><div style="{bar}"></div>'
        f'<div style="{row}"><span>{low}</span><span>{high}</span></div></div>{more}'
    )


def _note(text: str, colour: str = "inherit") -> str:
    return f'<div style="padding:0 1em; font-size:0.85em; color:{colour}">{text}</div>'


def _css(colour: Colour) -> str:
    return f"rgb{tuple(colour[:3])}"


def weight_colours(weights: np.ndarray) -> np.ndarray:
    """Return the colours (S, 3) of rollouts by their weights (S,), of which NaN counts as 0.

    Below a share of the greatest weight they are faint. From there on the colour follows the
    weight, up to strong.
    """
    known = np.nan_to_num(weights)
    greatest = max(float(known.max(initial=0.0)), 1e-30)
    share = np.clip(known / greatest, 0.0, 1.0)
    # A weight at the bound between faint and bold lines of the animation is seen as well.
    level = np.where(share >= STRONG_SHARE, 0.4 + 0.6 * np.sqrt(share), 0.0)[:, None]
    faint, strong = (
        np.asarray(blend(each, FREE, opacity))
        for each, opacity in ((FAINT, FAINT_SHARE), (STRONG, BOLD_SHARE))
    )
    return np.asarray(((1.0 - level) * faint + level * strong).round(), np.uint8)


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
