"""Writing of run folders."""

import contextlib
import json
from collections.abc import Callable, Mapping, Sequence
from os import PathLike

import numpy as np
import yaml

from jaxplore._signals import is_ending
from jaxplore.report.drawing.figure import PNG, figure_formats, write_figure
from jaxplore.report.drawing.film import FilmOptions
from jaxplore.report.folder import MARK, run_folder
from jaxplore.report.metrics import Metrics
from jaxplore.report.recording import Recording
from jaxplore.report.recording_arrays import NAME as STATE
from jaxplore.report.recording_arrays import pack_recording

BEFORE_ANIMATION = 0.2
"""Share of the progress bar for everything but the animation, which takes longest."""


def save_run(
    recording: Recording,
    metrics: Metrics,
    path: str | PathLike[str],
    *,
    settings: Mapping[str, object] | None = None,
    animation: bool = True,
    film: FilmOptions | None = None,
    figures: str | Sequence[str] = PNG,
    overwrite: bool = False,
    on_progress: Callable[[float], None] = lambda _: None,
    further: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write a run folder, completely or not at all.

    It holds `metrics.json`, `arrays.npz`, `state.npz` for `load_run`, the figures and further files
    of the recording, its animation, and `settings.yaml` if there are settings. There is no
    `state.npz` if the recording holds something else than arrays, numbers and texts. `further` are
    more arrays for it.

    The animation takes most of the time, so Ctrl-C, SIGTERM and SIGHUP leave it out. `on_progress`
    is called with the share that is done, from 0 to 1.
    """
    kinds = figure_formats(figures)
    # Both documents are made first, so that a value they cannot hold stops before any file exists.
    document = None if settings is None else settings_document(settings)
    report = json.dumps(metrics.as_dict(), indent=2, allow_nan=False)
    state = None
    with contextlib.suppress(ValueError):
        state = {**pack_recording(recording), **(further or {})}
    with run_folder(path, overwrite=overwrite) as folder:
        on_progress(0.0)
        (folder / MARK).write_text(report + "\n", encoding="utf-8")
        if document is not None:
            (folder / "settings.yaml").write_text(document, encoding="utf-8")
        with (folder / "arrays.npz").open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **recording.arrays())
        if state is not None:
            with (folder / STATE).open("wb") as file:
                np.savez_compressed(file, allow_pickle=False, **state)
        for name, write in recording.files().items():
            write(folder / name)
        for name, draw in recording.figures().items():
            write_figure(draw(), folder, name, kinds)
        if animation and not is_ending():
            on_progress(BEFORE_ANIMATION)
            rest = 1.0 - BEFORE_ANIMATION
            # The animation takes longest and is optional: Ctrl-C leaves it out and still saves
            # the run.
            with contextlib.suppress(KeyboardInterrupt):
                recording.write_animation(
                    folder / recording.animation,
                    film,
                    on_progress=lambda share: on_progress(BEFORE_ANIMATION + rest * share),
                )
    on_progress(1.0)


def settings_document(settings: Mapping[str, object]) -> str:
    """Format settings as YAML; a value that YAML cannot hold raises a `ValueError`."""
    try:
        return str(yaml.safe_dump(dict(settings), sort_keys=False, allow_unicode=True))
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise ValueError(
            f"settings cannot be written as YAML: {reason}; accepted: plain Python values"
        ) from error
