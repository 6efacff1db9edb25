"""`jaxplore run path`."""

from pathlib import Path
from typing import Any

import click

from jaxplore.build.tasks import build
from jaxplore.cli._options import assign, assign_all
from jaxplore.cli._show import free_name, save
from jaxplore.report.folder import check_folder
from jaxplore.settings.exploration import read_settings
from jaxplore.settings.path import PATH, TRACK, make_path_settings
from jaxplore.simulation.run import NUM_TRAJECTORIES, simulate

_OWN = {"laps": "laps", "obstacles": "obstacles.number"}
"""Options that only a path takes, and the settings that they stand for."""
_SHARED = (
    "seed",
    "time_limit",
    "start",
    "robot__model",
    "robot__radius",
    "robot__max_speed",
    "controller__num_samples",
)
"""Options that a path and a map take."""


def path_options(command: Any) -> Any:
    """Add the options that only a path takes."""
    for option in (
        click.option("--obstacles", type=int, help="Of a path: moving obstacles.  [default: 0]"),
        click.option("--laps", type=int, help="Of a closed path.  [default: 1]"),
        click.option(
            "--path",
            "path_file",
            metavar="FILE",
            help="Path to follow, in CSV or YAML.  [default: a generated track]",
        ),
    ):
        command = option(command)
    return command


def is_path(options: dict[str, Any]) -> bool:
    """Say whether a path is to be followed, and not a map explored.

    Raises:
        ValueError: a path beside a map, options of a path without one.
    """
    map_, file = options["map_"], options["path_file"]
    if file is not None and map_ not in (None, PATH):
        raise ValueError(f"--path is {file!r} beside the map {map_!r}; accepted: one of them")
    if map_ == PATH or file is not None:
        return True
    settings_file = options["settings_file"]
    if map_ is None and settings_file is not None and PATH in read_settings(settings_file):
        return True
    for name in _OWN:
        if options[name] is not None:
            raise ValueError(f"--{name} is {options[name]}; accepted: with jaxplore run path")
    return False


def path_entries(options: dict[str, Any]) -> dict[str, Any]:
    """Return the settings that the options of a run along a path give.

    Raises:
        ValueError: options that only a map takes, and what `assign_all` refuses.
    """
    settings_file = options["settings_file"]
    entries = {} if settings_file is None else read_settings(settings_file)
    if options["path_file"] is not None:
        entries["path"] = str(Path(options["path_file"]).absolute())
    for name, value in options.items():
        if value is None or name in ("map_", "path_file", "settings_file", "assignments"):
            continue
        if name not in (*_OWN, *_SHARED):
            # By the last part of its name, as the options are called.
            raise ValueError(
                f"{name.replace('__', '.')} is {value} beside a path; accepted: with a map"
            )
        assign(entries, _OWN.get(name, name.replace("__", ".")), value)
    assign_all(entries, options["assignments"])
    return entries


def run_path(
    options: dict[str, Any], out: Path | None, *, overwrite: bool, animation: bool
) -> None:
    """Follow a path, and write the run's folder.

    Raises:
        ValueError: options that only a map takes, and what the parts refuse.
    """
    settings = make_path_settings(path_entries(options))
    name = TRACK if settings.path == TRACK else Path(settings.path).stem
    folder = free_name(Path("runs") / name) if out is None else out
    check_folder(folder, overwrite=overwrite)
    experiment = build(settings)
    result = simulate(
        *experiment[:3],
        key=experiment.key,
        progress=True,
        num_trajectories=NUM_TRAJECTORIES if animation else 0,
    )
    save(result, folder, settings, overwrite=overwrite, animation=animation)
