"""Settings of the node that drives a robot, beside those of a run."""

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from jaxplore.onboard.motors import Motors
from jaxplore.onboard.options import PilotOptions
from jaxplore.onboard.path_server import ServerOptions
from jaxplore.planning.presets.path_following import mpcc
from jaxplore.report.drawing.rollout_costs import WEIGHT
from jaxplore.sensing.cloud_view import CloudAxes, CloudView
from jaxplore.sensing.no_echo import NoEchoRule
from jaxplore.settings.controllers import ContouringNumbers
from jaxplore.settings.defaults import in_degrees, setting
from jaxplore.settings.readers import EVERY, Readers
from jaxplore.settings.ros_names import Namespace, NodeName, Topic
from jaxplore.settings.sections import (
    Duration,
    Latency,
    NonNegative,
    Positive,
    Real,
    Section,
    Width,
    check_section,
)


def _modes(text: str, *modes: str) -> Readers:
    return Readers(text, lambda settings: settings.node.mode in modes, "node.mode")


DRIVING = _modes("the modes control, follow and controller", "control", "follow", "controller")
EXPLORING, FOLLOWING = _modes("the mode control", "control"), _modes("the mode follow", "follow")
ALONG_PATHS = _modes("the modes follow and controller", "follow", "controller")
SERVING, CHOOSING = _modes("the mode controller", "controller"), _modes("the mode goal", "goal")
GOAL_TOPIC = Readers(
    "the mode goal, and nodes that know a map",
    lambda settings: settings.node.mode == "goal" or settings.node.map is not None,
    "node.mode",
)
WITHOUT_MAP = Readers(
    "nodes that make their map", lambda settings: settings.node.map is None, "node.map"
)
NOT_FOLLOWING = _modes("the modes control and goal", "control", "goal")
LOCALISING = Readers(
    "the pose internal and sessions",
    lambda settings: settings.node.pose == "internal" or settings.node.session is not None,
    "node.pose",
)


class NodeContouring(ContouringNumbers):
    """Contouring control along the paths of another program, by a robot on a floor: see
    `jaxplore.mpcc`."""

    readers = ALONG_PATHS

    temperature: Positive = setting(
        mpcc, "temperature", differs="drive.node.contouring.temperature"
    )
    contouring_weight: NonNegative = setting(
        mpcc, "contouring_weight", differs="drive.node.contouring.contouring_weight"
    )
    lag_weight: NonNegative = setting(
        mpcc, "lag_weight", differs="drive.node.contouring.lag_weight"
    )
    progress_weight: NonNegative = setting(
        mpcc, "progress_weight", differs="drive.node.contouring.progress_weight"
    )


Axes = NonNegative | tuple[NonNegative, NonNegative, NonNegative]
"""A number for all axes vx, vy and omega, or one for each."""
Bounds = Positive | tuple[Positive | None, Positive | None, Positive | None] | None


MOST_LIDARS = 8
"""Greatest number of lidars beside the first one."""
LidarPlaces = Annotated[dict[Topic, tuple[Real, Real, Real]], Field(max_length=MOST_LIDARS)]
"""Places (x, y, yaw) of upright lidars by topic [m, m, degrees]."""
SensorTilt = Annotated[float, Field(ge=-180, le=180)]


class MotorSettings(Section):
    """Motors of a base, as `jaxplore identify` finds them; see `jaxplore.onboard.Motors`."""

    readers = DRIVING

    delay: Latency = setting(Motors, "delay")
    lag: Axes = setting(Motors, "lag")
    dead_zone: Axes = setting(Motors, "dead_zone")
    max_speed: Bounds = setting(Motors, "max_speed")


class CloudSettings(Section):
    """A 3-D lidar or a depth camera in place of the lidar; see
    `jaxplore.sensing.cloud_view.CloudView`.

    Args:
        height: height of the sensor above the floor [m], between `least_height` and
            `greatest_height`.
    """

    readers = DRIVING

    height: Positive
    least_height: Real = setting(CloudView, "least_height")
    greatest_height: Real = setting(CloudView, "greatest_height")
    pitch_degrees: SensorTilt = setting(CloudView, "pitch", in_degrees)
    roll_degrees: SensorTilt = setting(CloudView, "roll", in_degrees)
    least_range: NonNegative = setting(CloudView, "least_range")
    axes: CloudAxes = setting(CloudView, "axes")


class NodeServer(Section):
    """The controller server for nav2, in the mode `controller`.

    Args:
        name: name of the node, which nav2's lifecycle manager knows.
        action: name of the action, `nav2_msgs/action/FollowPath`.
        speed_limit_topic: topic of limits of the speed, `nav2_msgs/SpeedLimit`.
        obstacles: what the robot keeps clear of: the `scan` of the lidar, the `costmap`, or the
            nearer one of `both` in each direction.
        costmap_topic: topic of the costmap, `nav_msgs/OccupancyGrid`.
        costmap_max_age: greatest age of the costmap [s]; the robot brakes beyond it.
    """

    readers = SERVING

    name: NodeName = "controller_server"
    action: Topic = "follow_path"
    speed_limit_topic: Topic = "speed_limit"
    obstacles: Literal["scan", "costmap", "both"] = "scan"
    costmap_topic: Topic = "local_costmap/costmap"
    costmap_max_age: Positive = 2.0
    controller_id: str = setting(ServerOptions, "controller_id")
    goal_checker_id: str = setting(ServerOptions, "goal_checker_id")
    progress_checker_id: str = setting(ServerOptions, "progress_checker_id")
    xy_goal_tolerance: Positive = setting(ServerOptions, "xy_goal_tolerance")
    yaw_goal_tolerance: Positive = setting(ServerOptions, "yaw_goal_tolerance")
    required_movement_radius: Positive = setting(ServerOptions, "required_movement_radius")
    movement_time_allowance: Positive = setting(ServerOptions, "movement_time_allowance")
    failure_tolerance: Real = setting(ServerOptions, "failure_tolerance")


class NodeSettings(Section):
    """The node that drives a robot, in the section `node` of a settings file.

    Topics that begin with no slash are relative to the namespace, as ROS does it: `scan` is
    `/robot1/scan` in the namespace `robot1`, and `/scan` without one. Names of frames begin with
    the namespace as well, `robot1/odom`; one with a leading slash, `/map`, is used as it is,
    without the slash.

    Args:
        namespace: namespace of the node, so that several robots drive in one graph; none when
            absent.
        mode: `control` explores; `follow` drives along the paths of another program; `goal`
            chooses goals on a map, and nav2 drives; `controller` drives along the paths of nav2, in
            place of its controller server.
        pose: whose pose the robot drives by: `external`, that of the topic, such as of a SLAM;
            `internal`, its own by scans and closed loops, from an odometry that drifts.
        session: folder that keeps the map, the pose graph, what was given up and the settings, so
            that a later drive goes on; none when absent.
        map: ROS map (YAML) that the robot knows. With the pose `internal` it finds itself on it by
            a particle filter; poses that are `external` are in its frame. When absent the robot
            makes its map.
        map_frame: name of the frame of the map of the pose `internal`, of a session and of a known
            map, for transforms.
        map_topic: topic of the map, for goals.
        goal_topic: topic of the goals: those that the mode `goal` publishes, and those to which a
            robot that knows a map drives.
        goal_by: how goals are told: by the `topic`, or by nav2's `action` `NavigateToPose`, whose
            results decide as well.
        goal_action: name of that action.
        path_topic: topic of the paths to follow, `nav_msgs/Path`.
        scan_topic: topic of the lidar, `sensor_msgs/LaserScan`, or `sensor_msgs/PointCloud2` with a
            section `node.cloud`.
        further_lidars: places (x, y, yaw) of lidars that complete the scans of the first one, by
            the topic of each [m, m, degrees]; they are upright.
        cloud: a 3-D lidar or a depth camera in place of the lidar; none when absent.
        pose_topic: topic of the pose: `nav_msgs/Odometry`, or `PoseWithCovarianceStamped`.
        pose_type: type of the pose's messages; `tf` follows the transforms from `world_frame` to
            `robot_frame`.
        battery_topic: topic of the charge, `sensor_msgs/BatteryState`, for runs with a battery.
        command_topic: topic of the commands.
        command_type: type of the commands; `auto` takes the one that the robot listens to, and
            `twist` where none does.
        world_frame: name of the fixed frame, for transforms.
        robot_frame: name of the frame of the robot's centre.
        map_size: side of the map that the robot makes [m]; it starts in its middle.
        lidar_x: position of the lidar ahead of the robot's centre [m].
        lidar_y: position of the lidar to the left of it [m].
        lidar_yaw_degrees: heading of the lidar relative to the robot's [degrees].
        is_lidar_inverted: whether the lidar hangs upside down.
        no_echo: what the lidar's driver reports where a beam meets nothing: `inf`; `max`, also
            the greatest range; `zero`, also 0 and NaN; `auto` finds it from the readings, and
            says so. Of clouds only `zero` is read: beams met nothing that no point tells of.
        deadline: share of the control period after which the last plan's next command is sent.
        rollout_colour: what colours the published rollouts: `weight`, `total cost`, or the name of
            a term of the controller's cost.
        is_autostarted: whether the robot drives at once, or waits for `start`.
        give_up_after: time without scans, or without poses, after which the node ends [s]; it waits
            for ever when absent.
        motors: motors of the base, for whose delay, lag and dead zone the commands allow.
        contouring: contouring control along the paths of the modes `follow` and `controller`.
        server: the controller server of the mode `controller`.
    """

    readers = DRIVING

    namespace: Annotated[Namespace | None, EVERY] = None
    mode: Annotated[Literal["control", "follow", "goal", "controller"], EVERY] = "control"
    pose: Annotated[Literal["external", "internal"], EVERY] = "external"
    session: Annotated[str | None, DRIVING] = None
    map: Annotated[str | None, DRIVING] = None
    map_frame: Annotated[str, LOCALISING] = "map"
    map_topic: Annotated[Topic, CHOOSING] = "map"
    goal_topic: Annotated[Topic, GOAL_TOPIC] = "goal_pose"
    goal_by: Annotated[Literal["topic", "action"], CHOOSING] = "topic"
    goal_action: Annotated[Topic, CHOOSING] = "navigate_to_pose"
    path_topic: Annotated[Topic, FOLLOWING] = "plan"
    scan_topic: Topic = "scan"
    further_lidars: LidarPlaces = Field(default_factory=dict)
    cloud: CloudSettings | None = None
    pose_topic: Annotated[Topic, EVERY] = "odom"
    pose_type: Annotated[Literal["odometry", "pose", "tf"], EVERY] = "odometry"
    battery_topic: Topic = "battery_state"
    command_topic: Topic = "cmd_vel"
    command_type: Literal["auto", "twist", "twist_stamped"] = "auto"
    world_frame: Annotated[str, EVERY] = "odom"
    robot_frame: Annotated[str, EVERY] = "base_link"
    map_size: Annotated[Width, WITHOUT_MAP] = 50.0
    lidar_x: Real = setting(PilotOptions, "lidar_x")
    lidar_y: Real = setting(PilotOptions, "lidar_y")
    lidar_yaw_degrees: Real = 0.0
    is_lidar_inverted: bool = False
    no_echo: NoEchoRule = "auto"
    deadline: Positive = 0.9
    rollout_colour: str = WEIGHT
    is_autostarted: bool = True
    give_up_after: Duration | None = None
    latency: Latency = setting(PilotOptions, "latency")
    max_age: Positive = setting(PilotOptions, "max_age")
    max_frozen: Positive = setting(PilotOptions, "max_frozen")
    max_jump: Positive = setting(PilotOptions, "max_jump")
    max_look_age: Positive = setting(PilotOptions, "max_look_age")
    max_deceleration: Positive = setting(PilotOptions, "max_deceleration")
    max_angular_deceleration: Positive = setting(PilotOptions, "max_angular_deceleration")
    margin: NonNegative = setting(PilotOptions, "margin")
    done_after: Annotated[Positive, NOT_FOLLOWING] = setting(PilotOptions, "done_after")
    returns: Annotated[bool, EXPLORING] = setting(PilotOptions, "returns")
    motors: MotorSettings = MotorSettings()
    contouring: Annotated[NodeContouring, ALONG_PATHS] = NodeContouring()
    server: Annotated[NodeServer, SERVING] = NodeServer()


class DriveSettings(Section):
    """What a settings file of a node has beside the settings of a run.

    Args:
        node: topics, places and limits of `jaxplore node`, in all its modes.
    """

    node: NodeSettings = NodeSettings()


def part_node(entries: Mapping[str, Any]) -> tuple[dict[str, Any], NodeSettings]:
    """Return the settings entries of a run, and the checked section `node` beside them.

    One settings file describes a run in simulation and a drive of the robot.
    """
    run = dict(entries)
    node = {"node": run.pop("node")} if "node" in run else {}
    return run, check_section(DriveSettings, node).node


def check_sensors(settings: NodeSettings) -> None:
    """Raise a `ValueError` if a sensor is outside of its band, or a topic is that of two lidars."""
    cloud_view(settings)
    names = [full_topic(settings, each) for each in settings.further_lidars]
    names.append(full_topic(settings, settings.scan_topic))
    if len(set(names)) < len(names):
        twice = next(each for each in names if names.count(each) > 1)
        raise ValueError(
            f"setting node.further_lidars has the topic {twice} of another lidar; accepted: a "
            "topic for each lidar, and another one than node.scan_topic"
        )


def full_topic(settings: NodeSettings, name: str) -> str:
    """Return the full name of a topic, without ROS."""
    if name.startswith(("/", "~")):
        return name
    return f"/{name}" if settings.namespace is None else f"/{settings.namespace}/{name}"


def cloud_view(settings: NodeSettings) -> CloudView | None:
    """Return how clouds become scans; None where a lidar of the plane measures.

    A sensor outside of the band of heights is a `ValueError`.
    """
    cloud = settings.cloud
    if cloud is None:
        return None
    return CloudView(
        cloud.height,
        cloud.least_height,
        cloud.greatest_height,
        math.radians(cloud.pitch_degrees),
        math.radians(cloud.roll_degrees),
        cloud.least_range,
        cloud.axes,
        is_rest_free=settings.no_echo == "zero",
    )
