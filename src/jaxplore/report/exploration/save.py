"""Writes a run into its folder."""

import contextlib
import json
from collections.abc import Callable, Mapping
from functools import partial
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
import yaml

from jaxplore.report.exploration.animation import write_animation
from jaxplore.report.exploration.idleness import idleness_figure
from jaxplore.report.exploration.members import members_figure
from jaxplore.report.exploration.metrics import Metrics
from jaxplore.report.exploration.plots import coverage_figure, map_figure
from jaxplore.report.exploration.progress import progress
from jaxplore.report.folder import MARK, run_folder
from jaxplore.simulation.recording import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DOTS_PER_INCH = 150


def save_recording(
    recording: Recording,
    metrics: Metrics,
    path: str | PathLike[str],
    *,
    settings: Mapping[str, object] | None = None,
    animation: bool = True,
    overwrite: bool = False,
    on_progress: Callable[[float], None] = lambda _: None,
) -> None:
    """Write a run folder: it appears complete or not at all.

    `metrics.json`, `arrays.npz` (see `arrays`), `map.png`, `coverage.png`; `members.png` of a
    controller with several members; `idleness.png` of a robot that keeps watch; with `animation`
    `exploration.gif`, and with `settings` `settings.yaml`.

    Args:
        recording: of the run.
        metrics: of the same run.
        path: of the folder.
        settings: that led to the run: plain values only.
        animation: write it; most of the time goes into it, and Ctrl-C leaves it out.
        overwrite: replace a former run.
        on_progress: called with the share that is done, 0 to 1.

    Raises:
        ValueError: settings that YAML cannot hold; a folder that exists or cannot be written.
    """
    figures = {"map": map_figure, "coverage": coverage_figure}
    if recording.records.members is not None:
        figures["members"] = members_figure
    if recording.idleness is not None:
        figures["idleness"] = idleness_figure
    write_run(
        path,
        metrics.as_dict(),
        arrays(recording),
        {f"{name}.png": partial(draw, recording) for name, draw in figures.items()},
        ("exploration.gif", partial(write_animation, recording)) if animation else None,
        settings=settings,
        overwrite=overwrite,
        on_progress=on_progress,
    )


def write_run(
    path: str | PathLike[str],
    metrics: Mapping[str, object],
    arrays: Mapping[str, np.ndarray],
    figures: Mapping[str, Callable[[], "Figure"]],
    animation: tuple[str, Callable[..., None]] | None,
    *,
    settings: Mapping[str, object] | None = None,
    overwrite: bool = False,
    on_progress: Callable[[float], None] = lambda _: None,
) -> None:
    """Write a run folder of any kind: it appears complete or not at all.

    Args:
        path: of the folder.
        metrics: for metrics.json.
        arrays: for arrays.npz.
        figures: by the names of their files, each drawn when its turn comes.
        animation: name of its file and what writes it; Ctrl-C leaves it out. None: no animation.
        settings: for settings.yaml; none when absent.
        overwrite: replace a former run.
        on_progress: called with the share that is done, 0 to 1.

    Raises:
        ValueError: settings that YAML cannot hold; a folder that exists or cannot be written.
    """
    document = None if settings is None else settings_document(settings)
    report = json.dumps(metrics, indent=2, allow_nan=False)
    with run_folder(path, overwrite=overwrite) as folder:
        on_progress(0.0)
        (folder / MARK).write_text(report + "\n", encoding="utf-8")
        if document is not None:
            (folder / "settings.yaml").write_text(document, encoding="utf-8")
        with (folder / "arrays.npz").open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)
        for name, draw in figures.items():
            draw().savefig(folder / name, dpi=DOTS_PER_INCH)
        before = 0.2
        if animation is not None:
            on_progress(before)
            name, write = animation
            # Drawing takes longest and can be done without: Ctrl-C leaves out the animation, not
            # the run.
            with contextlib.suppress(KeyboardInterrupt):
                write(
                    folder / name,
                    on_progress=lambda share: on_progress(before + (1.0 - before) * share),
                )
    on_progress(1.0)


def arrays(recording: Recording) -> dict[str, np.ndarray]:
    """Return what `arrays.npz` holds: plain arrays, no pickles.

    Each field of `Record` under its name, one row a step; `time` (N + 1,) [s] and `positions`
    (N + 1, 2) [m], start included: step k leads from row k to row k + 1, and its coverage and
    entropy were measured at `time[k]`; `world`, `belief` (H, W) probabilities and `reachable`
    (H, W); `origin` [m, m, rad], `resolution` [m], `control_period` [s], `start` and `state_names`.

    Where there are any: each field of `Members` as `members_NAME`, one row a step, with
    `member_names`; `targets` (M, 2) [m]; `idleness` (H, W) [s], infinite where nothing was ever
    seen; `elevation` (H, W) [m] and `traversable` (H, W) of the ground; `mover_radii` (M,) [m];
    `footprint` (4, 2) corners of a rectangular robot [m].
    """
    time, *_ = progress(recording)
    steps = recording.records._asdict()
    members = steps.pop("members")
    if members is not None:
        steps |= {f"members_{name}": rows for name, rows in members._asdict().items()}
        steps["member_names"] = np.asarray(recording.member_names, np.str_)
    optional = {
        "targets": recording.targets,
        "idleness": recording.idleness,
        "elevation": recording.elevation,
        "traversable": recording.traversable,
        "mover_radii": recording.mover_radii,
        "footprint": recording.footprint,
    }
    return {
        **{name: np.asarray(rows) for name, rows in steps.items()},
        "time": time,
        "positions": recording.positions,
        "world": recording.world,
        "belief": recording.belief,
        "reachable": recording.reachable,
        "origin": recording.origin,
        "resolution": np.asarray(recording.resolution),
        "control_period": np.asarray(recording.control_period),
        "start": recording.start,
        "state_names": np.asarray(recording.state_names, np.str_),
        **{name: each for name, each in optional.items() if each is not None and len(each)},
    }


def settings_document(settings: Mapping[str, object]) -> str:
    """Return settings as YAML.

    Raises:
        ValueError: what YAML cannot hold.
    """
    try:
        return str(yaml.safe_dump(dict(settings), sort_keys=False, allow_unicode=True))
    except yaml.YAMLError as error:
        reason = " ".join(str(error).split())
        raise ValueError(
            f"settings cannot be written as YAML: {reason}; accepted: plain Python values"
        ) from error
