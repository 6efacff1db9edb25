"""Followers of ground robots, and the choice of a follower for a model."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.differential_drive import DifferentialDrive
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.dynamics.unicycle import Unicycle
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.vectors import angle, length
from jaxplore.planning.strategy.follower import SLOW, Follower, approach_gain, require_model
from jaxplore.planning.strategy.quadrotor_follower import QuadrotorFollower
from jaxplore.planning.strategy.twist_follower import TwistFollower, drives


class UnicycleFollower(Follower):
    """Tracking law for `Unicycle`, in the robot's frame:

        (u_x, u_y) = R(-yaw) (velocity + k (target - p))
        v = max(u_x, 0),   omega = k_yaw atan2(u_y, u_x) |u|^2 / (|u|^2 + 0.1^2)

    The speed is that of Kanayama et al. Their turn rate needs a moving target. This one turns the
    robot towards u, so it also reaches a fixed point. It fades with |u|, since at rest on the
    target no direction is preferred. For a target behind it, the robot turns on the spot.

    Source: Kanayama, Kimura, Miyazaki, Noguchi, "A stable tracking control method for an autonomous
    mobile robot", ICRA 1990, whose v is u_x.

    Args:
        position_gain: gain on the position error, k [1/s].
        heading_gain: gain on the heading error, k_yaw [1/s]; below `1 / dt`.

    Raises:
        ValueError: a gain that is not positive.
    """

    position_gain: Scalar
    heading_gain: Scalar

    def __init__(self, position_gain: ArrayLike = 1.5, heading_gain: ArrayLike = 4.0) -> None:
        self.position_gain = _checks.scalar("position_gain", position_gain, above=0.0)
        self.heading_gain = _checks.scalar("heading_gain", heading_gain, above=0.0)

    def control(
        self,
        dynamics: Dynamics,
        state: StateVector,
        target: Float[Array, " D"],
        velocity: Float[Array, " D"],
    ) -> ControlVector:
        """Evaluate the law: speed and turn rate (2,)."""
        require_model(dynamics, Unicycle)
        x, y, yaw = state
        wanted = [
            velocity[i] + self.position_gain * (target[i] - place) for i, place in enumerate((x, y))
        ]
        speed, turn, confidence = _steering(yaw, *wanted)
        return jnp.stack([speed, self.heading_gain * confidence * turn])


class DifferentialDriveFollower(Follower):
    """Tracking law for `DifferentialDrive`: `UnicycleFollower` with an inner loop for each speed:

        a = k_v (v_wanted - v) + drag v,   alpha = k_omega (omega_wanted - omega) + drag omega

    with v_wanted and omega_wanted those of `UnicycleFollower`. There k and k_yaw fall with the
    distance and the angle to go, so that braking takes about half of the greatest acceleration.

    Source: Kanayama, Kimura, Miyazaki, Noguchi, "A stable tracking control method for an autonomous
    mobile robot", ICRA 1990.

    Args:
        position_gain: gain on the position error, k [1/s]; at most half of `speed_gain`, a quarter
            for no overshoot.
        heading_gain: gain on the heading error, k_yaw [1/s]; at most half of `turn_rate_gain`.
        speed_gain: gain on the speed error, k_v [1/s]; below `1 / dt`.
        turn_rate_gain: gain on the turn-rate error, k_omega [1/s]; below `1 / dt`.

    Raises:
        ValueError: a gain that is not positive.
    """

    position_gain: Scalar
    heading_gain: Scalar
    speed_gain: Scalar
    turn_rate_gain: Scalar

    def __init__(
        self,
        position_gain: ArrayLike = 1.2,
        heading_gain: ArrayLike = 3.0,
        speed_gain: ArrayLike = 5.0,
        turn_rate_gain: ArrayLike = 8.0,
    ) -> None:
        self.position_gain = _checks.scalar("position_gain", position_gain, above=0.0)
        self.heading_gain = _checks.scalar("heading_gain", heading_gain, above=0.0)
        self.speed_gain = _checks.scalar("speed_gain", speed_gain, above=0.0)
        self.turn_rate_gain = _checks.scalar("turn_rate_gain", turn_rate_gain, above=0.0)

    def control(
        self,
        dynamics: Dynamics,
        state: StateVector,
        target: Float[Array, " D"],
        velocity: Float[Array, " D"],
    ) -> ControlVector:
        """Evaluate the law: linear and angular acceleration (2,)."""
        model = require_model(dynamics, DifferentialDrive)
        x, y, yaw, v, omega = state
        braking, turn_braking = 0.5 * model.control_max
        away = (target[0] - x, target[1] - y)
        gain = approach_gain(self.position_gain, length(*away), braking)
        speed, turn, confidence = _steering(
            yaw, velocity[0] + gain * away[0], velocity[1] + gain * away[1]
        )
        turn_gain = approach_gain(self.heading_gain, jnp.abs(turn), turn_braking)
        turn_rate = confidence * turn_gain * turn
        # The law adds the drag, by which the model reduces both speeds.
        return jnp.stack(
            [
                self.speed_gain * (speed - v) + model.drag * v,
                self.turn_rate_gain * (turn_rate - omega) + model.drag * omega,
            ]
        )


@_kinds.check_arguments
def follower_for(dynamics: Dynamics) -> Follower:
    """Return the follower for a model, with its default gains.

    It is `QuadrotorFollower`, `DifferentialDriveFollower` or `UnicycleFollower` for these models,
    and `TwistFollower` for any other model with x, y and yaw, without z.

    Raises:
        ValueError: a model without a follower.
    """
    followers: dict[type[Dynamics], type[Follower]] = {
        Quadrotor: QuadrotorFollower,
        DifferentialDrive: DifferentialDriveFollower,
        Unicycle: UnicycleFollower,
    }
    for model, follower in followers.items():
        if isinstance(dynamics, model):
            return follower()
    if drives(dynamics):
        return TwistFollower(reverses=dynamics.can_reverse)
    raise ValueError(
        f"dynamics is a {type(dynamics).__name__}; accepted: a Quadrotor, or a model with x, y and "
        "yaw, without z"
    )


def _steering(yaw: Scalar, x: Scalar, y: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Convert a wanted velocity (x, y) in the world to the motion of a robot that drives forwards.

    That is the speed [m/s], the angle to turn by [rad], and the weight of the angle, from 0 to 1.
    """
    sin, cos = sin_cos(yaw)
    ahead, aside = cos * x + sin * y, cos * y - sin * x
    squared = x * x + y * y
    confidence = squared / (squared + SLOW * SLOW)
    return jnp.maximum(ahead, 0.0), angle(ahead, aside), confidence
