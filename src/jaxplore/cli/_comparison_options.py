"""Options of `jaxplore compare`."""

from pathlib import Path
from typing import Any

import click

from jaxplore.cli._completion import complete_architectures, complete_assignment


def comparison_options(command: Any) -> Any:
    """Add the options for the variants and the maps of a comparison."""
    folder = click.Path(path_type=Path)
    # Click lists options in the reverse order of their addition.
    for option in (
        click.option(
            "--batch",
            type=int,
            help="With --maps: runs in one program (vmap), for accelerators.  [default: 1]",
        ),
        click.option(
            "--starts",
            type=folder,
            metavar="FILE",
            help="With --maps: YAML file of start poses, NAME: [x, y, yaw].  [default: starts.yaml "
            "of the folder, else the position with the greatest clearance]",
        ),
        click.option(
            "--maps",
            metavar="DIR",
            help="Compare on all ROS maps, volumes or paths of a folder, or on several, A,B: "
            "files, folders and names such as forest. Can be interrupted and continued.",
        ),
        click.option(
            "--vary",
            "varied",
            multiple=True,
            metavar="NAME=A,B,C",
            shell_complete=complete_assignment,
            help="Compare values of a setting, or of a controller parameter by its path.",
        ),
        click.option(
            "--variants",
            metavar="FILE,FILE",
            help="Compare settings files, each merged over the common settings.",
        ),
        click.option(
            "--architectures",
            "--explorers",
            "architectures",
            metavar="NAME,NAME",
            shell_complete=complete_architectures,
            help="Compare architectures, also MODULE:NAME of your own.  [default: all that the map "
            "allows, unless something else varies]",
        ),
    ):
        command = option(command)
    return command
