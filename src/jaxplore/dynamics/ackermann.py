"""A car with acceleration and steering rate."""

import math
from typing import ClassVar

import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import ControlVector, Scalar, StateVector
from jaxplore.dynamics._bounds import speed_range
from jaxplore.dynamics.base import ContinuousDynamics
from jaxplore.dynamics.integrators import RK4, Integrator


class Ackermann(ContinuousDynamics):
    """Car with Ackermann steering, whose steering angle takes its time; no wheel slips.

    State (x, y, yaw, v, steering) [m, m, rad, m/s, rad] of the middle of the rear axle, control
    (a, steering_rate) [m/s^2, rad/s]:

        x' = v cos(yaw),  y' = v sin(yaw),  yaw' = v tan(steering) / wheelbase
        v' = a - c v,  steering' = steering_rate

    v and steering stay within their bounds. Held steering drives a circle of radius
    wheelbase / tan(steering).

    Source: LaValle, "Planning Algorithms", 2006, section 13.1.2; the steering angle is a control
    there.

    Args:
        wheelbase: distance between the axles [m].
        max_speed: upper bound of v [m/s].
        max_steering: bound of |steering|, below pi/2 [rad].
        max_acceleration: bound of |a| [m/s^2].
        max_steering_rate: bound of |steering_rate| [rad/s].
        min_speed: lower bound of v [m/s]; negative to drive backwards.
        drag: c, share of the speed lost per second [1/s].
        radius: radius of the disc around the middle of the rear axle that holds the robot [m].
        integrator: `RK4()` when absent.

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
    radius: Scalar
    integrator: Integrator

    def __init__(
        self,
        wheelbase: ArrayLike = 0.33,
        max_speed: ArrayLike = 3.0,
        max_steering: ArrayLike = 0.42,
        max_acceleration: ArrayLike = 2.0,
        max_steering_rate: ArrayLike = 3.0,
        min_speed: ArrayLike = 0.0,
        drag: ArrayLike = 0.0,
        radius: ArrayLike = 0.45,
        integrator: Integrator | None = None,
    ) -> None:
        self.wheelbase = _checks.scalar("wheelbase", wheelbase, above=0.0)
        self.min_speed, self.max_speed = speed_range(min_speed, max_speed)
        self.max_steering = _checks.scalar(
            "max_steering", max_steering, above=0.0, below=0.5 * math.pi
        )
        self.control_max = jnp.stack(
            [
                _checks.scalar("max_acceleration", max_acceleration, above=0.0),
                _checks.scalar("max_steering_rate", max_steering_rate, above=0.0),
            ]
        )
        self.control_min = -self.control_max
        self.drag = _checks.scalar("drag", drag, at_least=0.0)
        self.radius = _checks.scalar("radius", radius, above=0.0)
        self.integrator = RK4() if integrator is None else integrator

    def derivative(self, state: StateVector, control: ControlVector) -> StateVector:
        """Return dx/dt (5,)."""
        # Between two steps an integrator may look beyond the bounds, which the car never reaches.
        _, _, yaw, v, steering = self.project(state)
        a, steering_rate = control
        return jnp.stack(
            [
                v * jnp.cos(yaw),
                v * jnp.sin(yaw),
                v * jnp.tan(steering) / self.wheelbase,
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
