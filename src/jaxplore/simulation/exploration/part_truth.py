"""The protocol of what is true of a part of a robot, and is not known to it."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore import _kinds
from jaxplore._types import ControlVector, Flag, GridMask, Key, Pose, Scalar, StateVector
from jaxplore.belief.part import Part
from jaxplore.belief.perception import Perception
from jaxplore.dynamics.base import Dynamics
from jaxplore.maps.datum import Datum
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.report.part import PartReport
from jaxplore.sensing.base import Sensor
from jaxplore.simulation.exploration.moving_discs import MovingDiscs
from jaxplore.simulation.exploration.true_world import TrueWorld


class Site(NamedTuple):
    """Where a robot is simulated.

    Args:
        world: the true map.
        robot: the true model.
        perception: what runs on board.
        start: (3,) pose at the start [m, m, rad].
        targets: (M, 2) positions of the targets [m].
        reachable: (H, W) cells that the robot's centre can reach.
        datum: point to which positions are relative.
    """

    world: OccupancyGrid
    robot: Dynamics
    perception: Perception
    start: np.ndarray
    targets: Float[Array, "M 2"]
    reachable: np.ndarray
    datum: Datum


class Drive(NamedTuple):
    """The motion of a robot during a control period.

    Args:
        robot: the true model.
        before: (nx,) state before it.
        after: (nx,) state after it.
        control: (nu,) control.
        truth: the true world at its end.
        period: length of the period [s].
    """

    robot: Dynamics
    before: StateVector
    after: StateVector
    control: ControlVector
    truth: TrueWorld
    period: Scalar


class PartTruth(eqx.Module):
    """What is true of a part of a robot, which the robot does not know, and what is judged of it.

    All methods have a default that does nothing. What is traced returns the same shapes at every
    step. A state is in `ExplorationState.truths` under the `name`, if there is one.
    """

    name: ClassVar[str]
    """Name: that of the robot's `Part`, if there is one."""
    needs_part: ClassVar[bool] = True
    """Whether it is the truth of a `Part` that the robot must have."""
    is_default: ClassVar[bool] = False
    """Whether a robot with the part has it where no other is given; it is made of no arguments."""
    objective: ClassVar[str | None] = None
    """Metric that a search makes small where the run has no end, such as `watch.mean_idleness`."""
    is_moving: ClassVar[bool] = False
    """Whether where the robot gets to depends on it."""
    is_judging: ClassVar[bool] = False
    """Whether `judge` reads what the robot knows; it then has a state."""

    def bind(self, site: Site) -> "PartTruth":
        """Return the truth at a site.

        Args:
            site: where the robot is simulated.

        Raises:
            ValueError: it cannot be true there.
        """
        return self

    def init_part(self, part: Any, pose: Pose) -> Any:
        """Return the state of the robot's part before the first scan; None for `Part.init`.

        Args:
            part: the robot's part; None without one, here and below.
            pose: true pose (x, y, yaw) at the start [m, m, rad].
        """
        return None

    def init(self, pose: Pose) -> Any:
        """Return the state at the start; None without any.

        Args:
            pose: true pose (x, y, yaw) [m, m, rad].
        """
        return None

    def draw(self, own: Any, key: Key) -> Any:
        """Return the state at the start of an episode in which something is random.

        Args:
            own: the state of `init`.
            key: random key of the run, for all robots of a fleet the same.
        """
        return own

    def discs(self, own: Any, time: Scalar) -> MovingDiscs | None:
        """Return what moves in the world beside the robot; None for nothing.

        Sensors see it, and the robot can touch it. Robots find it or are told of it, and pictures
        show it.

        Args:
            own: the state; its number of discs never changes.
            time: time since the start [s].
        """
        return None

    def measure(
        self, part: Any, own: Any, truth: TrueWorld, sensors: Sequence[Sensor], pose: Pose, key: Key
    ) -> Any:
        """Return what the instrument of the robot's part says, for `Part.look`; None without one.

        Args:
            part: the robot's part.
            own: the state.
            truth: the true world now.
            sensors: sensors of the robot.
            pose: true pose (x, y, yaw) [m, m, rad].
            key: random key of the step.
        """
        return None

    def judge(self, own: Any, known: Any, reachable: GridMask, number: Scalar, time: Scalar) -> Any:
        """Return the state after the robot has mapped scans.

        Args:
            own: the state before.
            known: state of the robot's part.
            reachable: (H, W) cells that the robot can reach.
            number: number of these cells.
            time: time since the start [s].
        """
        return own

    def find_targets(self, part: Any, known: Any) -> Bool[Array, " M"] | None:
        """Return which targets the robot has found by its part; None for those that it saw.

        Args:
            part: the robot's part.
            known: state of the robot's part.
        """
        return None

    def drive(self, own: Any, drive: Drive) -> StateVector:
        """Return where the robot gets to (nx,) in a period, before contact is looked for.

        Args:
            own: the state before.
            drive: the motion by the model.
        """
        return drive.after

    def update(self, own: Any, drive: Drive) -> Any:
        """Return the state after a period.

        Args:
            own: the state before.
            drive: the motion.
        """
        return own

    def is_over(self, own: Any) -> Flag | None:
        """Return whether the run ends; None if it never does for this.

        Args:
            own: the state.
        """
        return None

    def record(self, own: Any) -> Any:
        """Return the record of a step, a NamedTuple; None without one.

        Args:
            own: the state after it.
        """
        return None

    def gather(self, part: Any, told: Any) -> Any:
        """Return the state of the part of a robot that has heard all robots of a fleet.

        Args:
            part: the robots' part.
            told: states of the parts of N robots, stacked along a first axis.
        """
        everybody = jnp.ones(len(jax.tree.leaves(told)[0]), bool)
        return part.merge(jax.tree.map(lambda leaf: leaf[0], told), told, everybody)

    def frame(self, known: Any) -> Any:
        """Return arrays that a frame has, by name or as a NamedTuple; None without any.

        Args:
            known: state of the robot's part.
        """
        return None

    def report(self, part: Any, known: Any, own: Any, grid: OccupancyGrid) -> PartReport | None:
        """Return what the run shows, on the host; None for nothing.

        Args:
            part: the robot's part.
            known: state of the robot's part at the end; None without one.
            own: the state at the end.
            grid: the robot's map.
        """
        return None


def as_truths(truths: Sequence[PartTruth], parts: Sequence[Part]) -> tuple[PartTruth, ...]:
    """Return the truths of a robot's parts in the order of the parts, and then the others.

    Raises:
        ValueError: something that is no truth, two of one name, or one of a part that the robot
            does not have.
    """
    _kinds.instances("truths", truths, PartTruth)
    given: dict[str, PartTruth] = {}
    names = [part.name for part in parts]
    defaults = {each.name: each for each in PartTruth.__subclasses__() if each.is_default}
    for index, each in enumerate(truths):
        if each.name in given:
            raise ValueError(
                f"truths[{index}] is a second {each.name!r}; accepted: one truth of a name"
            )
        if each.needs_part and each.name not in names:
            raise ValueError(
                f"truths[{index}] is a {type(each).__name__}, and the perception has no part "
                f"{each.name!r}; accepted: truths of its parts"
            )
        given[each.name] = each
    of_parts = [
        given.get(name) or defaults[name]() for name in names if name in {*given, *defaults}
    ]
    return (*of_parts, *(each for name, each in given.items() if name not in names))


def init_truths(truths: Sequence[PartTruth], pose: Pose, key: Key | None) -> dict[str, Any]:
    """Return the states of truths at the start, by name.

    `pose` is the true pose (x, y, yaw) [m, m, rad]. `key` is that of the run; without one nothing
    is random.
    """
    states = {each.name: each.init(pose) for each in truths}
    found = {name: own for name, own in states.items() if own is not None}
    if key is None:
        return found
    return {each.name: each.draw(found[each.name], key) for each in truths if each.name in found}


def what_moves(
    truths: Sequence[PartTruth], states: Mapping[str, Any], time: Scalar
) -> MovingDiscs | None:
    """Return what moves in a world at a time since the start [s]; None if nothing does."""
    return MovingDiscs.join([each.discs(states.get(each.name), time) for each in truths])
