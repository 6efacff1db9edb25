"""Options of the commands for real robots and their simulation."""

from pathlib import Path
from typing import Any

import click

NAMESPACE = click.option(
    "--namespace",
    metavar="NAME",
    help="Namespace of topics, services and frames, such as robot1, for several robots.  "
    "[default: none]",
)
ANIMATION = click.option("--animation/--no-animation", default=True, help="Draw an animation.")


def _drive_options(out: str) -> tuple[Any, ...]:
    """Return the options of settings and of the run folder, whose default is `out`."""
    return (
        click.option(
            "--settings",
            "settings_file",
            type=click.Path(path_type=Path),
            metavar="FILE",
            help="Settings file in YAML, as of jaxplore run; topics and safety are in its section "
            "node.",
        ),
        click.option(
            "--set",
            "assignments",
            multiple=True,
            metavar="NAME=VALUE",
            help="Any setting, for example --set node.latency=0.1.",
        ),
        click.option(
            "--trust",
            is_flag=True,
            help="Import what settings files name as MODULE:NAME, which runs its code.",
        ),
        click.option(
            "--out",
            type=click.Path(path_type=Path),
            metavar="DIR",
            help=f"Run folder, written at the end.  [default: {out}]",
        ),
        click.option("--overwrite", is_flag=True, help="Replace an existing run folder."),
        ANIMATION,
    )


def node_options(command: Any) -> Any:
    """Add the options of the node that drives a robot."""
    mode = click.option(
        "--mode",
        type=click.Choice(["control", "follow", "goal"]),
        help="Explore, follow the paths of another program, or publish goals that nav2 drives to.  "
        "[default: control]",
    )
    # Click lists options in the reverse order of their addition.
    for option in reversed((mode, NAMESPACE, *_drive_options("runs/drive"))):
        command = option(command)
    return command


def replay_options(command: Any) -> Any:
    """Add the options of a replay."""
    topics = (
        click.option(
            "--scan", "scan_topic", metavar="TOPIC", help="Topic of the scan.  [default: the only]"
        ),
        click.option(
            "--pose",
            "pose_topic",
            metavar="TOPIC",
            help="Topic of the pose.  [default: the only odometry, else the only pose, else /tf]",
        ),
    )
    for option in reversed((*topics, *_drive_options("runs/drive"))):
        command = option(command)
    return command


def robot_options(command: Any) -> Any:
    """Add the options of the simulated robot."""
    for option in reversed(
        (
            click.option(
                "--delay",
                type=float,
                default=0.0,
                show_default=True,
                help="Time between a command and its effect [s].",
            ),
            click.option(
                "--drift",
                type=float,
                default=0.0,
                show_default=True,
                help="Standard deviation of the scale errors of the odometry.",
            ),
            click.option(
                "--mount",
                type=float,
                nargs=3,
                metavar="X Y DEGREES",
                default=(0.0, 0.0, 0.0),
                show_default=True,
                help="Place and heading of the lidar on the robot, as lidar_x, lidar_y and "
                "lidar_yaw_degrees of the node.",
            ),
            click.option(
                "--turning/--at-once",
                default=False,
                show_default=True,
                help="Whether the lidar turns while the robot drives; else it measures at once.",
            ),
            click.option(
                "--command-type",
                type=click.Choice(["twist", "twist_stamped"]),
                default="twist",
                show_default=True,
                help="Type of the messages on /cmd_vel.",
            ),
            click.option(
                "--map/--no-map",
                "has_map",
                default=True,
                help="Publish the map of what the lidar has seen on /map, the pose in it on /pose, "
                "and the transform from map to odom, as SLAM nodes do.",
            ),
            NAMESPACE,
            ANIMATION,
        )
    ):
        command = option(command)
    return command
