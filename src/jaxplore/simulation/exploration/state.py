"""State of the exploration task."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore._types import ControlVector, Count, GridMask, Pose, Scalar, StateVector
from jaxplore.belief.belief import Belief
from jaxplore.belief.gain import Gain
from jaxplore.belief.obstacles import Obstacles
from jaxplore.control.guard import ScanPoints
from jaxplore.dynamics.goal_check import Motion
from jaxplore.report.exploration.data import LocalisationData, MapProgress
from jaxplore.robot.localisation import PoseKnowledge
from jaxplore.robot.robot import FITTING, Knowledge, Measurement, RobotState, Sight
from jaxplore.sensing.base import Sensor
from jaxplore.simulation.exploration.judge import Judged, TrueTrack
from jaxplore.simulation.exploration.moving_discs import MovingDiscs
from jaxplore.simulation.exploration.odometer import Odometer


class ExplorationState(NamedTuple):
    """State of the exploration task: what is true, what the robot knows, and what is said of it.

    Args:
        robot: (nx,) true state of the robot.
        own: what the robot knows.
        judged: what the record says of its knowledge.
        gain: the last rise of the coverage.
        finished: number of steps since the task was finished; 0 before.
        ranges: (B,) ranges of the last scan, sensor by sensor [m].
        motion: motion of the robot in the last step.
        truths: states of the truths of the robot's parts, by name.
        odometer: odometry of the run; None if the robot knows its pose.
        landing: pose to which a fault carries the robot; None without such a fault.
        control: (nu,) control of the last step, for a lidar that turns; None without one.
    """

    robot: StateVector
    own: RobotState
    judged: Judged
    gain: Gain
    finished: Count
    ranges: Float[Array, " B"]
    motion: Motion
    truths: dict[str, Any]
    odometer: Odometer | None = None
    landing: Pose | None = None
    control: ControlVector | None = None

    def after_step(self, robot: StateVector, control: ControlVector) -> "ExplorationState":
        """Return the state after a step of the robot, with the control if a lidar needs it."""
        kept = None if self.control is None else control
        return self._replace(robot=robot, control=kept)

    @property
    def belief(self) -> Belief:
        """What the robot believes."""
        return self.own.belief

    @property
    def progress(self) -> MapProgress:
        """Statistics of the known map, as of the last map update."""
        return self.judged.progress

    @property
    def coverage(self) -> Scalar:
        """Share of the reachable cells that are known to be free."""
        return self.judged.progress.coverage

    @property
    def is_seen(self) -> Bool[Array, " M"]:
        """Whether each of the M targets has been found."""
        return self.judged.is_seen

    @property
    def localisation(self) -> LocalisationData | None:
        """Where the robot was and took itself to be, on the host; None if it knows its pose."""
        place, track = self.own.place, self.judged.track
        return None if place is None or track is None else track.data(place, self.belief.grid)

    def with_belief(self, belief: Belief) -> "ExplorationState":
        """Return the state with another belief."""
        return self._replace(own=self.own._replace(belief=belief))


class Sensed(NamedTuple):
    """A period after the scans are in the map, before the fields follow."""

    state: ExplorationState
    measured: Measurement
    sight: Sight


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
    moving: MovingDiscs | None,
    sensors: Sequence[Sensor],
    *,
    pose: Pose,
    is_guarded: bool = False,
    truths: dict[str, Any],
    is_on_hills: bool = False,
    place: PoseKnowledge | None = None,
    odometer: Odometer | None = None,
) -> ExplorationState:
    """Return the state at the start.

    `belief` has no moving obstacles yet; a robot without a tracker is told of those that are
    `moving`. `is_guarded` says whether a guard needs the end points of scans, `is_on_hills` whether
    these may be of the ground. `pose` [m, m, rad] is the true pose.
    `truths` are the states of the truths of parts. `place` is what the robot knows of its pose, and
    `odometer` the odometry of the run; both are None if it knows its pose.
    """
    number = sum(sensor.num_beams for sensor in sensors)
    if moving is not None and belief.tracks is None:
        belief = dataclasses.replace(belief, obstacles=Obstacles.unseen(moving.radius))
    track = None if place is None else TrueTrack.at_start(pose, place, belief.grid)
    judged = Judged.at_start(belief, reachable, num_targets, track)
    points, unfit = None, None
    if is_guarded:
        unfit = jnp.asarray(FITTING)
        points = ScanPoints.blank(number, 0.0, is_on_hills=is_on_hills)
    return ExplorationState(
        robot=start,
        own=RobotState(belief, Knowledge.nothing(), points, place, unfit),
        judged=judged,
        gain=Gain(judged.progress.coverage, jnp.zeros(())),
        finished=jnp.zeros((), jnp.int32),
        ranges=jnp.asarray(max_ranges(sensors)),
        motion=Motion(jnp.zeros(()), jnp.zeros(())),
        truths=truths,
        odometer=odometer,
    )
