"""A simple program that drives a robot to goals, as nav2 would: Dijkstra and pure pursuit."""

import math
import threading

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import OccupancyGrid, Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

CLEARANCE, RADIUS = 0.4, 0.27
"""Distance from the middles of cells that are not known to be free that a path keeps where it can,
and below which a robot of 0.2 m does not fit: half a cell, and what it cuts of a corner [m]."""
AHEAD = 0.3
"""Distance along the path of the point that is driven to [m]."""
REACHED = 0.4
"""Distance from a goal at which it is reached [m]."""
SPEED, PERIOD = 0.6, 0.05
STRAIGHT = 0.3
"""Difference of heading beyond which the robot turns on the spot [rad]."""


def planned_path(grid: np.ndarray, resolution: float, origin, start, goal) -> np.ndarray | None:
    """Return the points (N, 2) of the shortest path through known cells; None without one."""
    is_free = (grid >= 0) & (grid < 30)
    room = distance_transform_edt(is_free) * resolution
    # Near walls only where nothing else is left, and where the robot does not fit only at the
    # start.
    price = np.select([room > CLEARANCE, room > RADIUS], [1.0, 20.0], 1000.0)
    number = np.arange(grid.size).reshape(grid.shape)
    edges = []
    for rows, columns in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = np.s_[: grid.shape[0] - rows, max(0, -columns) : grid.shape[1] - max(0, columns)]
        there = np.s_[rows:, max(0, columns) : grid.shape[1] + min(0, columns)]
        both = is_free[here] & is_free[there]
        length = math.hypot(rows, columns) * (price[here] + price[there])
        edges.append(np.stack([number[here][both], number[there][both], length[both]]))
    one, other, length = np.concatenate(edges, axis=1)
    graph = coo_array((length, (one.astype(int), other.astype(int))), shape=(grid.size,) * 2)

    def index(point) -> int:
        column, row = np.floor((np.asarray(point[:2]) - origin) / resolution).astype(int)
        return int(number[row, column])

    first, last = index(start), index(goal)
    _, before = dijkstra(graph.tocsr(), directed=False, indices=last, return_predecessors=True)
    if before[first] < 0:
        return None
    path = [first]
    while path[-1] != last:
        path.append(before[path[-1]])
    row, column = np.unravel_index(path, grid.shape)
    return (np.stack([column, row], axis=-1) + 0.5) * resolution + origin


class Follower:
    """Drives to the newest goal on the newest map until it is told to end."""

    def __init__(self, node) -> None:
        self.goals: list[tuple[float, float]] = []
        self.num_reached = 0
        self._pose = self._map = None
        self._is_done = threading.Event()
        kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        node.create_subscription(OccupancyGrid, "/map", self._take_map, kept)
        node.create_subscription(PoseStamped, "/goal_pose", self._take_goal, kept)
        node.create_subscription(Odometry, "/odom", self._take_pose, 5)
        self._commands = node.create_publisher(Twist, "/cmd_vel", 5)
        threading.Thread(target=self._drive, daemon=True).start()

    def end(self) -> None:
        self._is_done.set()

    def _take_map(self, message: OccupancyGrid) -> None:
        info = message.info
        grid = np.array(message.data, np.int16).reshape(info.height, info.width)
        corner = info.origin.position
        self._map = grid, info.resolution, np.array([corner.x, corner.y])

    def _take_goal(self, message: PoseStamped) -> None:
        self.goals.append((message.pose.position.x, message.pose.position.y))

    def _take_pose(self, message: Odometry) -> None:
        place, turn = message.pose.pose.position, message.pose.pose.orientation
        self._pose = np.array([place.x, place.y, 2.0 * math.atan2(turn.z, turn.w)])

    def _drive(self) -> None:
        planned, path, reached = None, None, None
        while not self._is_done.wait(PERIOD):
            if self._pose is None or self._map is None or not self.goals:
                continue
            pose, goal = self._pose, self.goals[-1]
            if planned != (id(self._map), goal):
                planned = id(self._map), goal
                path = planned_path(*self._map, pose, goal)
            if math.dist(pose[:2], goal) < REACHED and reached != goal:
                reached, self.num_reached = goal, self.num_reached + 1
            self._commands.publish(_towards(pose, path, is_there=reached == goal))


def _towards(pose, path, *, is_there: bool) -> Twist:
    """Return the command that drives to a point ahead on the path."""
    command = Twist()
    if path is None or is_there:
        return command
    near = int(np.hypot(*(path - pose[:2]).T).argmin())
    along = np.cumsum(np.hypot(*np.diff(path[near:], axis=0, prepend=path[near : near + 1]).T))
    aim = path[near + min(int(np.searchsorted(along, AHEAD)), len(along) - 1)] - pose[:2]
    error = (math.atan2(aim[1], aim[0]) - pose[2] + math.pi) % math.tau - math.pi
    command.angular.z = float(np.clip(1.5 * error, -1.0, 1.0))
    command.linear.x = SPEED if abs(error) < STRAIGHT else 0.0
    return command
