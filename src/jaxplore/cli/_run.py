"""`jaxplore run`: simulates one run and writes its folder."""

from pathlib import Path
from typing import Any

from jaxplore.build.tasks import build, find_task, make_settings
from jaxplore.cli._entries import folder_name, option_entries
from jaxplore.cli._pictures import take_pictures
from jaxplore.cli._show import free_name, save, show_starts
from jaxplore.report.folder import check_folder
from jaxplore.simulation.run import NUM_TRAJECTORIES, simulate


def run_one(options: dict[str, Any], out: Path | None, *, overwrite: bool) -> None:
    """Simulate one run, write its folder and print its metrics.

    The exit code is 130 if the user stopped it.

    Raises:
        ValueError: options that are not accepted.
    """
    pictures = take_pictures(options, overwrite=overwrite)
    given = option_entries(options)
    entries = find_task(given).with_start(given)
    settings = make_settings(entries)
    folder = free_name(Path("runs") / folder_name(entries)) if out is None else out
    # The folder is checked before the run, which may take minutes.
    check_folder(folder, overwrite=overwrite)
    experiment = build(settings)
    show_starts({"": given}, {"": entries})
    result = simulate(
        *experiment[:3],
        key=experiment.key,
        progress=True,
        num_trajectories=NUM_TRAJECTORIES if pictures.animation or pictures.video else 0,
    )
    save(result, folder, settings, pictures, overwrite=overwrite)
