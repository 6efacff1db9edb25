"""The protocol of what is true of a part of a robot, and is not known to it."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxplore import _kinds
from jaxplore._types import ControlVector, Flag, GridMask, Key, Scalar, StateVector
from jaxplore.belief.part import Part
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.quadrotor import position_upwards
from jaxplore.maps.datum import Datum
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.report.part import PartReport
from jaxplore.simulation.exploration.checks import check_goal, check_spots, is_closed
from jaxplore.simulation.exploration.moving_discs import MovingDiscs
from jaxplore.simulation.exploration.reachability import to_grid
from jaxplore.simulation.volume.checks import (
    check_free,
    check_reachable,
    check_visible,
    find_voxels,
)
from jaxplore.simulation.volume.true_volume import TrueVolume


class Site(NamedTuple):
    """Where a robot is simulated.

    Args:
        world: the true map, an `OccupancyGrid`, or in a volume a `VoxelGrid`.
        robot: the true model.
        perception: what runs on board, a `Perception` or a `VolumePerception`.
        start: (3,) pose at the start [m, m, rad]; in a volume (x, y, z, yaw), with z up.
        truths: what is true of the robot's parts, as it was given.
        reachable: (H, W) cells that the robot's centre can reach; in a volume (D, H, W) voxels.
        datum: point to which positions are relative.
        visible: (D, H, W) voxels of a volume that a sensor sees from there; None in the plane.
    """

    world: Any
    robot: Dynamics
    perception: Any
    start: np.ndarray
    truths: "tuple[PartTruth, ...]"
    reachable: np.ndarray
    datum: Datum
    visible: np.ndarray | None = None

    def truth[Kind: PartTruth](self, kind: "type[Kind]") -> "Kind | None":
        """Return the truth of a class, as it was given; None without one.

        Args:
            kind: the class.
        """
        return next((each for each in self.truths if isinstance(each, kind)), None)

    def check_place(self, name: str, place: np.ndarray, within: float) -> None:
        """Check that a place is in free space, and within a distance [m] of where the robot gets.

        `place` is a position (x, y), in a volume (x, y, z) [m], and `name` is what it is called.

        Raises:
            ValueError: it is not, or is of the other number of coordinates.
        """
        size = self.reachable.ndim
        if len(place) != size:
            told = self.datum.round_to_map(place).tolist()
            raise ValueError(f"{name} is {told}; accepted: ({', '.join('xyz'[:size])})")
        if isinstance(self.world, VoxelGrid):
            check_free(name, place, self.world, self.datum)
            barred = self.perception.barred_voxels(self.world)
            solid = ~np.asarray(self.world.is_free)
            solid = solid if barred is None else solid | np.asarray(barred)
            radius = float(self.robot.radius)
            given = self.world, solid, self.reachable, radius, within, self.datum
            check_reachable(name, place, *given)
        else:
            at = jnp.asarray(place, jnp.float32)
            check_goal(at, self.world, self.robot, self.reachable, within, self.datum, name)

    def check_places(self, name: str, places: np.ndarray) -> None:
        """Check that things (M, 2), in a volume (M, 3) [m], are where a sensor can see them, and
        not all where the robot must not enter.

        Raises:
            ValueError: they are not, or have the other number of coordinates.
        """
        size = self.reachable.ndim
        if places.shape[1] != size:
            raise ValueError(f"{name} have shape {places.shape}; accepted: (M, {size})")
        if self.visible is not None:
            check_visible(name, places, self.world, self.visible, self.datum)
            barred, kind = self.perception.barred_voxels(self.world), "boxes"
            closed = None if barred is None else np.asarray(barred)[find_voxels(places, self.world)]
        else:
            check_spots(name, places, self.world, self.datum)
            cells, kind = self.perception.closed_cells(self.world), "areas"
            closed = None if cells is None else is_closed(cells, self.world, places)
        if closed is not None and closed.all():
            raise ValueError(
                f"{name} are {len(places)}, all in keep-out {kind}; accepted: one outside at least"
            )

    def to_grid(self, place: np.ndarray) -> np.ndarray:
        """Return a place [m] in grid coordinates (row, column), in a volume (z, y, x)."""
        at = jnp.asarray(place, jnp.float32)
        if isinstance(self.world, VoxelGrid):
            return np.asarray(self.world.to_grid(at))
        return np.asarray(to_grid(self.world.frame, at))


class Drive(NamedTuple):
    """The motion of a robot during a control period.

    Args:
        robot: the true model.
        before: (nx,) state before it.
        after: (nx,) state after it.
        control: (nu,) control.
        truth: the `TrueWorld` at its end, or the `TrueVolume`.
        period: length of the period [s].
    """

    robot: Dynamics
    before: StateVector
    after: StateVector
    control: ControlVector
    truth: Any
    period: Scalar

    def position(self, state: StateVector) -> Float[Array, " D"]:
        """Return the position (x, y) of a state, in a volume (x, y, z) with z up [m]."""
        if isinstance(self.truth, TrueVolume):
            return position_upwards(state)
        return self.robot.position(state)

    def velocity(self, state: StateVector) -> Float[Array, " D"]:
        """Return the velocity in a state, in the frame of the body or of the world [m/s]."""
        if isinstance(self.truth, TrueVolume):
            return jnp.stack([self.robot.component(state, name) for name in ("vx", "vy", "vz")])
        return self.robot.twist(state, self.control)[:2]


class Vantage(NamedTuple):
    """A robot in the true world, when its scans are in its map.

    Args:
        truth: the `TrueWorld`, or the `TrueVolume`.
        sensors: sensors of the robot.
        pose: true pose (x, y, yaw) [m, m, rad]; in a volume the true state (nx,).
        parts: parts of the robot.
        known: states of the parts, by name.
    """

    truth: Any
    sensors: Any
    pose: Float[Array, " P"]
    parts: tuple[Part, ...]
    known: Mapping[str, Any]

    def sees(self, points: Float[Array, "M D"]) -> Bool[Array, " M"]:
        """Return which points [m] are in sight of the first sensor, in a volume of any sensor."""
        if isinstance(self.truth, TrueVolume):
            return self.truth.sees(self.sensors, self.pose, points)
        seen: Bool[Array, " M"] = self.sensors[0].sees(
            self.truth.grid, self.pose, points, self.truth.ground
        )
        return seen


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
    """Whether it is judged after scans, by `witness` and `judge`; it then has a state, of a fleet
    one for all robots beside that of each."""

    def bind(self, site: Site) -> "PartTruth":
        """Return the truth at a site.

        Args:
            site: where the robot is simulated.

        Raises:
            ValueError: it cannot be true there.
        """
        return self

    def init_part(self, part: Any, pose: Float[Array, " P"]) -> Any:
        """Return the state of the robot's part before the first scan; None for `Part.init`.

        Args:
            part: the robot's part; None without one, here and below.
            pose: true pose (x, y, yaw) at the start [m, m, rad]; in a volume (x, y, z, yaw).
        """
        return None

    def init(self, pose: Float[Array, " P"]) -> Any:
        """Return the state at the start; None without any.

        Args:
            pose: true pose (x, y, yaw) [m, m, rad]; in a volume (x, y, z, yaw).
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
        self,
        part: Any,
        own: Any,
        truth: Any,
        sensors: Any,
        pose: Float[Array, " P"],
        key: Key,
    ) -> Any:
        """Return what the instrument of the robot's part says, for `Part.look`; None without one.

        Args:
            part: the robot's part.
            own: the state.
            truth: the `TrueWorld` now, or the `TrueVolume`.
            sensors: sensors of the robot.
            pose: true pose (x, y, yaw) [m, m, rad]; in a volume (x, y, z, yaw).
            key: random key of the step.
        """
        return None

    def judge(self, own: Any, known: Any, reachable: GridMask, number: Scalar, time: Scalar) -> Any:
        """Return the state by what the robot knows after it has mapped scans.

        It is not called in a volume.

        Args:
            own: the state before.
            known: state of the robot's part; None without one.
            reachable: (H, W) cells that the robot can reach.
            number: number of these cells.
            time: time since the start [s].
        """
        return own

    def witness(self, own: Any, vantage: Vantage) -> Any:
        """Return the state after scans by what the robot meets in the true world, before `judge`.

        Args:
            own: the state before.
            vantage: the robot in the true world.
        """
        return own

    def unite(self, told: Any, pose: Float[Array, " P"]) -> Any:
        """Return the state of all robots of a fleet, before `judge` judges what they know together.

        Args:
            told: states of N robots, stacked along a first axis.
            pose: true pose (x, y, yaw) of the first robot at the start [m, m, rad].
        """
        return self.init(pose)

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

    def is_finished(self, own: Any) -> Flag | None:
        """Return whether the task is finished; None if other things decide.

        A truth that overrides it takes the place of the map as the end of an exploration, which is
        not given up then. It is judging.

        Args:
            own: the state, of a fleet that of all robots.
        """
        return None

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

    def frame(self, known: Any, own: Any) -> Any:
        """Return arrays that a frame has, by name or as a NamedTuple; None without any.

        Args:
            known: state of the robot's part; None without one.
            own: the state; None without one, of a fleet that of all robots if it is judging.
        """
        return None

    def report(self, part: Any, known: Any, own: Any, grid: Any) -> PartReport | None:
        """Return what the run shows, on the host; None for nothing.

        Args:
            part: the robot's part.
            known: state of the robot's part at the end; None without one.
            own: the state at the end; of a fleet those of all robots, stacked along a first axis.
            grid: the robot's map.
        """
        return None

    @property
    def ends_task(self) -> bool:
        """Whether the task is finished by it."""
        return type(self).is_finished is not PartTruth.is_finished


def as_truths(truths: Sequence[PartTruth], parts: Sequence[Part]) -> tuple[PartTruth, ...]:
    """Return what ends the task, the truths of a robot's parts in their order, and the others.

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
    found = (*of_parts, *(each for name, each in given.items() if name not in names))
    # Other truths and their layers of pictures are about what the task is about.
    return tuple(sorted(found, key=lambda each: not each.ends_task))


def init_truths(
    truths: Sequence[PartTruth], pose: Float[Array, " P"], key: Key | None
) -> dict[str, Any]:
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
