"""The command `jaxplore map-log` and its options. What it runs is imported when it runs."""

from pathlib import Path
from typing import Any

import click

from jaxplore._signals import interrupting


def map_log_options(command: Any) -> Any:
    """Add the log, the folder, the map and the drift."""
    # Click lists options in the reverse order of their addition.
    for option in (
        click.option("--overwrite", is_flag=True, help="Replace an existing folder."),
        click.option(
            "--set",
            "assignments",
            multiple=True,
            metavar="NAME=VALUE",
            help="Error of the odometry, for example --set distance_noise=0.04; see the page "
            "Localisation.",
        ),
        click.option(
            "--drift-seed", type=int, default=0, show_default=True, help="Seed of the drift."
        ),
        click.option(
            "--field-of-view",
            type=float,
            help="Angle between the outermost beams [rad].  [default: by their number]",
        ),
        click.option(
            "--range",
            "max_range",
            type=float,
            default=25.0,
            show_default=True,
            help="Range beyond which readings are not used [m].",
        ),
        click.option(
            "--resolution",
            type=float,
            default=0.05,
            show_default=True,
            help="Side of a map cell [m].",
        ),
        click.option(
            "--out",
            type=click.Path(path_type=Path),
            metavar="DIR",
            help="Folder.  [default: runs/LOG-map]",
        ),
        click.argument("file", type=click.Path(path_type=Path), metavar="LOG"),
    ):
        command = option(command)
    return command


@click.command("map-log")
@map_log_options
def map_log(file: Path, out: Path | None, **options: Any) -> None:
    """Map a log of a real lidar, with drift on its motions.

    Reads a log in the format of CARMEN. Its poses are taken for the truth. Their motions get the
    errors of an odometry, 2 % of the distance and a degree in each metre by default. Scans are
    matched and loops are closed. Writes a folder with a ROS map, a figure and metrics:

    \b
      jaxplore map-log csail.corrected.log
      jaxplore map-log csail.corrected.log --drift-seed 1 --out runs/csail
      jaxplore map-log csail.corrected.log --set turn_per_distance=0.035

    Needs GTSAM: pip install '.[slam]' in a clone of jaxplore. Ctrl-C ends it and writes nothing.
    """
    from jaxplore.cli._map_log import MapLogOptions, map_a_log

    with interrupting():
        map_a_log(file, out, MapLogOptions(**options))
