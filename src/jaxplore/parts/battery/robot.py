"""A robot that drives to its dock while the charge still reaches."""

from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._trees import with_field
from jaxplore._types import ArrayLike, Flag, Position, Scalar, Vector
from jaxplore.belief.part import Errand, Part
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.maps.voxel_grid import VoxelGrid

JOULES = 3600.0
"""Joules of a watt hour."""


class Charge(NamedTuple):
    """What a robot knows of its battery.

    Args:
        energy: energy that is left [J].
        dock: position (x, y) of the dock, in a volume (x, y, z) [m].
        is_returning: whether the robot drives to its dock, or is charged there.
    """

    energy: Scalar
    dock: Float[Array, " D"]
    is_returning: Flag


class Consumption(eqx.Module):
    """Energy that a robot takes: with the time, with the way, and with its load.

    Over a period dt [s], along a way s [m], from a speed v to v' [m/s]:

        E = idle dt + per_metre s + mass / 2 max(0, v'^2 - v^2)                              [J]

    Braking gives nothing back. Slopes and climbs are not modelled. The power `idle` of a robot that
    hovers is that of hovering.
    """

    idle: Scalar
    per_metre: Scalar
    mass: Scalar

    def energy(self, period: Scalar, way: Scalar, before: Scalar, after: Scalar) -> Scalar:
        """Return the energy of a period [J].

        Args:
            period: its length [s].
            way: distance travelled in it [m].
            before: speed before it [m/s].
            after: speed after it [m/s].
        """
        gained = jnp.maximum(after * after - before * before, 0.0)
        return self.idle * period + self.per_metre * way + 0.5 * self.mass * gained


class Battery(Part):
    """A battery, and the rule by which the robot returns to its dock and goes on.

    The robot returns as soon as

        energy <= reserve capacity + d (per_metre + idle / cruise)

    with d the cost-to-go to the dock [m] through known free space, which is the length of the way,
    counted up to double where the robot just fits. While no way to the dock is known, it explores.
    It stays at the dock until the battery is full up to the share `enough`. A quadrotor hovers
    there, at the position of its dock.

    Defaults are about those of a TurtleBot 4: 26 Wh, which last for 2.5 to 4 hours.

    Args:
        dock: position (x, y) of the dock, in a volume (x, y, z) with z up [m]; that of the robot's
            start when absent.
        capacity: energy of the full battery [Wh].
        idle: power of the robot at rest [W].
        per_metre: energy of a metre of way [J/m].
        mass: mass that the robot accelerates, its load included [kg].
        reserve: share of the capacity that is left at the dock, in [0, 1).
        enough: share of the capacity at which the robot leaves the dock, above the reserve, at most
            0.99.
        cruise: mean speed on the way to the dock [m/s].

    Raises:
        ValueError: a number out of its range.
    """

    name: ClassVar[str] = "battery"
    dimensions: ClassVar[tuple[int, ...]] = (2, 3)
    is_revisiting: ClassVar[bool] = False

    dock: Float[Array, " D"] | None
    capacity: Scalar
    consumption: Consumption
    reserve: Scalar
    enough: Scalar
    cruise: Scalar
    is_placed: bool = eqx.field(static=True)

    def __init__(
        self,
        dock: Vector | None = None,
        *,
        capacity: ArrayLike = 26.0,
        idle: ArrayLike = 6.0,
        per_metre: ArrayLike = 10.0,
        mass: ArrayLike = 4.0,
        reserve: ArrayLike = 0.2,
        enough: ArrayLike = 0.95,
        cruise: ArrayLike = 0.5,
    ) -> None:
        self.dock = None if dock is None else _checks.array("dock", dock, (2,), (3,))
        self.capacity = JOULES * _checks.scalar("capacity", capacity, above=0.0)
        self.consumption = Consumption(
            _checks.scalar("idle", idle, at_least=0.0),
            _checks.scalar("per_metre", per_metre, at_least=0.0),
            _checks.scalar("mass", mass, at_least=0.0),
        )
        self.reserve = _checks.scalar("reserve", reserve, at_least=0.0, below=1.0)
        # A traced reserve has no number that the other share could be compared with.
        least = None if _kinds.is_traced(reserve) else float(self.reserve)
        self.enough = _checks.scalar("enough", enough, above=least, at_most=0.99)
        self.cruise = _checks.scalar("cruise", cruise, above=0.0)
        self.is_placed = True

    def init(self, grid: OccupancyGrid | VoxelGrid) -> Charge:
        """Return a full battery; a robot on board begins at (0, 0)."""
        return self.begin_charge(self.capacity, jnp.zeros(len(grid.shape)))

    def begin_charge(self, energy: Scalar, start: Float[Array, " D"]) -> Charge:
        """Return the state with an energy [J] of a robot that begins at `start` [m]."""
        dock = start if self.dock is None else self.dock
        return Charge(energy, dock, jnp.array(False))

    def unplaced(self) -> "Battery":
        """Return a battery whose dock is not yet in the coordinates of the robot."""
        return with_field(self, "is_placed", False)

    def locate(self, own: Charge, grid: OccupancyGrid, origin: Position) -> Charge:
        """Return the state with the dock in coordinates that begin at `origin`."""
        return own if self.dock is None else own._replace(dock=self.dock - origin)

    def look(self, own: Charge, measured: Scalar, time: Scalar) -> Charge:
        """Return the state after a measurement of the energy that is left [J]."""
        return own._replace(energy=measured)

    def needed(self, way: Scalar) -> Scalar:
        """Return the energy with which the robot must return along a way [m], with reserve [J]."""
        per_metre = self.consumption.per_metre + self.consumption.idle / self.cruise
        return self.reserve * self.capacity + way * per_metre

    def errand(self, own: Charge) -> Errand:
        """Return the dock, and whether the robot must go there."""
        return Errand(own.dock, own.is_returning)

    def plan_errand(self, own: Charge, way: Scalar) -> Charge:
        """Return the state with the decision whether the robot returns."""
        is_low = (own.energy <= self.needed(way)) & jnp.isfinite(way)
        is_full = own.energy >= self.enough * self.capacity
        return own._replace(is_returning=(own.is_returning & ~is_full) | is_low)

    def merge(self, own: Charge, told: Any, is_heard: Bool[Array, " N"]) -> Charge:
        """Return the state of the robot's own battery."""
        return own
