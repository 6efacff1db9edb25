"""Results of the commands: folders, tables and messages."""

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from jaxplore._exit import INTERRUPTED
from jaxplore._signals import is_ending
from jaxplore.cli._pictures import Pictures
from jaxplore.cli._terminal import say
from jaxplore.report.folder import is_reserved, reserve_folder
from jaxplore.report.table import print_table, transpose
from jaxplore.settings.readers import read_values
from jaxplore.settings.sections import RunSettings, Section
from jaxplore.simulation.run import Run
from jaxplore.study.comparison.comparison import Comparison

type Entries = Mapping[str, Any]
"""Settings as in a settings file."""


def free_name(path: Path) -> Path:
    """Return an unused path: the path itself, or with a number."""
    candidate, number = path, 2
    while candidate.exists() or is_reserved(candidate):
        candidate, number = path.with_name(f"{path.name}-{number}"), number + 1
    return candidate


def reserve(folder: Path, *, overwrite: bool) -> None:
    """Keep other processes from a run folder to the command's end, see `reserve_folder`."""
    click.get_current_context().with_resource(reserve_folder(folder, overwrite=overwrite))


def show_starts(given: Mapping[str, Entries], entries: Mapping[str, Entries]) -> None:
    """Print each start that was chosen: `entries` have one, and `given`, of the user, have none."""
    chosen: dict[str, list[str]] = {}
    for name, each in entries.items():
        if given[name].get("start") is None and each.get("start") is not None:
            # Far from the origin, six digits would show another place.
            shown = " ".join(f"{round(part, 4):.12g}" for part in each["start"])
            chosen.setdefault(shown, []).append(name)
    for start, names in chosen.items():
        where = f" of {', '.join(names)}" if len(chosen) > 1 else ""
        # In a volume a start has a height.
        pose = "X Y YAW" if len(start.split()) == 3 else "X Y Z YAW"
        say(
            f"Start{where}: {start}, the position with the greatest clearance; another one: "
            f"--start {pose}",
            err=True,
        )


def show_goal(settings: RunSettings, scenario: Any) -> None:
    """Print where the goal of a run is, and how near is enough."""
    goal, known = getattr(settings, "goal", None), getattr(scenario, "goal", None)
    if goal is not None and known is not None:
        shown = " ".join(f"{part:.12g}" for part in goal)
        say(
            f"Goal: {shown}, reached within {float(known.radius):g} m; another radius: --set "
            "goal_radius=METRES",
            err=True,
        )


def save(
    result: Run,
    folder: Path,
    settings: Section,
    pictures: Pictures,
    *,
    overwrite: bool,
    recording: Path | None = None,
) -> None:
    """Write run folder and video, and print metrics and files; exit if the run was interrupted."""
    result.save(
        folder,
        overwrite=overwrite,
        animation=pictures.animation,
        film=pictures.film,
        figures=pictures.figures,
        settings=read_values(settings),
        progress=True,
    )
    if pictures.video is not None and not is_ending():
        film = pictures.film
        result.animate(pictures.video, fps=film.fps, scale=film.scale, progress=True)
    print_table(result.metrics.rows(), title=str(folder), has_header=False)
    for pattern in (
        *(f"*.{kind}" for kind in pictures.figures),
        "*.gif",
        "explored.yaml",
        "metrics.json",
    ):
        for file in sorted(folder.glob(pattern)):
            say(str(file))
    if pictures.video is not None and pictures.video.exists():
        say(str(pictures.video))
    if recording is not None and recording.exists():
        say(str(recording))
    if result.metrics.is_interrupted:
        say(f"Interrupted: {folder} holds the run up to then.", err=True)
        sys.exit(INTERRUPTED)


def show_comparison(comparison: Comparison, folder: Path) -> None:
    """Print the table of a comparison, and its files; exit if it was interrupted."""
    # Transposed, one column for each variant: the rows would be too wide for a terminal.
    say(f"{folder}: medians [quartiles]")
    print_table(transpose(comparison.rows()))
    for path in sorted(folder.iterdir()):
        say(str(path))
    if comparison.is_interrupted:
        say(f"Interrupted: {folder} holds the finished runs.", err=True)
        sys.exit(INTERRUPTED)
