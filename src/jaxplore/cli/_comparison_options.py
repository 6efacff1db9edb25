"""Options of `jaxplore compare`."""

import click

from jaxplore.cli._completion import complete_architectures, complete_assignment
from jaxplore.cli._decorators import add_options, path_option

comparison_options = add_options(
    click.option(
        "--architectures",
        "--explorers",
        "architectures",
        metavar="NAME,NAME",
        shell_complete=complete_architectures,
        help="Compare architectures, also MODULE:NAME of your own.  [default: all that the map "
        "allows, unless something else varies]",
    ),
    click.option(
        "--variants",
        metavar="FILE,FILE",
        help="Compare settings files, each merged over the common settings.",
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
        "--maps",
        metavar="DIR",
        help="Compare on all ROS maps, volumes or paths of a folder, or on several, A,B: "
        "files, folders and names such as forest. Can be interrupted and continued.",
    ),
    path_option(
        "--starts",
        metavar="FILE",
        text="With --maps: YAML file of start poses, NAME: [x, y, yaw].  [default: starts.yaml "
        "of the folder, else the position with the greatest clearance]",
    ),
    click.option(
        "--batch",
        type=int,
        help="With --maps: runs in one program (vmap), for accelerators.  [default: 1]",
    ),
)
