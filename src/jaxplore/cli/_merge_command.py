"""The command `jaxplore merge` and its options. What it runs is imported when it runs."""

from pathlib import Path
from typing import Any

import click

from jaxplore._signals import interrupt_on_end_signals


@click.command("merge")
@click.argument(
    "files",
    nargs=-1,
    required=True,
    type=click.Path(path_type=Path),
    metavar="MAP.yaml MAP.yaml...",
)
@click.option(
    "--out",
    "-o",
    type=click.Path(path_type=Path),
    metavar="FILE.yaml",
    default=Path("merged.yaml"),
    show_default=True,
    help="ROS map to write, with an image beside it.",
)
@click.option(
    "--picture",
    type=click.Path(path_type=Path),
    metavar="FILE.png",
    help="Also draw the merged map, with the walls of each map in a colour of its own.",
)
@click.option(
    "--rules",
    type=click.Choice(["nav2", "nav2_2025"]),
    default="nav2",
    show_default=True,
    help="Rules of nav2's map server by which the images are read.",
)
@click.option("--unknown", type=int, help="Grey that is read as unknown, such as 205.")
@click.option("--overwrite", is_flag=True, help="Replace existing files.")
def merge(files: tuple[Path, ...], out: Path, **options: Any) -> None:
    """Merge ROS maps of one building whose relative poses nobody knows.

    Finds where each map lies on the first one by its walls, prints the pose, how exact and how
    certain it is, and writes one map in the frame of the first:

    \b
      jaxplore merge robot1.yaml robot2.yaml
      jaxplore merge robot1.yaml robot2.yaml robot3.yaml --out all.yaml --picture all.png

    Where a map might as well lie elsewhere, or overlaps too little, nothing is written: one line
    with the reason, and exit code 2.
    """
    from jaxplore.cli._merge import MergeOptions, merge_map_files

    with interrupt_on_end_signals():
        merge_map_files(files, out, MergeOptions(**options))
