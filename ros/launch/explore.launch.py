"""A robot explores: `ros2 launch jaxplore explore.launch.py`.

Without `simulated:=true` it is the robot of this machine. `command` is the program, such as
`/home/robot/jaxplore/bin/jaxplore` of a virtual environment.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import LaunchConfiguration

SETTINGS = str(Path(__file__).parents[1] / "config" / "robot.yaml")


def generate_launch_description():
    """Return the simulated robot and the node, with its view where it is wanted."""
    command, settings = LaunchConfiguration("command"), LaunchConfiguration("settings")
    simulated, view = LaunchConfiguration("simulated"), LaunchConfiguration("view")
    robot = [command, "robot", LaunchConfiguration("map"), "--settings", settings]
    node = [command, "node", "--settings", settings]
    return LaunchDescription(
        [
            DeclareLaunchArgument("command", default_value="jaxplore"),
            DeclareLaunchArgument("settings", default_value=SETTINGS),
            DeclareLaunchArgument("map", default_value="office"),
            DeclareLaunchArgument("simulated", default_value="true"),
            DeclareLaunchArgument("view", default_value="false"),
            ExecuteProcess(cmd=robot, output="screen", condition=IfCondition(simulated)),
            ExecuteProcess(cmd=node, output="screen", condition=UnlessCondition(view)),
            ExecuteProcess(cmd=[*node, "--view"], output="screen", condition=IfCondition(view)),
        ]
    )
