"""The true charge of a battery: it runs down, is charged at the dock, and may be empty."""

import itertools
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Flag, Key, Scalar, StateVector
from jaxplore.belief.part import ERRAND_RADIUS
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.voxel_grid import VoxelGrid
from jaxplore.parts.battery.report import BatteryRecord, BatteryReport
from jaxplore.parts.battery.robot import JOULES, Battery, Charge
from jaxplore.sensing.base import Sensor
from jaxplore.sensing.volume import VolumeSensor
from jaxplore.simulation.exploration.part_truth import Drive, PartTruth, Site
from jaxplore.simulation.exploration.true_world import TrueWorld
from jaxplore.simulation.volume.true_volume import TrueVolume

DOCK_RADIUS = ERRAND_RADIUS
"""Distance of the robot's centre from the dock within which it is charged [m]."""
DOCK_SPEED = 0.1
"""Speed at which charging begins [m/s]."""


class BatteryState(NamedTuple):
    """The true battery: the energy that is left [J], its dock [m], whether it is being charged, and
    the part of the last changes that rounding has left out of the energy [J]."""

    energy: Scalar
    dock: Float[Array, " D"]
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
        site.check_place("dock", place, DOCK_RADIUS)
        way = drive_length(site, site.start[:-1], place)
        needed = float(battery.needed(jnp.asarray(way, jnp.float32)))
        energy = float(self.charge * battery.capacity)
        if energy <= needed:
            told = ", ".join(f"{each:g}" for each in site.datum.round_to_map(place).tolist())
            raise ValueError(
                f"dock is ({told}), {way:.1f} m from the start, for which the battery of "
                f"{energy / JOULES:.3g} Wh needs {needed / JOULES:.3g} Wh with its reserve; "
                "accepted: a dock that it reaches"
            )
        return self

    def init_part(self, part: Battery, pose: Float[Array, " P"]) -> Charge:
        """Return what the robot knows of its charge at the start."""
        return part.begin_charge(self.charge * part.capacity, pose[:-1])

    def init(self, pose: Float[Array, " P"]) -> BatteryState:
        """Return the charge at the start."""
        known = self.init_part(self.battery, pose)
        return BatteryState(known.energy, known.dock, jnp.array(False), jnp.zeros(()))

    def measure(
        self,
        part: Battery,
        own: BatteryState,
        truth: TrueWorld | TrueVolume,
        sensors: Sequence[Sensor] | Sequence[VolumeSensor],
        pose: Float[Array, " P"],
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
        period, here = drive.period, drive.position(drive.after)
        before, after = (measure(drive.velocity(state)) for state in (drive.before, drive.after))
        way = measure(here - drive.position(drive.before))
        used = self.battery.consumption.energy(period, way, before, after)
        is_near = measure(here - own.dock) <= DOCK_RADIUS
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
        self, part: Battery, known: Charge, own: BatteryState, grid: OccupancyGrid | VoxelGrid
    ) -> BatteryReport:
        """Return the dock and the numbers of the battery."""
        docks = np.asarray(known.dock, np.float64)
        return BatteryReport(
            docks=docks.reshape(-1, docks.shape[-1]),
            capacity=float(part.capacity) / JOULES,
            reserve=float(part.reserve),
            charge=float(self.charge),
        )

    def gather(self, part: Battery, told: Any) -> Any:
        """Return the states of all batteries."""
        return told


def measure(vector: Float[Array, " D"]) -> Scalar:
    """Return the length of a vector of two or three components."""
    level = jnp.hypot(vector[0], vector[1])
    return level if vector.shape[0] == 2 else jnp.hypot(level, vector[2])


def drive_length(site: Site, start: np.ndarray, end: np.ndarray) -> float:
    """Return the length of the shortest way between two places over the reachable cells [m].

    Steps lead to the 8 cells around a cell, in a volume to the 26 voxels around a voxel. The result
    is infinite without a way, and the distance of the places if they are less than two cells apart.

    Both places are (x, y), in a volume (x, y, z) [m].
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import dijkstra

    side: float = site.world.resolution
    apart = float(np.linalg.norm(np.asarray(end, np.float64) - np.asarray(start)))
    if apart < 2.0 * side:
        return apart
    number = np.full(np.add(site.reachable.shape, 2), -1, np.int32)
    inside = number[(slice(1, -1),) * number.ndim]
    inside[site.reachable] = 0
    cells = np.nonzero(number >= 0)
    number[cells] = np.arange(len(cells[0]))
    froms, tos, lengths = [], [], []
    steps = list(itertools.product((-1, 0, 1), repeat=number.ndim))
    # Half of the steps are the others the other way round.
    for step in steps[: len(steps) // 2]:
        beside = number[tuple(axis + by for axis, by in zip(cells, step, strict=True))]
        is_step = beside >= 0
        froms.append(number[cells][is_step])
        tos.append(beside[is_step])
        lengths.append(np.full(int(is_step.sum()), np.linalg.norm(step)))
    ways = np.concatenate(lengths), (np.concatenate(froms), np.concatenate(tos))
    graph = coo_array(ways, shape=(len(cells[0]),) * 2).tocsr()
    centres = np.stack(cells, axis=-1) - 0.5
    ends = [
        int(np.argmin(np.linalg.norm(centres - site.to_grid(place), axis=1)))
        for place in (start, end)
    ]
    away = dijkstra(graph, directed=False, indices=ends[0])
    return float(away[ends[1]]) * side
