"""The true vehicle on its wheels: where it loses traction, and when it tips over."""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp

from jaxplore import _kinds
from jaxplore._types import Flag, Pose, Scalar, StateVector
from jaxplore.geometry.chassis import Chassis, Stability, Stance
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.parts.wheels.report import WheelRecord, WheelReport
from jaxplore.simulation.exploration.part_truth import Drive, PartTruth

TIPPING_TIME = 0.2
"""Time for which the load of a pair of wheels must be gone before the vehicle tips over [s]: that
of an inverted pendulum of 0.4 m, sqrt(h / g). A shorter bump lifts the wheels and lets them down
again."""
TRACTION = 0.5
"""Share of a displacement that is left while a wheel hangs in the air: it spins, and takes half of
the drive through the differential with it."""


class WheelState(NamedTuple):
    """The vehicle on its wheels after a step: how much of what it withstands is used.

    `tipping` is the time for which a pair of wheels has been without load [s]. It no longer changes
    when the vehicle has tipped over.
    """

    used: Stability
    tipping: Scalar

    @property
    def is_tipped(self) -> Flag:
        """Whether the vehicle has tipped over."""
        # Half a millisecond of tolerance: times are sums of rounded periods.
        return self.tipping >= TIPPING_TIME - 5e-4


class Wheels(PartTruth):
    """A vehicle on the wheels of a chassis, which can lose the ground and tip over.

    It loses half of a displacement while a wheel hangs in the air. It tips over where a pair of
    wheels is without load for 0.2 s, on a slope or in a fast curve, and stays where it lies; the
    run ends. A world without a ground is level.

    Args:
        chassis: wheels and centre of mass.
    """

    name: ClassVar[str] = "wheels"
    needs_part: ClassVar[bool] = False
    is_moving: ClassVar[bool] = True

    chassis: Chassis

    def __check_init__(self) -> None:
        _kinds.instance("chassis", self.chassis, Chassis)

    def init(self, pose: Pose) -> WheelState:
        """Return a vehicle that stands on level ground."""
        return WheelState(Stability(jnp.zeros(()), jnp.zeros(()), jnp.zeros(())), jnp.zeros(()))

    def drive(self, own: WheelState, drive: Drive) -> StateVector:
        """Return where the vehicle gets to on its wheels (nx,).

        With a wheel in the air, `1 - TRACTION` of the displacement is lost. A vehicle that has
        tipped over stays where it lies.
        """
        robot, before, after = drive.robot, drive.before, drive.after
        moves = jnp.asarray([name in ("x", "y", "yaw") for name in robot.state_names])
        slipped = jnp.where(moves, before + TRACTION * (after - before), after)
        moved = jnp.where(own.used.is_hanging, slipped, after)
        return jnp.where(own.is_tipped, robot.resolve_collision(before, before), moved)

    def update(self, own: WheelState, drive: Drive) -> WheelState:
        """Return the vehicle on its wheels after a period."""
        robot, state, ground = drive.robot, drive.after, drive.truth.ground
        stance = Stance(jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))
        if ground is not None:
            stance = ground.stance(self.chassis, robot.position(state), robot.heading(state))
        used = self.chassis.stability(stance, *robot.acceleration(state, drive.control))
        longer = jnp.where(used.is_tipped, own.tipping + drive.period, 0.0)
        return WheelState(used, jnp.where(own.is_tipped, own.tipping, longer))

    def is_over(self, own: WheelState) -> Flag:
        """Return whether the vehicle has tipped over."""
        return own.is_tipped

    def record(self, own: WheelState) -> WheelRecord:
        """Return how much of what the vehicle withstands is used."""
        most = jnp.maximum(own.used.across, own.used.along)
        return WheelRecord(most, own.used.wheels, own.is_tipped)

    def report(self, part: Any, known: Any, own: WheelState, grid: OccupancyGrid) -> WheelReport:
        """Return the metrics of the records."""
        return WheelReport()
