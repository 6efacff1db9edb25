"""Views in the browser, of runs that go on and of finished ones."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from jaxplore.cli._pictures import Pictures
from jaxplore.cli._show import free_name, save
from jaxplore.cli._terminal import say
from jaxplore.cli._view_options import HOST
from jaxplore.parameters import find_parameter, get_parameters, set_parameters
from jaxplore.recorder import McapRecorder, SwitchedRecorder
from jaxplore.settings.sections import RunSettings
from jaxplore.simulation.monitor import Monitor
from jaxplore.simulation.run import Run, simulate
from jaxplore.tasks.registry import build
from jaxplore.view import LiveView, Replay, is_public

type Values = Mapping[str, float | list[float]]
"""Values of parameters by path."""


def open_view(
    view: bool | None,
    view_port: int | None,
    host: str | None,
    *,
    folder: Path,
    began: float | None = None,
) -> LiveView:
    """Open a live view and print its link.

    Its button records to files beside the run folder, whose name is the title of the page's panel.
    Without a port it takes a free one, without a host the address of this machine. `began` is the
    start of a robot's drive since the epoch [s]; None for a simulation, which has a speed and can
    be started again. An option of a view without --view raises a `ValueError`.
    """
    if not view:
        name, value = ("--host", host) if view_port is None else ("--view-port", view_port)
        raise ValueError(f"{name} is {value} without --view; accepted: with --view")
    where, whole = HOST if host is None else host, folder.resolve()
    opened = LiveView(
        host=where,
        port=0 if view_port is None else view_port,
        label=folder.name,
        is_simulation=began is None,
        recorder=SwitchedRecorder(whole.parent, name=whole.name, began=began or 0.0),
    )
    _tell(opened.link, where, "drive the sliders")
    return opened


def monitors_of(view: LiveView) -> list[Monitor]:
    """Return the monitors of a run that a view shows: the view, and the recorder of its button."""
    return [view] if view.recorder is None else [view, view.recorder]


def tell_recording(view: LiveView) -> None:
    """Print where the button of a view has recorded to, if it has."""
    if view.recorder is not None and view.recorder.path is not None:
        say(view.recorder.message, err=True)


def run_viewed(
    view: LiveView,
    settings: RunSettings,
    folder: Path,
    pictures: Pictures,
    recorder: McapRecorder | None,
    *,
    overwrite: bool,
) -> None:
    """Simulate runs until the page of a view asks for no further one.

    A run that ends or is stopped is saved in a folder of its own, one that is started again is not.
    The first one is recorded, if there is a recorder; a recording that failed raises a `ValueError`
    when the run is saved.
    """
    changed: dict[str, float | list[float]] = {}
    shown: list[Monitor] = monitors_of(view)
    monitors = shown if recorder is None else [*shown, recorder]
    while True:
        experiment = build(settings)
        # What the sliders have set holds from the first step of a further run.
        controller = set_parameters(experiment.controller, changed)
        run = simulate(
            controller, *experiment[1:3], key=experiment.key, progress=True, monitors=monitors
        )
        monitors = shown
        tell_recording(view)
        changed.update(run.parameters)
        seed = view.seed_request()
        if seed is None:
            _show_changes(get_parameters(experiment.controller), changed)
            kept = _with_changes(settings, controller, changed)
            save(run, folder, kept, pictures, overwrite=overwrite)
            if recorder is not None and recorder.failure is not None:
                raise ValueError(recorder.failure)
            seed = _wait(view)
            if seed is None:
                return
            folder, overwrite = free_name(folder), False
            # The video of the first run is kept.
            pictures = pictures._replace(video=None)
        else:
            say(f"Not saved: the run with seed {settings.seed}, started again.", err=True)
        settings = settings.model_copy(update={"seed": seed})


def show_folder(folder: Path, port: int, host: str | None) -> None:
    """Show a run folder in the browser until Ctrl-C."""
    where = HOST if host is None else host
    replay = Replay(Run.load(folder).recording, host=where, port=port, label=folder.resolve().name)
    _tell(replay.link, where, "look at it")
    try:
        replay.serve()
    except KeyboardInterrupt:
        # The way to end it.
        replay.close()


def _wait(view: LiveView) -> int | None:
    if view.num_pages:
        say("The view stays open until its page is closed, or Ctrl-C.", err=True)
    try:
        return view.wait_for_restart()
    except KeyboardInterrupt:
        # The run is saved: nothing was interrupted.
        return None


def _with_changes(settings: RunSettings, controller: Any, changed: Values) -> RunSettings:
    """Return settings with the parameters that were changed during the run."""
    # A path may be abbreviated: an old value must not override a new one.
    others = {
        path: value
        for path, value in settings.parameters.items()
        if find_parameter(controller, path) not in changed
    }
    return settings.model_copy(update={"parameters": {**others, **changed}})


def _show_changes(before: Mapping[str, Any], after: Values) -> None:
    for path, value in after.items():
        old = np.asarray(before[path]).tolist()
        if not np.array_equal(np.asarray(old, np.float32), np.asarray(value, np.float32)):
            say(f"Changed during the run: {path} {_text(old)} -> {_text(value)}", err=True)


def _text(value: float | list[float]) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_text, value))}]"
    return f"{value:g}"


def _tell(link: str, host: str, act: str) -> None:
    say(f"View: {link}", err=True)
    if is_public(host):
        say(
            f"jaxplore: warning: --host is {host}: anybody in the network can open the view and "
            f"{act}",
            err=True,
        )
