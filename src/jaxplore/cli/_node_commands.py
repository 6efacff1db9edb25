"""The commands that drive and simulate robots over ROS 2, and the one that replays a drive.

What they run is imported when it runs.
"""

from pathlib import Path
from typing import Any

import click

from jaxplore._signals import interrupt_on_end_signals
from jaxplore.cli._cache import cache_option
from jaxplore.cli._decorators import OVERWRITE, TRUST, add_options, path_option
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


_drive_options = add_options(
    path_option(
        "--settings",
        "settings_file",
        metavar="FILE",
        text="Settings file in YAML, as of jaxplore run; topics and safety are in its section "
        "node.",
    ),
    click.option(
        "--set",
        "assignments",
        multiple=True,
        metavar="NAME=VALUE",
        help="Any setting, for example --set node.latency=0.1.",
    ),
    TRUST,
    path_option(
        "--out", metavar="DIR", text="Run folder, written at the end.  [default: runs/drive]"
    ),
    OVERWRITE,
    ANIMATION,
)


@click.command()
@click.option(
    "--mode",
    type=click.Choice(["control", "follow", "goal"]),
    help="Explore, follow the paths of another program, or publish goals that nav2 drives to.  "
    "[default: control]",
)
@path_option(
    "--session",
    metavar="FOLDER",
    text="Go on with the map, the pose graph and the settings that this folder keeps, and keep "
    "them there.",
)
@NAMESPACE
@_drive_options
@path_option(
    "--record", metavar="FILE.mcap", text="Also record the drive for Foxglove (needs foxglove-sdk)."
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
      jaxplore node --session runs/office

    Orders are texts on /jaxplore/command: start, explore, pause, return, save, stop. Ctrl-C stops
    the robot and saves the drive as a run folder.
    """
    from jaxplore.cli._node import drive

    with interrupt_on_end_signals():
        drive(options)


@click.command()
@NAMESPACE
@_drive_options
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
@click.option(
    "--scan", "scan_topic", metavar="TOPIC", help="Topic of the scan.  [default: the only]"
)
@click.option(
    "--pose",
    "pose_topic",
    metavar="TOPIC",
    help="Topic of the pose.  [default: the only odometry, else the only pose, else /tf]",
)
@_drive_options
@memory_option
@cache_option
def replay(bag: Path, **options: Any) -> None:
    """Feed a recorded drive to mapping and controller: what would it have commanded?

    The bag is a rosbag2 folder, or its .db3 or .mcap file, with a LaserScan and an Odometry (or a
    PoseWithCovarianceStamped). With node.cloud the scans are those of a PointCloud2. ROS is not
    needed. Writes a run folder with the map, the commands
    and an animation:

    \b
      jaxplore replay bags/office --out runs/office-replay
      jaxplore replay drive.mcap --scan /base_scan --settings robot.yaml
    """
    from jaxplore.cli._node import replay_bag

    with interrupt_on_end_signals():
        replay_bag(bag, options)


@click.command()
@click.argument("source", metavar="BAG_OR_TOPIC")
@path_option("-o", "--out", metavar="FILE", text="Settings file to write.")
@click.option("--overwrite", is_flag=True, help="Replace an existing file.")
@click.option(
    "--command", metavar="TOPIC", help="Topic of the commands in a bag.  [default: the only]"
)
@click.option(
    "--pose",
    metavar="TOPIC",
    help="Topic of the odometry.  [default: the only one of a bag; /odom]",
)
@click.option(
    "--seconds",
    type=click.FloatRange(min=10.0, max=3600.0),
    default=120.0,
    show_default=True,
    help="Time to listen to a topic [s].",
)
@NAMESPACE
def identify(source: str, **options: Any) -> None:
    """Identify the motors of a base: delay, lag, dead zone and greatest speed of each axis.

    Reads the velocity commands (Twist or TwistStamped) and the odometry of a drive, from a bag or,
    given the topic of the commands, while somebody drives. Two minutes with starts, stops and turns
    are enough. Prints each number with its standard error, and the error of predicted velocities
    before and after:

    \b
      jaxplore identify bags/teleop -o motors.yaml
      jaxplore identify /cmd_vel --seconds 120 -o motors.yaml
      jaxplore node --settings motors.yaml
    """
    from jaxplore.cli import _identify

    with interrupt_on_end_signals():
        _identify.identify(source, **options)


@click.command()
@with_options("architecture")
@click.option(
    "--delay",
    default=0.0,
    show_default=True,
    help="Time between a command and its effect [s].",
)
@click.option(
    "--drift",
    default=0.0,
    show_default=True,
    help="Standard deviation of the scale errors of the odometry.",
)
@path_option(
    "--motors",
    metavar="FILE",
    text="Settings file with node.motors, as of jaxplore identify: the motors of the base.  "
    "[default: they obey at once]",
)
@click.option(
    "--mount",
    type=float,
    nargs=3,
    metavar="X Y DEGREES",
    default=(0.0, 0.0, 0.0),
    show_default=True,
    help="Place and heading of the lidar on the robot, as lidar_x, lidar_y and "
    "lidar_yaw_degrees of the node.",
)
@click.option(
    "--turning/--at-once",
    default=False,
    show_default=True,
    help="Whether the lidar turns while the robot drives; else it measures at once.",
)
@click.option(
    "--command-type",
    type=click.Choice(["twist", "twist_stamped"]),
    default="twist",
    show_default=True,
    help="Type of the messages on /cmd_vel.",
)
@click.option(
    "--map/--no-map",
    "has_map",
    default=True,
    help="Publish the map of what the lidar has seen on /map, the pose in it on /pose, "
    "and the transform from map to odom, as SLAM nodes do.",
)
@NAMESPACE
@ANIMATION
@memory_option
@cache_option
@path_option("--out", metavar="DIR", text="Run folder.  [default: runs/MAP-robot]")
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
