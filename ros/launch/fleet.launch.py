"""Several simulated robots explore, each for itself: `ros2 launch jaxplore fleet.launch.py`.

Robots and nodes are in the namespaces robot1, robot2, ... With `simulated:=false` the robots are
real ones in these namespaces.
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration

SETTINGS = str(Path(__file__).parents[1] / "config" / "robot.yaml")


def start_robots(context):
    """Return a process for each robot and each node."""
    names = ("command", "settings", "map", "robots", "simulated")
    given = {name: LaunchConfiguration(name).perform(context) for name in names}
    command, settings = given["command"], ["--settings", given["settings"]]
    started = []
    for number in range(1, int(given["robots"]) + 1):
        space = ["--namespace", f"robot{number}"]
        if given["simulated"] == "true":
            started.append([command, "robot", given["map"], *settings, *space])
        started.append([command, "node", *settings, *space])
    return [ExecuteProcess(cmd=each, output="screen") for each in started]


def generate_launch_description():
    """Return the arguments and what they start."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("command", default_value="jaxplore"),
            DeclareLaunchArgument("settings", default_value=SETTINGS),
            DeclareLaunchArgument("map", default_value="office"),
            DeclareLaunchArgument("robots", default_value="2"),
            DeclareLaunchArgument("simulated", default_value="true"),
            OpaqueFunction(function=start_robots),
        ]
    )
