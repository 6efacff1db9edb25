"""The commands that drive and simulate robots over ROS 2, and the one that replays a drive.

What they run is imported when it runs.
"""

from pathlib import Path
from typing import Any

import click

from jaxplore._signals import interrupt_on_end_signals
from jaxplore.cli._cache import cache_option
from jaxplore.cli._memory import memory_option
from jaxplore.cli._options import with_options
from jaxplore.cli._view_options import view_options

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


def controller_options(command: Any) -> Any:
    """Add the options of the controller server."""
    for option in reversed((NAMESPACE, *_drive_options("runs/drive"))):
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


@click.command()
@node_options
@click.option(
    "--record",
    type=click.Path(path_type=Path),
    metavar="FILE.mcap",
    help="Also record the drive for Foxglove (needs foxglove-sdk).",
)
@view_options
@memory_option
@cache_option
def node(**options: Any) -> None:
    """Drive a robot that explores, over ROS 2.

    Reads a lidar (/scan) and the pose (/odom), keeps a map of its own, and sends velocities
    (/cmd_vel). The robot brakes whenever data are missing, old or impossible, and the node says
    why. Topics, the lidar's place on the robot and the numbers of safety are settings of the
    section node:

    \b
      jaxplore node
      jaxplore node --settings robot.yaml --out runs/first
      jaxplore node --set robot.max_speed=0.3 --set node.latency=0.1
      jaxplore node --view --record drive.mcap
      jaxplore node --mode goal
      jaxplore node --namespace robot1

    Orders are texts on /jaxplore/command: start, pause, stop. Ctrl-C stops the robot and saves the
    drive as a run folder.
    """
    from jaxplore.cli._node import drive

    with interrupt_on_end_signals():
        drive(options)


@click.command()
@controller_options
@view_options
@memory_option
@cache_option
def controller(**options: Any) -> None:
    """Drive a robot along the paths of nav2, in place of its controller server.

    Is a lifecycle node, controller_server, with the action FollowPath, so that nav2's lifecycle
    manager and behaviour trees find what they know. It needs nav2_msgs. Tolerances, topics and the
    costmap are settings of the section node.server:

    \b
      jaxplore controller --set node.pose_type=tf --set node.world_frame=map
      jaxplore controller --settings robot.yaml --set node.server.obstacles=both

    Ctrl-C stops the robot and saves the drive as a run folder.
    """
    from jaxplore.cli._node import drive

    with interrupt_on_end_signals():
        drive({**options, "mode": "controller", "record": None})


@click.command()
@click.argument("bag", type=click.Path(path_type=Path))
@replay_options
@memory_option
@cache_option
def replay(bag: Path, **options: Any) -> None:
    """Feed a recorded drive to mapping and controller: what would it have commanded?

    The bag is a rosbag2 folder, or its .db3 or .mcap file, with a LaserScan and an Odometry (or a
    PoseWithCovarianceStamped). ROS is not needed. Writes a run folder with the map, the commands
    and an animation:

    \b
      jaxplore replay bags/office --out runs/office-replay
      jaxplore replay drive.mcap --scan /base_scan --settings robot.yaml
    """
    from jaxplore.cli._node import replay_bag

    with interrupt_on_end_signals():
        replay_bag(bag, options)


@click.command()
@with_options("architecture")
@robot_options
@memory_option
@cache_option
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Run folder.  [default: runs/MAP-robot]",
)
def robot(**options: Any) -> None:
    """Simulate a robot in a map as a ROS 2 node, at wall-clock time.

    Publishes /scan, /odom and /map, and obeys /cmd_vel as the base of a real robot does, with a
    watchdog of a quarter of a second. Writes a run folder that says what the robot has seen and
    touched:

    \b
      jaxplore robot office
      jaxplore robot maps/depot.yaml --start 4.62 7.73 0 --delay 0.06
      jaxplore robot office --namespace robot1
    """
    from jaxplore.cli._node import simulate_robot

    with interrupt_on_end_signals():
        simulate_robot(options)
