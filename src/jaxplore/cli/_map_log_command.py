"""The command `jaxplore map-log` and its options. What it runs is imported when it runs."""

from pathlib import Path
from typing import Any

import click

from jaxplore._signals import interrupt_on_end_signals
from jaxplore.cli._decorators import add_options, path_option


@click.command("map-log")
@add_options(
    click.argument("file", type=click.Path(path_type=Path), metavar="LOG"),
    path_option("--out", metavar="DIR", text="Folder.  [default: runs/LOG-map]"),
    click.option(
        "--resolution",
        type=float,
        help="Side of a map cell [m].  [default: 0.05, 0.1 or 0.2, as the scans need]",
    ),
    click.option(
        "--range",
        "max_range",
        default=25.0,
        show_default=True,
        help="Range beyond which readings are not used [m].",
    ),
    click.option(
        "--field-of-view",
        type=float,
        help="Angle between the outermost beams [rad].  [default: by the log]",
    ),
    click.option(
        "--drift-seed",
        type=int,
        help="Seed of made-up drift on the log's poses, in place of its odometry; for tests.",
    ),
    click.option(
        "--set",
        "assignments",
        multiple=True,
        metavar="NAME=VALUE",
        help="Error of the odometry or of the drift, such as --set distance_noise=0.04; see "
        "the page Localisation.  [default: fitted]",
    ),
    click.option("--overwrite", is_flag=True, help="Replace an existing folder."),
)
def map_log(file: Path, out: Path | None, **options: Any) -> None:
    """Map a log of a real lidar by its odometry and its scans.

    Reads a log in the format of CARMEN or of GMapping (gfs), also packed (.gz). How wrong the
    odometry is, is fitted, or given with --set. Scans are matched and loops are closed. Whether
    places that were seen twice look the same says if the map is to be trusted. Writes a folder with
    a ROS map, a figure and metrics, the errors among them if the log has poses that a mapping
    program has corrected:

    \b
      jaxplore map-log intel.log
      jaxplore map-log aces.corrected.log.gz --out runs/aces --set turn_noise=0.1
      jaxplore map-log csail.corrected.log --drift-seed 1 --set turn_per_distance=0.035

    Needs GTSAM: pip install '.[slam]' in a clone of jaxplore. Ctrl-C ends it and writes nothing.
    """
    from jaxplore.cli._map_log import MapLogOptions, map_a_log

    with interrupt_on_end_signals():
        map_a_log(file, out, MapLogOptions(**options))
