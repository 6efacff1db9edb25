"""Model a car as a kinematic bicycle about its centre of gravity."""

import math
from typing import ClassVar

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Scalar, StateVector
from jaxplore._xla import compute, cut
from jaxplore.dynamics._bounds import acceleration_to, radius_of_robot, speed_range
from jaxplore.dynamics.base import ContinuousDynamics
from jaxplore.dynamics.integrators import RK4, Derivative, Integrator
from jaxplore.geometry.angles import sin_cos


class KinematicBicycle(ContinuousDynamics):
    """Kinematic bicycle with the steering angle as a control, without wheel slip.

    State (x, y, yaw, v) [m, m, rad, m/s] of the centre of gravity, control (a, steering)
    [m/s^2, rad]. The velocity is at the slip angle beta to the heading:

        beta = atan(l_r / (l_f + l_r) tan(steering))
        x' = v cos(yaw + beta),  y' = v sin(yaw + beta)
        yaw' = v cos(beta) tan(steering) / (l_f + l_r),  v' = a

    v is clipped to its bounds.

    Sources: Rajamani, "Vehicle Dynamics and Control", section 2.2; Kong, Pfeiffer, Schildbach and
    Borrelli, "Kinematic and dynamic vehicle models for autonomous driving control design", IV 2015,
    eq. 1, which writes yaw' = v sin(beta) / l_r.

    Args:
        front_length: l_f, distance from the centre of gravity to the front axle [m].
        rear_length: l_r, distance from the centre of gravity to the rear axle [m].
        max_speed: upper bound of v [m/s].
        max_steering: bound of |steering|, below pi/2 [rad].
        max_acceleration: bound of |a| [m/s^2].
        min_speed: lower bound of v [m/s]; negative to drive backwards.
        radius: radius of the disc around the centre of gravity that contains the robot [m].
        integrator: time integrator; `RK4()` by default.

    Raises:
        ValueError: a length or bound that is not positive, a `max_steering` of pi/2 or more, a
            `min_speed` that is not below `max_speed`.
    """

    state_names: ClassVar[tuple[str, ...]] = ("x", "y", "yaw", "v")
    control_names: ClassVar[tuple[str, ...]] = ("a", "steering")

    front_length: Scalar
    rear_length: Scalar
    min_speed: Scalar
    max_speed: Scalar
    control_min: ControlVector
    control_max: ControlVector
    radius: Scalar
    integrator: Integrator

    @_kinds.check_arguments
    def __init__(
        self,
        front_length: ArrayLike = 0.16,
        rear_length: ArrayLike = 0.17,
        max_speed: ArrayLike = 3.0,
        max_steering: ArrayLike = 0.42,
        max_acceleration: ArrayLike = 2.0,
        min_speed: ArrayLike = 0.0,
        radius: ArrayLike = 0.3,
        integrator: Integrator | None = None,
    ) -> None:
        self.front_length = _checks.scalar("front_length", front_length, above=0.0)
        self.rear_length = _checks.scalar("rear_length", rear_length, above=0.0)
        self.min_speed, self.max_speed = speed_range(min_speed, max_speed)
        self.control_max = compute(
            lambda xp, *each: xp.stack(each),
            _checks.scalar("max_acceleration", max_acceleration, above=0.0),
            _checks.scalar("max_steering", max_steering, above=0.0, below=0.5 * math.pi),
        )
        self.control_min = compute(lambda xp, high: -high, self.control_max)
        self.radius = radius_of_robot(radius)
        self.integrator = RK4() if integrator is None else integrator

    @property
    def turning_radius(self) -> Scalar:
        """Radius of the smallest circle of the centre of gravity [m]."""
        return compute(
            lambda xp, front, rear, bound: xp.hypot((front + rear) / xp.tan(bound[1]), rear),
            self.front_length,
            self.rear_length,
            self.control_max,
        )

    @property
    def can_reverse(self) -> bool:
        """Whether it can drive backwards."""
        return bool(self.min_speed < 0.0)

    def derivative(self, state: StateVector, control: ControlVector) -> StateVector:
        """Return dx/dt (4,)."""
        return self.derivative_under(control)(state, control)

    def derivative_under(self, control: ControlVector) -> Derivative:
        """Return the derivative function for a control that is constant during the step."""
        steering = control[1]
        # Avoid tan and arctan: on a CPU they take longer than all the rest.
        wheelbase = self.front_length + self.rear_length
        sine, cosine = sin_cos(steering)
        turn = sine / (wheelbase * cosine)
        tan_beta = self.rear_length * turn
        cos_beta = 1.0 / jnp.sqrt(1.0 + tan_beta * tan_beta)
        # All stages of the integrator read these. Without the cut each would compute them again.
        cos_beta, sin_beta, bend = cut((cos_beta, tan_beta * cos_beta, cos_beta * turn))

        def rate(state: StateVector, control: ControlVector) -> StateVector:
            # The inner stages of an integrator may leave the bounds that the car itself never
            # leaves.
            _, _, yaw, v = self.project(state)
            sin_yaw, cos_yaw = sin_cos(yaw)
            return jnp.stack(
                [
                    v * (cos_yaw * cos_beta - sin_yaw * sin_beta),
                    v * (sin_yaw * cos_beta + cos_yaw * sin_beta),
                    v * bend,
                    control[0],
                ]
            )

        return rate

    def project(self, state: StateVector) -> StateVector:
        """Return the state (4,) with the speed within its bounds."""
        x, y, yaw, v = state
        return jnp.stack([x, y, yaw, jnp.clip(v, self.min_speed, self.max_speed)])

    @property
    def deceleration(self) -> Scalar:
        """Deceleration with which the robot can be brought to rest [m/s^2]."""
        return -self.control_min[0]

    def stopping_control(
        self, state: StateVector, dt: Scalar, turn: ArrayLike = 0.0
    ) -> ControlVector:
        """Return the control (2,) that brakes hardest with the share `turn` of the steering."""
        v = state[3]
        a = acceleration_to(0.0, v, jnp.zeros(()), self.integrator, dt)
        # Backwards, wheels that point to the left turn the car clockwise.
        steering = jnp.sign(v) * turn * self.control_max[1]
        return jnp.clip(jnp.stack([a, steering]), self.control_min, self.control_max)
