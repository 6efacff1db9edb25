"""The true charge of a battery: it runs down, is charged at the dock, and may be empty."""

import itertools
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Flag, Key, Pose, Position, Scalar, StateVector
from jaxplore.maps.frame import GridFrame
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.parts.battery.report import BatteryRecord, BatteryReport
from jaxplore.parts.battery.robot import JOULES, Battery, Charge
from jaxplore.sensing.base import Sensor
from jaxplore.simulation.exploration.checks import check_goal
from jaxplore.simulation.exploration.part_truth import Drive, PartTruth, Site
from jaxplore.simulation.exploration.reachability import to_grid
from jaxplore.simulation.exploration.true_world import TrueWorld

DOCK_RADIUS = 0.3
"""Distance of the robot's centre from the dock within which it is charged [m]."""
DOCK_SPEED = 0.1
"""Speed at which charging begins [m/s]."""


class BatteryState(NamedTuple):
    """The true battery: the energy that is left [J], its dock [m], whether it is being charged, and
    the part of the last changes that rounding has left out of the energy [J]."""

    energy: Scalar
    dock: Position
    is_docked: Flag
    rest: Scalar


class TrueBattery(PartTruth):
    """The true charge of a robot with a `Battery`.

    It consumes what the `Consumption` of the part says. A robot that comes to rest within 0.3 m of
    its dock, to less than 0.1 m/s, is charged until it leaves the dock. One whose battery is empty
    stands still, and the run ends.

    Args:
        battery: the robot's part.
        power: power of the charger [W].
        charge: share of the capacity at the start, in (0, 1].

    Raises:
        ValueError: a number out of its range. In a scenario a dock that the robot cannot reach from
            its start, or not with its charge and reserve.
    """

    name: ClassVar[str] = Battery.name
    is_moving: ClassVar[bool] = True

    battery: Battery
    power: Scalar
    charge: Scalar

    def __init__(
        self, battery: Battery, *, power: ArrayLike = 13.0, charge: ArrayLike = 1.0
    ) -> None:
        _kinds.instance("battery", battery, Battery)
        self.battery = battery
        self.power = _checks.scalar("power", power, above=0.0)
        self.charge = _checks.scalar("charge", charge, above=0.0, at_most=1.0)

    def bind(self, site: Site) -> "TrueBattery":
        """Check that the robot can reach its dock with its charge."""
        battery = self.battery
        if battery.dock is None or not battery.is_placed:
            return self
        place = np.asarray(battery.dock)
        check_goal(
            *(battery.dock, site.world, site.robot, site.reachable, DOCK_RADIUS, site.datum),
            name="dock",
        )
        way = drive_length(site.reachable, site.world.frame, site.start, place)
        needed = float(battery.needed(jnp.asarray(way, jnp.float32)))
        energy = float(self.charge * battery.capacity)
        if energy <= needed:
            x, y = site.datum.round_to_map(place).tolist()
            raise ValueError(
                f"dock is ({x:g}, {y:g}), {way:.1f} m from the start, for which the battery of "
                f"{energy / JOULES:.3g} Wh needs {needed / JOULES:.3g} Wh with its reserve; "
                "accepted: a dock that it reaches"
            )
        return self

    def init_part(self, part: Battery, pose: Pose) -> Charge:
        """Return what the robot knows of its charge at the start."""
        return part.charged(self.charge * part.capacity, pose[:2])

    def init(self, pose: Pose) -> BatteryState:
        """Return the charge at the start."""
        known = self.init_part(self.battery, pose)
        return BatteryState(known.energy, known.dock, jnp.array(False), jnp.zeros(()))

    def measure(
        self,
        part: Battery,
        own: BatteryState,
        truth: TrueWorld,
        sensors: Sequence[Sensor],
        pose: Pose,
        key: Key,
    ) -> Scalar:
        """Return the energy that is left [J]."""
        return own.energy

    def drive(self, own: BatteryState, drive: Drive) -> StateVector:
        """Return where the robot gets to: nowhere with an empty battery."""
        standing = drive.robot.resolve_collision(drive.before, drive.before)
        return jnp.where(own.energy > 0.0, drive.after, standing)

    def update(self, own: BatteryState, drive: Drive) -> BatteryState:
        """Return the charge after a period."""
        robot, period = drive.robot, drive.period
        before, after = (
            jnp.hypot(*robot.twist(state, drive.control)[:2])
            for state in (drive.before, drive.after)
        )
        moved = robot.position(drive.after) - robot.position(drive.before)
        way = jnp.hypot(moved[0], moved[1])
        used = self.battery.consumption.energy(period, way, before, after)
        away = robot.position(drive.after) - own.dock
        is_near = jnp.hypot(away[0], away[1]) <= DOCK_RADIUS
        # A robot that has come to rest at its dock is charged until it leaves it.
        is_docked = is_near & (own.is_docked | (way <= DOCK_SPEED * period))
        charged = jnp.where(is_docked, self.power * period, 0.0)
        # Single precision has no room for the energy of a period beside that of a large battery, so
        # what is rounded off is kept for the next one (Kahan, CACM 8(1), 1965).
        change = charged - used + own.rest
        energy = own.energy + change
        left = jnp.clip(energy, 0.0, self.battery.capacity)
        rest = jnp.where(left == energy, change - (energy - own.energy), 0.0)
        return BatteryState(left, own.dock, is_docked, rest)

    def is_over(self, own: BatteryState) -> Flag:
        """Return whether the battery is empty."""
        return own.energy <= 0.0

    def record(self, own: BatteryState) -> BatteryRecord:
        """Return the charge, and whether the robot is at its dock."""
        return BatteryRecord(own.energy / self.battery.capacity, own.is_docked)

    def report(
        self, part: Battery, known: Charge, own: BatteryState, grid: OccupancyGrid
    ) -> BatteryReport:
        """Return the dock and the numbers of the battery."""
        return BatteryReport(
            docks=np.asarray(known.dock, np.float64).reshape(-1, 2),
            capacity=float(part.capacity) / JOULES,
            reserve=float(part.reserve),
            charge=float(self.charge),
        )

    def gather(self, part: Battery, told: Any) -> Any:
        """Return the states of all batteries."""
        return told


def drive_length(
    reachable: np.ndarray, frame: GridFrame, start: np.ndarray, end: np.ndarray
) -> float:
    """Return the length of the shortest way between two places over the reachable cells [m].

    Steps lead to the eight cells around a cell. The result is infinite without a way, and the
    distance of the places if they are less than two cells apart.

    `reachable` (H, W) are cells of a grid with `frame`, and both places are (x, y, ...) [m].
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    apart = float(np.hypot(*(np.asarray(end, np.float64)[:2] - np.asarray(start)[:2])))
    if apart < 2.0 * frame.resolution:
        return apart
    number = np.full(np.add(reachable.shape, 2), -1)
    number[1:-1, 1:-1][reachable] = np.arange(int(reachable.sum()))
    rows, columns = np.nonzero(number >= 0)
    froms, tos, lengths = [], [], []
    for down, right in itertools.product((-1, 0, 1), repeat=2):
        beside = number[rows + down, columns + right]
        is_step = (beside >= 0) & bool(down or right)
        froms.append(number[rows, columns][is_step])
        tos.append(beside[is_step])
        lengths.append(np.full(int(is_step.sum()), np.hypot(down, right)))
    steps = np.concatenate(lengths), (np.concatenate(froms), np.concatenate(tos))
    graph = coo_array(steps, shape=(len(rows), len(rows))).tocsr()
    centres = np.stack([rows, columns], axis=-1) - 0.5
    ends = [
        int(np.argmin(np.hypot(*(centres - np.asarray(to_grid(frame, place))).T)))
        for place in (np.asarray(each[:2], np.float32) for each in (start, end))
    ]
    away = dijkstra(graph, indices=ends[0])
    return float(away[ends[1]]) * frame.resolution
