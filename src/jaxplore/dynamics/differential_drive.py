"""Model a robot with two driven wheels and inertia."""

from typing import ClassVar

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Scalar, StateVector
from jaxplore._xla import compute
from jaxplore.dynamics._bounds import acceleration_range, acceleration_to, radius_of_robot
from jaxplore.dynamics.base import ContinuousDynamics
from jaxplore.dynamics.integrators import Euler, Integrator
from jaxplore.geometry.angles import sin_cos


class DifferentialDrive(ContinuousDynamics):
    """Differential drive with acceleration controls and linear drag.

    State (x, y, yaw, v, omega) [m, m, rad, m/s, rad/s], control (a, alpha) [m/s^2, rad/s^2]:

        x' = v cos(yaw),  y' = v sin(yaw),  yaw' = omega
        v' = a - c v,  omega' = alpha - c omega

    After each step v is clipped to [0, max_speed] and omega to +-max_turn_rate. The robot drives
    forwards only, and can turn on the spot.

    Args:
        max_speed: upper bound of v [m/s].
        max_turn_rate: bound of |omega| [rad/s].
        max_acceleration: bound of |a|, or of a beside a `max_deceleration` [m/s^2].
        max_angular_acceleration: bound of |alpha| [rad/s^2].
        drag: drag coefficient c, fraction of v and omega lost per second [1/s].
        radius: radius of the disc that contains the robot [m].
        integrator: time integrator; by default `Euler()`, which is cheap. `RK4()` is more accurate,
            except in steps in which a speed is clipped.
        max_deceleration: bound of -a, for brakes that differ from the motor [m/s^2]; that of |a|
            when absent.

    Raises:
        ValueError: a bound or radius that is not positive, a negative drag.
    """

    state_names: ClassVar[tuple[str, ...]] = ("x", "y", "yaw", "v", "omega")
    control_names: ClassVar[tuple[str, ...]] = ("a", "alpha")

    max_speed: Scalar
    max_turn_rate: Scalar
    control_min: ControlVector
    control_max: ControlVector
    drag: Scalar
    radius: Scalar
    integrator: Integrator

    @_kinds.check_arguments
    def __init__(
        self,
        max_speed: ArrayLike = 1.0,
        max_turn_rate: ArrayLike = 2.0,
        max_acceleration: ArrayLike = 1.0,
        max_angular_acceleration: ArrayLike = 2.0,
        drag: ArrayLike = 0.1,
        radius: ArrayLike = 0.2,
        integrator: Integrator | None = None,
        max_deceleration: ArrayLike | None = None,
    ) -> None:
        self.max_speed = _checks.scalar("max_speed", max_speed, above=0.0)
        self.max_turn_rate = _checks.scalar("max_turn_rate", max_turn_rate, above=0.0)
        # The robot drives forwards only, so the sign of a tells speeding up from braking.
        lowest, highest, _ = acceleration_range(max_acceleration, max_deceleration, jnp.zeros(()))
        turn = _checks.scalar("max_angular_acceleration", max_angular_acceleration, above=0.0)
        self.control_min = compute(lambda xp, low, turn: xp.stack([low, -turn]), lowest, turn)
        self.control_max = compute(lambda xp, *each: xp.stack(each), highest, turn)
        self.drag = _checks.scalar("drag", drag, at_least=0.0)
        self.radius = radius_of_robot(radius)
        self.integrator = Euler() if integrator is None else integrator

    def derivative(self, state: StateVector, control: ControlVector) -> StateVector:
        """Return dx/dt (5,)."""
        _, _, yaw, v, omega = state
        a, alpha = control
        sin, cos = sin_cos(yaw)
        return jnp.stack(
            [
                v * cos,
                v * sin,
                omega,
                a - self.drag * v,
                alpha - self.drag * omega,
            ]
        )

    def project(self, state: StateVector) -> StateVector:
        """Return the state (5,) with both speeds within their bounds."""
        x, y, yaw, v, omega = state
        return jnp.stack(
            [
                x,
                y,
                yaw,
                jnp.clip(v, 0.0, self.max_speed),
                jnp.clip(omega, -self.max_turn_rate, self.max_turn_rate),
            ]
        )

    @property
    def deceleration(self) -> Scalar:
        """Deceleration with which the robot can be brought to rest [m/s^2]."""
        return -self.control_min[0]

    def stopping_control(
        self, state: StateVector, dt: Scalar, turn: ArrayLike = 0.0
    ) -> ControlVector:
        """Return the control (2,) that brakes hardest.

        The turn rate goes to the share `turn` of its bound, and to zero together with v.
        """
        *_, v, omega = state
        deceleration, turn_rate_change = -self.control_min[0], self.control_max[1]
        a = acceleration_to(0.0, v, self.drag, self.integrator, dt)
        # The turn rate that can still be braked in the time that v needs after this step.
        left = jnp.maximum(v / deceleration - dt, 0.0)
        target = turn * jnp.minimum(self.max_turn_rate, turn_rate_change * left)
        alpha = acceleration_to(target, omega, self.drag, self.integrator, dt)
        return jnp.clip(jnp.stack([a, alpha]), self.control_min, self.control_max)
