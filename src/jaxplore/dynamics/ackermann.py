"""Model a car with acceleration and steering-rate controls."""

import math
from typing import ClassVar

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Scalar, StateVector
from jaxplore._xla import compute
from jaxplore.dynamics._bounds import (
    BrakingLimits,
    acceleration_range,
    acceleration_to,
    speed_range,
)
from jaxplore.dynamics.base import ContinuousDynamics
from jaxplore.dynamics.integrators import RK4, Integrator
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.footprint import Footprint, Rectangle


class Ackermann(ContinuousDynamics):
    """Car with Ackermann steering and a bounded steering rate, without wheel slip.

    State (x, y, yaw, v, steering) [m, m, rad, m/s, rad] of the middle of the rear axle, control
    (a, steering_rate) [m/s^2, rad/s]:

        x' = v cos(yaw),  y' = v sin(yaw),  yaw' = v tan(steering) / wheelbase
        v' = a - c v,  steering' = steering_rate

    v and steering are clipped to their bounds. A constant steering angle gives a circle of radius
    wheelbase / tan(steering). The footprint is a rectangle, covered by discs.

    Source: LaValle, "Planning Algorithms", 2006, section 13.1.2, where the steering angle is a
    control.

    Args:
        wheelbase: distance between the axles [m].
        max_speed: upper bound of v [m/s].
        max_steering: bound of |steering|, below pi/2 [rad].
        max_acceleration: bound of |a|, or of |a| while |v| grows beside a `max_deceleration`
            [m/s^2].
        max_steering_rate: bound of |steering_rate| [rad/s].
        min_speed: lower bound of v [m/s]; negative to drive backwards.
        drag: drag coefficient c, fraction of the speed lost per second [1/s].
        footprint: footprint with its origin at the middle of the rear axle. By default a rectangle
            that reaches a quarter of the wheelbase beyond either axle and is 0.8 of the wheelbase
            wide, covered by two discs.
        integrator: time integrator; `RK4()` by default.
        max_deceleration: bound of |a| while |v| shrinks, for brakes that differ from the motor
            [m/s^2]; `max_acceleration` when absent.

    Raises:
        ValueError: a length or bound that is not positive, a negative drag, a `max_steering` of
            pi/2 or more, a `min_speed` that is not below `max_speed`.
    """

    state_names: ClassVar[tuple[str, ...]] = ("x", "y", "yaw", "v", "steering")
    control_names: ClassVar[tuple[str, ...]] = ("a", "steering_rate")

    wheelbase: Scalar
    min_speed: Scalar
    max_speed: Scalar
    max_steering: Scalar
    control_min: ControlVector
    control_max: ControlVector
    drag: Scalar
    outline: Footprint
    integrator: Integrator
    limits: BrakingLimits | None

    @_kinds.check_arguments
    def __init__(
        self,
        wheelbase: ArrayLike = 0.5,
        max_speed: ArrayLike = 5.0,
        max_steering: ArrayLike = 0.6,
        max_acceleration: ArrayLike = 2.0,
        max_steering_rate: ArrayLike = 1.0,
        min_speed: ArrayLike = 0.0,
        drag: ArrayLike = 0.0,
        footprint: Footprint | None = None,
        integrator: Integrator | None = None,
        max_deceleration: ArrayLike | None = None,
    ) -> None:
        self.wheelbase = _checks.scalar("wheelbase", wheelbase, above=0.0)
        self.min_speed, self.max_speed = speed_range(min_speed, max_speed)
        self.max_steering = _checks.scalar(
            "max_steering", max_steering, above=0.0, below=0.5 * math.pi
        )
        lowest, highest, self.limits = acceleration_range(
            max_acceleration, max_deceleration, self.min_speed
        )
        steering_rate = _checks.scalar("max_steering_rate", max_steering_rate, above=0.0)
        self.control_min = compute(
            lambda xp, low, rate: xp.stack([low, -rate]), lowest, steering_rate
        )
        self.control_max = compute(lambda xp, *each: xp.stack(each), highest, steering_rate)
        self.drag = _checks.scalar("drag", drag, at_least=0.0)
        if footprint is None:
            overhang, width = 0.25 * self.wheelbase, 0.8 * self.wheelbase
            # The number of discs is given, because it cannot be derived from a traced wheelbase.
            footprint = Rectangle(self.wheelbase + overhang, overhang, width, num_discs=2)
        # Stored under another name, because `footprint` is a property of every model.
        self.outline = footprint
        self.integrator = RK4() if integrator is None else integrator

    @property
    def footprint(self) -> Footprint:
        """Footprint of the car."""
        return self.outline

    # A property instead of a field, so that it cannot disagree with the footprint.
    @property  # type: ignore[misc]
    def radius(self) -> Scalar:  # type: ignore[override]
        """Radius of the discs that cover the car [m]."""
        return self.outline.radius

    @property
    def turning_radius(self) -> Scalar:
        """Radius of the smallest circle of the middle of the rear axle [m]."""
        return compute(
            lambda xp, length, angle: length / xp.tan(angle), self.wheelbase, self.max_steering
        )

    @property
    def can_reverse(self) -> bool:
        """Whether it can drive backwards."""
        return bool(self.min_speed < 0.0)

    def derivative(self, state: StateVector, control: ControlVector) -> StateVector:
        """Return dx/dt (5,)."""
        # The inner stages of an integrator may leave the bounds that the car itself never leaves.
        _, _, yaw, v, steering = self.project(state)
        a, steering_rate = control
        sin_yaw, cos_yaw = sin_cos(yaw)
        # The tangent is sin / cos, because tan is slow on a CPU: see `KinematicBicycle`.
        sin_steering, cos_steering = sin_cos(steering)
        return jnp.stack(
            [
                v * cos_yaw,
                v * sin_yaw,
                v * sin_steering / (cos_steering * self.wheelbase),
                a - self.drag * v,
                steering_rate,
            ]
        )

    def project(self, state: StateVector) -> StateVector:
        """Return the state (5,) with speed and steering within their bounds."""
        x, y, yaw, v, steering = state
        return jnp.stack(
            [
                x,
                y,
                yaw,
                jnp.clip(v, self.min_speed, self.max_speed),
                jnp.clip(steering, -self.max_steering, self.max_steering),
            ]
        )

    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return the state (5,) after `dt` seconds under a control (2,)."""
        state, control, dt = self.check_step(state, control, dt)
        return super().step(state, self._limit(state, control, dt), dt)

    @property
    def deceleration(self) -> Scalar:
        """Deceleration with which the robot can be brought to rest [m/s^2]."""
        return self.control_max[0] if self.limits is None else self.limits.braking

    def stopping_control(
        self, state: StateVector, dt: Scalar, turn: ArrayLike = 0.0
    ) -> ControlVector:
        """Return the control (2,) that brakes hardest, and steers to the share `turn` of
        `max_steering`; a car at rest does not steer."""
        *_, v, steering = state
        a = acceleration_to(0.0, v, self.drag, self.integrator, dt)
        # Backwards, wheels that point to the left turn the car clockwise.
        target = jnp.sign(v) * turn * self.max_steering
        steering_rate = jnp.where(v == 0.0, 0.0, (target - steering) / dt)
        control = jnp.clip(jnp.stack([a, steering_rate]), self.control_min, self.control_max)
        return self._limit(state, control, dt)

    def _limit(self, state: StateVector, control: ControlVector, dt: Scalar) -> ControlVector:
        """Return the control (2,) with an acceleration that the limits admit."""
        if self.limits is None:
            return control
        a, steering_rate = control
        return jnp.stack([self.limits.clip(a, state[3], dt), steering_rate])
