"""Model a robot whose controls are its forward speed and turn rate."""

from typing import ClassVar

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Scalar, StateVector
from jaxplore._xla import compute
from jaxplore.dynamics._bounds import radius_of_robot, speed_range
from jaxplore.dynamics.base import ContinuousDynamics
from jaxplore.dynamics.integrators import RK4, Integrator
from jaxplore.geometry.angles import sin_cos


class Unicycle(ContinuousDynamics):
    """Unicycle with forward speed and turn rate as controls, without inertia.

    State (x, y, yaw) [m, m, rad], control (v, omega) [m/s, rad/s]:

        x' = v cos(yaw),  y' = v sin(yaw),  yaw' = omega

    Source: LaValle, "Planning Algorithms", 2006, section 13.1.2.

    Args:
        max_speed: upper bound of v [m/s].
        max_turn_rate: bound of |omega| [rad/s].
        min_speed: lower bound of v [m/s]; negative to drive backwards.
        radius: radius of the disc that contains the robot [m].
        integrator: time integrator; `RK4()` by default.

    Raises:
        ValueError: a bound or radius that is not positive, a `min_speed` that is not below
            `max_speed`.
    """

    state_names: ClassVar[tuple[str, ...]] = ("x", "y", "yaw")
    control_names: ClassVar[tuple[str, ...]] = ("v", "omega")

    control_min: ControlVector
    control_max: ControlVector
    radius: Scalar
    integrator: Integrator

    @_kinds.check_arguments
    def __init__(
        self,
        max_speed: ArrayLike = 1.0,
        max_turn_rate: ArrayLike = 2.0,
        min_speed: ArrayLike = 0.0,
        radius: ArrayLike = 0.2,
        integrator: Integrator | None = None,
    ) -> None:
        lowest, highest = speed_range(min_speed, max_speed)
        turn_rate = _checks.scalar("max_turn_rate", max_turn_rate, above=0.0)
        self.control_min = compute(lambda xp, low, turn: xp.stack([low, -turn]), lowest, turn_rate)
        self.control_max = compute(lambda xp, *each: xp.stack(each), highest, turn_rate)
        self.radius = radius_of_robot(radius)
        self.integrator = RK4() if integrator is None else integrator

    def derivative(self, state: StateVector, control: ControlVector) -> StateVector:
        """Return dx/dt (3,)."""
        _, _, yaw = state
        v, omega = control
        sin, cos = sin_cos(yaw)
        return jnp.stack([v * cos, v * sin, omega])

    def speed(self, state: StateVector) -> Scalar:
        """Return 0 [m/s]: the speed is a control, see `speed_under`."""
        return jnp.zeros(())

    def speed_under(self, state: StateVector, control: ControlVector) -> Scalar:
        """Return the commanded forward speed v [m/s]."""
        return control[self.control_names.index("v")]
