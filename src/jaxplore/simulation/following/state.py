"""State of the path-following task."""

from typing import NamedTuple

from jaxplore._types import Count, Scalar, StateVector
from jaxplore.belief.obstacles import Obstacles


class PathState(NamedTuple):
    """State of the path-following task.

    Args:
        robot: (nx,) true state of the robot, with its path parameter phi.
        progress: arc length of the point of the path nearest to the robot [m]; it keeps growing
            from lap to lap.
        next_stop: number of the stops that the robot has made.
        known: obstacles as the robot's tracker estimates them; None without any.
    """

    robot: StateVector
    progress: Scalar
    next_stop: Count
    known: Obstacles | None
