"""The follower of quadrotors."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, ControlVector, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.vectors import TINY, angle, length
from jaxplore.planning.strategy.follower import SLOW, Follower, approach_gain, require_model

LEAST_LIFT = 0.2
"""Lowest vertical thrust, as a share of the weight: without thrust a quadrotor cannot steer."""


class QuadrotorFollower(Follower):
    """Cascaded tracking law for `Quadrotor`: position, velocity, attitude.

        a = k_v (velocity + s e - v),   e = target - p,   s = k_p / k_v near the target
        f = (0, 0, gravity) - a, tilted at most max_tilt;   thrust = mass f . b,   b = R(q) e_z
        (w_x, w_y) = k_R (angle from b to f about their common normal),   w_z = k_yaw (yaw error)

    Near the target a is `k_p e + k_v (velocity - v)`. s falls with the distance, so that braking
    takes about half of the acceleration that the tilt allows. The nose turns to the direction in
    which the target moves over ground, if it moves faster than 0.1 m/s; otherwise to `heading`, or
    the yaw is held.
    Thrust direction and yaw are controlled separately, since a turn about the thrust does not
    change the thrust.

    The rate loop lags by `rate_time_constant` and each command is held for a step. The tilt
    overshoots by about a tenth while `k_R (rate_time_constant + dt / 2)` is below 0.7. Each loop
    should be at most half as fast as the one inside it: k_v <= k_R / 2, k_p / k_v <= k_v / 2.

    Source: Lee, Leok and McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)", CDC
    2010: thrust and its direction; Mellinger and Kumar, "Minimum snap trajectory generation and
    control for quadrotors", ICRA 2011: heading from the reference; Brescianini and D'Andrea,
    "Tilt-prioritized quadrocopter attitude control", 2020: the angle in place of its sine, which
    vanishes upside down.

    Args:
        position_gain: gain on the position error, k_p [1/s^2].
        velocity_gain: gain on the velocity error, k_v [1/s].
        attitude_gain: gain on the tilt error, k_R [1/s].
        yaw_gain: gain on the yaw error, k_yaw [1/s].
        max_tilt: largest commanded angle between thrust and vertical, below pi/2 [rad].
        heading: yaw to turn to while the target does not move over ground [rad]; the present yaw is
            held when absent.

    Raises:
        ValueError: a gain or a tilt that is not positive, a tilt of pi/2 or more, a heading that is
            not finite.
    """

    position_gain: Scalar
    velocity_gain: Scalar
    attitude_gain: Scalar
    yaw_gain: Scalar
    max_tilt: Scalar
    heading: Scalar | None

    def __init__(
        self,
        position_gain: ArrayLike = 6.0,
        velocity_gain: ArrayLike = 4.0,
        attitude_gain: ArrayLike = 8.0,
        yaw_gain: ArrayLike = 2.0,
        max_tilt: ArrayLike = 0.7,
        heading: ArrayLike | None = None,
    ) -> None:
        self.position_gain = _checks.scalar("position_gain", position_gain, above=0.0)
        self.velocity_gain = _checks.scalar("velocity_gain", velocity_gain, above=0.0)
        self.attitude_gain = _checks.scalar("attitude_gain", attitude_gain, above=0.0)
        self.yaw_gain = _checks.scalar("yaw_gain", yaw_gain, above=0.0)
        self.max_tilt = _checks.scalar("max_tilt", max_tilt, above=0.0, below=0.5 * math.pi)
        self.heading = None if heading is None else _checks.scalar("heading", heading)

    def control(
        self,
        dynamics: Dynamics,
        state: StateVector,
        target: Float[Array, " D"],
        velocity: Float[Array, " D"],
    ) -> ControlVector:
        """Evaluate the law: thrust and body rates (4,)."""
        model = require_model(dynamics, Quadrotor)
        if target.shape != (3,) or velocity.shape != (3,):
            raise ValueError(
                f"target and velocity have shapes {target.shape} and {velocity.shape}; "
                "accepted: (3,), with z"
            )
        _, _, _, _, _, _, qw, qx, qy, qz, _, _, _ = state
        fx, fy, fz = self._force(model, state, target, velocity)

        squared = qw * qw + qx * qx + qy * qy + qz * qz
        # The model treats a quaternion of zeros as level, and so does the law.
        is_zero = squared < TINY
        qw, squared = jnp.where(is_zero, 1.0, qw), jnp.where(is_zero, 1.0, squared)
        # Body axes in the world frame, times |q|^2: the state need not be normalised exactly.
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
        # Exactly upside down, all rotations to level are equally long. The law then rolls.
        wx = jnp.where(is_parallel, lean, -scale * aside)

        is_moving = length(velocity[0], velocity[1]) > SLOW
        if self.heading is None:
            towards, turns = (velocity[0], velocity[1]), is_moving
        else:
            sin, cos = sin_cos(self.heading)
            towards = (
                jnp.where(is_moving, velocity[0], cos),
                jnp.where(is_moving, velocity[1], sin),
            )
            turns = jnp.array(True)
        facing, beside = (towards[0] * axis[0] + towards[1] * axis[1] for axis in (forward, right))
        wz = jnp.where(turns, self.yaw_gain * angle(facing, beside), 0.0)
        # Only the thrust is proportional to |q|^2. The rates are made of angles and ratios.
        return jnp.stack([model.mass * below / squared, wx, scale * ahead, wz])

    def _force(
        self, model: Quadrotor, state: StateVector, target: Array, velocity: Array
    ) -> tuple[Scalar, Scalar, Scalar]:
        """Compute the wanted thrust per mass, with the sign of the body's z axis (down) [m/s^2]."""
        steepest = jnp.tan(self.max_tilt)
        away = [target[i] - state[i] for i in range(3)]
        braking = 0.5 * model.gravity * steepest
        gain = approach_gain(self.position_gain / self.velocity_gain, length(*away), braking)
        ax, ay, az = (
            self.velocity_gain * (velocity[i] + gain * away[i] - state[3 + i]) for i in range(3)
        )
        fz = jnp.maximum(model.gravity - az, LEAST_LIFT * model.gravity)
        # Beyond the largest tilt the horizontal part is shortened: height matters more.
        aside, most = length(ax, ay), steepest * fz
        is_steep = aside > most
        share = jnp.where(is_steep, most / jnp.where(is_steep, aside, 1.0), 1.0)
        return -share * ax, -share * ay, fz
