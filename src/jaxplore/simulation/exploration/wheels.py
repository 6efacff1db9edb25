"""The true vehicle on its wheels: where it loses traction, and when it tips over."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from jaxplore._types import ControlVector, Flag, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.chassis import Chassis, Stability, Stance
from jaxplore.simulation.exploration.true_world import TrueWorld

TIPPING_TIME = 0.2
"""Time for which the load of a pair of wheels must be gone before the vehicle tips over [s]: that
of an inverted pendulum of 0.4 m, sqrt(h / g). A shorter bump lifts the wheels and lets them down
again."""
TRACTION = 0.5
"""Share of a displacement that is left while a wheel hangs in the air: it spins, and takes half of
the drive through the differential with it."""


class Wheels(NamedTuple):
    """The vehicle on its wheels after a step: how much of what it withstands is used.

    `tipping` is the time for which a pair of wheels has been without load [s]. It no longer changes
    when the vehicle has tipped over.
    """

    used: Stability
    tipping: Scalar

    @classmethod
    def at_rest(cls) -> "Wheels":
        """Return a vehicle that stands on level ground."""
        return cls(Stability(jnp.zeros(()), jnp.zeros(()), jnp.zeros(())), jnp.zeros(()))

    @property
    def is_tipped(self) -> Flag:
        """Whether the vehicle has tipped over."""
        # Half a millisecond of tolerance: times are sums of rounded periods.
        return self.tipping >= TIPPING_TIME - 5e-4

    def record_fields(self) -> dict[str, Any]:
        """Return the fields of an `ExplorationRecord`, by name."""
        return {
            "load_transfer": jnp.maximum(self.used.across, self.used.along),
            "wheel_travel": self.used.wheels,
            "is_tipped": self.is_tipped,
        }


def stability(
    chassis: Chassis,
    truth: TrueWorld,
    robot: Dynamics,
    state: StateVector,
    control: ControlVector,
) -> Stability:
    """Return how much of what a vehicle withstands is used; a world without a ground is level."""
    stance = Stance(jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))
    if truth.ground is not None:
        stance = truth.ground.stance(chassis, robot.position(state), robot.heading(state))
    return chassis.stability(stance, *robot.acceleration(state, control))


def drive_on_wheels(
    wheels: Wheels, robot: Dynamics, before: StateVector, after: StateVector
) -> StateVector:
    """Return where the vehicle gets to on its wheels (nx,).

    With a wheel in the air, `1 - TRACTION` of the displacement is lost. A vehicle that has tipped
    over stays where it lies. `after` is the state with all wheels on the ground.
    """
    moves = jnp.asarray([name in ("x", "y", "yaw") for name in robot.state_names])
    slipped = jnp.where(moves, before + TRACTION * (after - before), after)
    moved = jnp.where(wheels.used.is_hanging, slipped, after)
    return jnp.where(wheels.is_tipped, robot.resolve_collision(before, before), moved)


def update_wheels(wheels: Wheels, used: Stability, period: Scalar) -> Wheels:
    """Return the vehicle on its wheels one period [s] later; `used` is how much is used then."""
    longer = jnp.where(used.is_tipped, wheels.tipping + period, 0.0)
    return Wheels(used, jnp.where(wheels.is_tipped, wheels.tipping, longer))
