"""Model a robot that drives in any direction, such as one on mecanum wheels."""

from typing import ClassVar

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Scalar, StateVector
from jaxplore._xla import compute
from jaxplore.dynamics._bounds import (
    BrakingLimits,
    acceleration_range,
    acceleration_to,
    radius_of_robot,
    shrink,
    speed_range,
)
from jaxplore.dynamics.base import ContinuousDynamics
from jaxplore.dynamics.integrators import Euler, Integrator
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.vectors import length


class Omnidirectional(ContinuousDynamics):
    """Omnidirectional robot with accelerations in its body frame as controls, and linear drag.

    State (x, y, yaw, vx, vy, omega) [m, m, rad, m/s, m/s, rad/s] with vx forwards and vy to the
    left, control (ax, ay, alpha) [m/s^2, m/s^2, rad/s^2]:

        x' = vx cos(yaw) - vy sin(yaw),  y' = vx sin(yaw) + vy cos(yaw),  yaw' = omega
        vx' = ax - c vx,  vy' = ay - c vy,  omega' = alpha - c omega

    The velocity is that of a drive in its own frame, as wheels are commanded: it turns with the
    robot. After each step vx is clipped to [min_speed, max_speed], vy to +-max_lateral_speed and
    omega to +-max_turn_rate.

    Args:
        max_speed: upper bound of vx [m/s].
        max_turn_rate: bound of |omega| [rad/s].
        max_acceleration: bound of |ax| and |ay| [m/s^2].
        max_angular_acceleration: bound of |alpha| [rad/s^2].
        drag: drag coefficient c, fraction of the velocities lost per second [1/s].
        radius: radius of the disc that contains the robot [m].
        integrator: time integrator; by default `Euler()`, as for `DifferentialDrive`.
        max_deceleration: bound of |ax| while |vx| shrinks, and of |ay| while |vy| does [m/s^2];
            `max_acceleration` when absent.
        min_speed: lower bound of vx [m/s]; negative to drive backwards.
        max_lateral_speed: bound of |vy| [m/s]; `max_speed` when absent.

    Raises:
        ValueError: a bound or radius that is not positive, a negative drag, a `min_speed` that is
            not below `max_speed`.
    """

    state_names: ClassVar[tuple[str, ...]] = ("x", "y", "yaw", "vx", "vy", "omega")
    control_names: ClassVar[tuple[str, ...]] = ("ax", "ay", "alpha")

    min_speed: Scalar
    max_speed: Scalar
    max_lateral_speed: Scalar
    max_turn_rate: Scalar
    control_min: ControlVector
    control_max: ControlVector
    drag: Scalar
    radius: Scalar
    integrator: Integrator
    limits: BrakingLimits | None

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
        min_speed: ArrayLike = 0.0,
        max_lateral_speed: ArrayLike | None = None,
    ) -> None:
        self.min_speed, self.max_speed = speed_range(min_speed, max_speed)
        self.max_lateral_speed = (
            self.max_speed
            if max_lateral_speed is None
            else _checks.scalar("max_lateral_speed", max_lateral_speed, above=0.0)
        )
        self.max_turn_rate = _checks.scalar("max_turn_rate", max_turn_rate, above=0.0)
        # The lateral speed has both signs, and ax the same bounds as ay: `limits` tells them apart.
        _, highest, self.limits = acceleration_range(
            max_acceleration, max_deceleration, jnp.asarray(-1.0)
        )
        turn = _checks.scalar("max_angular_acceleration", max_angular_acceleration, above=0.0)
        self.control_max = compute(lambda xp, *each: xp.stack(each), highest, highest, turn)
        self.control_min = compute(lambda xp, high: -high, self.control_max)
        self.drag = _checks.scalar("drag", drag, at_least=0.0)
        self.radius = radius_of_robot(radius)
        self.integrator = Euler() if integrator is None else integrator

    def derivative(self, state: StateVector, control: ControlVector) -> StateVector:
        """Return dx/dt (6,)."""
        _, _, yaw, vx, vy, omega = state
        ax, ay, alpha = control
        sin, cos = sin_cos(yaw)
        return jnp.stack(
            [
                vx * cos - vy * sin,
                vx * sin + vy * cos,
                omega,
                ax - self.drag * vx,
                ay - self.drag * vy,
                alpha - self.drag * omega,
            ]
        )

    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return the state (6,) after `dt` seconds under a control (3,)."""
        state, control, dt = self.check_step(state, control, dt)
        return super().step(state, self._limit(state, control, dt), dt)

    def project(self, state: StateVector) -> StateVector:
        """Return the state (6,) with all speeds within their bounds."""
        x, y, yaw, vx, vy, omega = state
        return jnp.stack(
            [
                x,
                y,
                yaw,
                jnp.clip(vx, self.min_speed, self.max_speed),
                jnp.clip(vy, -self.max_lateral_speed, self.max_lateral_speed),
                jnp.clip(omega, -self.max_turn_rate, self.max_turn_rate),
            ]
        )

    def speed(self, state: StateVector) -> Scalar:
        """Return the norm of the velocity [m/s]: to the side counts as much as forwards."""
        return length(self.component(state, "vx"), self.component(state, "vy"))

    @property
    def deceleration(self) -> Scalar:
        """Deceleration with which the robot can be brought to rest, in any direction [m/s^2]."""
        return self.control_max[0] if self.limits is None else self.limits.braking

    def stopping_control(
        self, state: StateVector, dt: Scalar, turn: ArrayLike = 0.0
    ) -> ControlVector:
        """Return the control (3,) that brakes hardest, without a change of direction.

        The turn rate goes to the share `turn` of its bound, and to zero together with the velocity.
        """
        *_, vx, vy, omega = state
        braking = self.control_max[:2] if self.limits is None else self.limits.braking
        needed = [acceleration_to(0.0, v, self.drag, self.integrator, dt) for v in (vx, vy)]
        linear = shrink(jnp.stack(needed), jnp.broadcast_to(braking, (2,)))
        # The turn rate that can still be braked in the time that the velocity needs after this
        # step.
        slower = jnp.max(jnp.abs(jnp.stack([vx, vy])) / braking)
        left = jnp.maximum(slower - dt, 0.0)
        most = self.control_max[2]
        target = turn * jnp.minimum(self.max_turn_rate, most * left)
        alpha = acceleration_to(target, omega, self.drag, self.integrator, dt)
        return jnp.append(linear, jnp.clip(alpha, -most, most))

    def _limit(self, state: StateVector, control: ControlVector, dt: Scalar) -> ControlVector:
        """Return the control (3,) with accelerations that the limits admit."""
        if self.limits is None:
            return control
        ax, ay, alpha = control
        limits = self.limits
        return jnp.stack([limits.clip(ax, state[3], dt), limits.clip(ay, state[4], dt), alpha])
