"""State of the exploration task."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore._types import ControlVector, Count, GridMask, Pose, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.belief.gain import Gain
from jaxplore.belief.obstacles import Obstacles
from jaxplore.control.guard import ScanPoints
from jaxplore.dynamics.goal_check import Motion
from jaxplore.report.exploration.data import MapProgress
from jaxplore.sensing.base import Sensor
from jaxplore.simulation.exploration.finish import Knowledge
from jaxplore.simulation.exploration.located import Located
from jaxplore.simulation.exploration.moving_obstacles import MovingObstacles
from jaxplore.simulation.exploration.progress import MapSums, map_progress
from jaxplore.simulation.exploration.wheels import Wheels


class ExplorationState(NamedTuple):
    """State of the exploration task.

    Args:
        robot: (nx,) true state of the robot.
        belief: the robot's belief.
        sums: sums over the cells of the known map, as of the last map update.
        progress: statistics of the known map, likewise.
        gain: the last rise of the coverage.
        finished: number of steps since the task was finished; 0 before.
        is_seen: (M,) whether each target has been found: seen, or recognised by a detector.
        moving_obstacles: moving obstacles with their drawn starts; None without any.
        ranges: (B,) ranges of the last scan, sensor by sensor [m].
        points: end points of the last scan, for the guard; None without one.
        wheels: the vehicle on its wheels; None for a robot that cannot tip over.
        located: localisation of the robot; None if it knows its pose.
        motion: motion of the robot in the last step.
        known: what the robot knows of what is left.
        landing: pose to which a fault carries the robot; None without such a fault.
        control: (nu,) control of the last step, for a lidar that turns; None without one.
    """

    robot: StateVector
    belief: Belief
    sums: MapSums
    progress: MapProgress
    gain: Gain
    finished: Count
    is_seen: Bool[Array, " M"]
    moving_obstacles: MovingObstacles | None
    ranges: Float[Array, " B"]
    motion: Motion
    known: Knowledge
    points: ScanPoints | None = None
    wheels: Wheels | None = None
    located: Located | None = None
    landing: Pose | None = None
    control: ControlVector | None = None

    def moved(self, robot: StateVector, control: ControlVector) -> "ExplorationState":
        """Return the state after a step of the robot, with the control if a lidar needs it.

        Args:
            robot: (nx,) true state after the step.
            control: (nu,) control of the step.
        """
        kept = None if self.control is None else control
        return self._replace(robot=robot, control=kept)


def max_ranges(sensors: Sequence[Sensor]) -> np.ndarray:
    """Return the greatest range (B,) of every beam of every sensor [m], for before a scan."""
    return np.concatenate(
        [np.full(sensor.num_beams, sensor.max_range, np.float32) for sensor in sensors]
    )


def initial_state(
    start: StateVector,
    belief: Belief,
    reachable: GridMask,
    num_targets: int,
    moving: MovingObstacles | None,
    sensors: Sequence[Sensor],
    *,
    is_guarded: bool = False,
    can_tip: bool = False,
    located: Located | None = None,
) -> ExplorationState:
    """Return the state at the start.

    Args:
        start: (nx,) state of the robot.
        belief: its belief, without moving obstacles.
        reachable: (H, W) cells that count for the progress.
        num_targets: number of targets.
        moving: moving obstacles; None without any.
        sensors: the sensors.
        is_guarded: whether a guard needs the end points of scans.
        can_tip: whether the robot has a chassis that can tip over.
        located: localisation at the start; None if the robot knows its pose.
    """
    number = sum(sensor.num_beams for sensor in sensors)
    if moving is not None and belief.tracks is None:
        belief = dataclasses.replace(belief, obstacles=Obstacles.unseen(moving.radius))
    sums = MapSums.of(belief.grid.probability, reachable)
    progress = map_progress(sums, belief, reachable, jnp.zeros(()))
    return ExplorationState(
        robot=start,
        belief=belief,
        sums=sums,
        progress=progress,
        gain=Gain(progress.coverage, jnp.zeros(())),
        finished=jnp.zeros((), jnp.int32),
        is_seen=jnp.zeros(num_targets, bool),
        moving_obstacles=moving,
        ranges=jnp.asarray(max_ranges(sensors)),
        points=ScanPoints.blank(number, 0.0, can_move=belief.tracks is not None)
        if is_guarded
        else None,
        motion=Motion(jnp.zeros(()), jnp.zeros(())),
        known=Knowledge.nothing(),
        wheels=Wheels.at_rest() if can_tip else None,
        located=located,
    )
