"""Writes a run along a path into its folder."""

from collections.abc import Callable, Mapping
from functools import partial
from os import PathLike

import numpy as np

from jaxplore.report.exploration.save import write_run
from jaxplore.report.following.animation import write_path_animation
from jaxplore.report.following.metrics import PathMetrics
from jaxplore.report.following.plots import errors_figure, path_figure
from jaxplore.simulation.following.follow import PathRecording

ANIMATION = "following.gif"


def save_path_recording(
    recording: PathRecording,
    metrics: PathMetrics,
    path: str | PathLike[str],
    *,
    settings: Mapping[str, object] | None = None,
    animation: bool = True,
    overwrite: bool = False,
    on_progress: Callable[[float], None] = lambda _: None,
) -> None:
    """Write a run folder: it appears complete or not at all.

    `metrics.json`, `arrays.npz` (see `path_arrays`), `path.png`, `errors.png`; with `animation`
    `following.gif`, and with `settings` `settings.yaml`.

    Args:
        recording: of the run.
        metrics: of the same run.
        path: of the folder.
        settings: that led to the run: plain values only.
        animation: write it; Ctrl-C leaves it out.
        overwrite: replace a former run.
        on_progress: called with the share that is done, 0 to 1.

    Raises:
        ValueError: settings that YAML cannot hold; a folder that exists or cannot be written.
    """
    write_run(
        path,
        metrics.as_dict(),
        path_arrays(recording),
        {
            "path.png": partial(path_figure, recording),
            "errors.png": partial(errors_figure, recording),
        },
        (ANIMATION, partial(write_path_animation, recording)) if animation else None,
        settings=settings,
        overwrite=overwrite,
        on_progress=on_progress,
    )


def path_arrays(recording: PathRecording) -> dict[str, np.ndarray]:
    """Return what `arrays.npz` holds: plain arrays, no pickles.

    Each field of `PathRecord` under its name, one row a step, but `progress` (N + 1,) [m] with the
    start, as `time` (N + 1,) [s] and `positions` (N + 1, 2) [m]; `centre` (P, 2) of the path and
    `edges` (2, P, 2) of its corridor [m], if it has one; `length` [m], `end` [m],
    `control_period` [s], `start` and `state_names`.
    """
    steps = {name: np.asarray(rows) for name, rows in recording.records._asdict().items()}
    edges = {"edges": recording.edges} if len(recording.edges) else {}
    return {
        **steps,
        "progress": recording.progress,
        "time": recording.time,
        "positions": recording.positions,
        "centre": recording.centre,
        **edges,
        "length": np.asarray(recording.length),
        "end": np.asarray(recording.end),
        "control_period": np.asarray(recording.control_period),
        "start": recording.start,
        "state_names": np.asarray(recording.state_names, np.str_),
    }
