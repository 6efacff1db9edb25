"""State of the exploration task."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore._types import Count, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.report.exploration.data import MapProgress
from jaxplore.sensing.base import Sensor
from jaxplore.simulation.exploration.moving_obstacles import MovingObstacles


class ExplorationState(NamedTuple):
    """State of the exploration task.

    Args:
        robot: (nx,) true state of the robot.
        belief: the robot's belief.
        progress: statistics of the known map, as of the last map update.
        finished: number of steps since the task was finished; 0 before.
        is_seen: (M,) whether each target has been seen.
        moving_obstacles: moving obstacles with their drawn starts; None without any.
        ranges: (B,) ranges of the last scan, sensor by sensor [m].
    """

    robot: StateVector
    belief: Belief
    progress: MapProgress
    finished: Count
    is_seen: Bool[Array, " M"]
    moving_obstacles: MovingObstacles | None
    ranges: Float[Array, " B"]


def max_ranges(sensors: Sequence[Sensor]) -> np.ndarray:
    """Return the greatest range (B,) of every beam of every sensor [m], for before a scan."""
    return np.concatenate(
        [np.full(sensor.num_beams, sensor.max_range, np.float32) for sensor in sensors]
    )
