"""The law by which a quadrotor follows positions."""

import math

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ControlVector, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.geometry.vectors import TINY, angle, length
from jaxplore.planning.strategy.follower import SLOW, Follower, expected, nearing

LEAST_LIFT = 0.2
"""Share of the weight that a descending quadrotor still carries, so that it can steer."""


class QuadrotorFollower(Follower):
    """Cascade for `Quadrotor`: position, velocity, attitude.

        a = k_v (velocity + s e - v),   e = target - p,   s = k_p / k_v near the target
        f = (0, 0, gravity) - a, leaning at most max_tilt;   thrust = mass f . b,   b = R(q) e_z
        (w_x, w_y) = k_R (angle from b to f about their common normal),   w_z = k_yaw (yaw error)

    Near the target a is `k_p e + k_v (velocity - v)`; s falls with the distance, so that braking
    takes about half of the acceleration that the tilt allows. The nose turns to where the target
    moves, if it moves faster than 0.1 m/s over ground, and is not turned otherwise. Thrust
    direction and yaw are apart: turning about the thrust leaves it where it is.

    The rate loop lags by `rate_time_constant` and a step holds each command: the tilt overshoots by
    a tenth or so while `k_R (rate_time_constant + dt / 2)` is below 0.7. Each loop wants to be half
    as fast as the one inside it or slower: k_v <= k_R / 2, k_p / k_v <= k_v / 2.

    Source: Lee, Leok and McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)", CDC
    2010: thrust and its direction; Mellinger and Kumar, "Minimum snap trajectory generation and
    control for quadrotors", ICRA 2011: heading from the reference; Brescianini and D'Andrea,
    "Tilt-prioritized quadrocopter attitude control", 2020: the angle in place of its sine, which
    vanishes upside down.

    Args:
        position_gain: k_p [1/s^2].
        velocity_gain: k_v [1/s].
        attitude_gain: k_R [1/s].
        yaw_gain: k_yaw [1/s].
        max_tilt: greatest angle between thrust and vertical that is asked for, below pi/2 [rad].

    Raises:
        ValueError: a gain or an angle that is not positive, an angle of pi/2 or more.
    """

    position_gain: Scalar
    velocity_gain: Scalar
    attitude_gain: Scalar
    yaw_gain: Scalar
    max_tilt: Scalar

    def __init__(
        self,
        position_gain: ArrayLike = 6.0,
        velocity_gain: ArrayLike = 4.0,
        attitude_gain: ArrayLike = 8.0,
        yaw_gain: ArrayLike = 2.0,
        max_tilt: ArrayLike = 0.7,
    ) -> None:
        self.position_gain = _checks.scalar("position_gain", position_gain, above=0.0)
        self.velocity_gain = _checks.scalar("velocity_gain", velocity_gain, above=0.0)
        self.attitude_gain = _checks.scalar("attitude_gain", attitude_gain, above=0.0)
        self.yaw_gain = _checks.scalar("yaw_gain", yaw_gain, above=0.0)
        self.max_tilt = _checks.scalar("max_tilt", max_tilt, above=0.0, below=0.5 * math.pi)

    def control(
        self,
        dynamics: Dynamics,
        state: StateVector,
        target: Float[Array, " D"],
        velocity: Float[Array, " D"],
    ) -> ControlVector:
        """Return thrust and body-rate commands (4,)."""
        model = expected(dynamics, Quadrotor)
        if target.shape != (3,) or velocity.shape != (3,):
            raise ValueError(
                f"target and velocity have shapes {target.shape} and {velocity.shape}; "
                "accepted: (3,), with z"
            )
        _, _, _, _, _, _, qw, qx, qy, qz, _, _, _ = state
        fx, fy, fz = self._force(model, state, target, velocity)

        squared = qw * qw + qx * qx + qy * qy + qz * qz
        # A quaternion of zeros is level, as for the model.
        is_zero = squared < TINY
        qw, squared = jnp.where(is_zero, 1.0, qw), jnp.where(is_zero, 1.0, squared)
        # The body's axes in the world, the columns of R(q), times the squared length of q.
        forward = (
            qw * qw + qx * qx - qy * qy - qz * qz,
            2.0 * (qx * qy + qw * qz),
            2.0 * (qx * qz - qw * qy),
        )
        right = (
            2.0 * (qx * qy - qw * qz),
            qw * qw - qx * qx + qy * qy - qz * qz,
            2.0 * (qy * qz + qw * qx),
        )
        down = (
            2.0 * (qx * qz + qw * qy),
            2.0 * (qy * qz - qw * qx),
            qw * qw - qx * qx - qy * qy + qz * qz,
        )
        ahead, aside, below = (
            fx * axis[0] + fy * axis[1] + fz * axis[2] for axis in (forward, right, down)
        )
        across = length(ahead, aside)
        is_parallel = across <= 0.0
        lean = self.attitude_gain * angle(below, across)
        scale = jnp.where(is_parallel, 0.0, lean / jnp.where(is_parallel, 1.0, across))
        # Upside down every way up is as long: it rolls.
        wx = jnp.where(is_parallel, lean, -scale * aside)

        facing, beside = (
            velocity[0] * axis[0] + velocity[1] * axis[1] for axis in (forward, right)
        )
        is_moving = length(velocity[0], velocity[1]) > SLOW
        wz = jnp.where(is_moving, self.yaw_gain * angle(facing, beside), 0.0)
        return jnp.stack([model.mass * below / squared, wx, scale * ahead, wz])

    def _force(
        self, model: Quadrotor, state: StateVector, target: Array, velocity: Array
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Return the thrust per mass that is wanted, along the body's z axis (down) [m/s^2]."""
        steepest = jnp.tan(self.max_tilt)
        away = [target[i] - state[i] for i in range(3)]
        braking = 0.5 * model.gravity * steepest
        gain = nearing(self.position_gain / self.velocity_gain, length(*away), braking)
        ax, ay, az = (
            self.velocity_gain * (velocity[i] + gain * away[i] - state[3 + i]) for i in range(3)
        )
        fz = jnp.maximum(model.gravity - az, LEAST_LIFT * model.gravity)
        aside, most = length(ax, ay), steepest * fz
        is_steep = aside > most
        share = jnp.where(is_steep, most / jnp.where(is_steep, aside, 1.0), 1.0)
        return -share * ax, -share * ay, fz
