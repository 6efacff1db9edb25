"""jaxplore beside nav2: `ros2 launch jaxplore nav2.launch.py`.

The controller server stands in for nav2's, under nav2's lifecycle manager. With `explore:=true`
goals are chosen as well, for nav2's action NavigateToPose. Start nav2 without its own controller
server, and something that publishes /map and the transforms from map to base_link.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

SETTINGS = str(Path(__file__).parents[1] / "config" / "robot.yaml")
POSE = ["--set", "node.pose_type=tf", "--set", "node.world_frame=map"]


def generate_launch_description():
    """Return the controller server, its manager, and the chooser of goals."""
    command, settings = LaunchConfiguration("command"), LaunchConfiguration("settings")
    server = [command, "controller", "--settings", settings, *POSE]
    goals = [command, "node", "--mode", "goal", "--settings", settings, *POSE]
    goals += ["--set", "node.goal_by=action"]
    manager = Node(
        package="nav2_lifecycle_manager",
        executable="lifecycle_manager",
        name="lifecycle_manager_jaxplore",
        parameters=[{"autostart": True, "node_names": ["controller_server"]}],
    )
    explore = IfCondition(LaunchConfiguration("explore"))
    return LaunchDescription(
        [
            DeclareLaunchArgument("command", default_value="jaxplore"),
            DeclareLaunchArgument("settings", default_value=SETTINGS),
            DeclareLaunchArgument("explore", default_value="false"),
            ExecuteProcess(cmd=server, output="screen"),
            manager,
            ExecuteProcess(cmd=goals, output="screen", condition=explore),
        ]
    )
