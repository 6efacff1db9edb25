"""State of the path-following task."""

from typing import NamedTuple

from jaxplore._types import Count, Scalar, StateVector
from jaxplore.belief.obstacles import Obstacles


class PathState(NamedTuple):
    """State of the path-following task.

    `robot` (nx,) is the true state of the robot, with its path parameter phi. `progress` is the arc
    length of the point of the path nearest to the robot [m]; it keeps growing from lap to lap.
    `next_stop` is the number of the stops that the robot has made. `known` are the obstacles as its
    tracker estimates them; None without any.
    """

    robot: StateVector
    progress: Scalar
    next_stop: Count
    known: Obstacles | None
