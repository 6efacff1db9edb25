"""From where a robot should be to the controls that take it there.

A planner says positions, a proposal wants controls: a feedback law, simulated along the positions
with the model itself, gives the controls that the model can execute.
"""

import abc
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ControlVector, Scalar, StateVector
from jaxplore.dynamics._vectors import TINY, angle, length
from jaxplore.dynamics.base import Dynamics
from jaxplore.dynamics.differential_drive import DifferentialDrive
from jaxplore.dynamics.quadrotor import Quadrotor
from jaxplore.dynamics.unicycle import Unicycle

SLOW = 0.1
"""Speed below which the direction of a motion says little [m/s]."""

LEAST_LIFT = 0.2
"""Share of the weight that a descending quadrotor still carries, so that it can steer."""


class Follower(eqx.Module):
    """A feedback law that turns a position reference into controls, by simulating the model.

        u_i = clip(control(x_i, r_{i-1}, (r_i - r_{i-1}) / dt)),   x_{i+1} = step(x_i, u_i, dt)

    Row r_i is where to be at (i + 1) dt, so r_{i-1} is where to be at the time of x_i. Before its
    first row the reference moves as it does after it; a single row stands still.

    The result is what `BiasedProposal` takes as its reference, for the same horizon and step.
    Written for one robot; `vmap` it. One class for each model: see `follower_for`.
    """

    @abc.abstractmethod
    def control(
        self,
        dynamics: Dynamics,
        state: StateVector,
        target: Float[Array, " D"],
        velocity: Float[Array, " D"],
    ) -> ControlVector:
        """Return the control (nu,) of the law, which may be out of bounds.

        Args:
            dynamics: the model.
            state: (nx,).
            target: (2,) where to be now, (3,) for a model with `z` [m].
            velocity: of the target, of the same shape [m/s].

        Raises:
            ValueError: a model of another class, a target without z where the model has it.
        """

    def __call__(
        self,
        dynamics: Dynamics,
        state: StateVector,
        reference: Float[Array, "T D"],
        dt: ArrayLike,
    ) -> Float[Array, "T nu"]:
        """Return the controls (T, nu), within the bounds, that follow a reference.

        Where the law gives no finite control, or the state is not finite, it is the default
        control; where the model gives no finite state, the rollout goes on from the last one.

        Args:
            dynamics: the model.
            state: (nx,) where the robot is.
            reference: (T, 2) or (T, 3) where to be after 1 ... T steps [m]. A model with `z` holds
                its own where there is no third column; others do not read it.
            dt: model step [s].

        Raises:
            ValueError: a model of another class, a reference of another shape, a step that is not
                positive.
        """
        step = _checks.scalar("dt", dt, above=0.0)
        points = _points(dynamics, state, reference)
        following = points[1:] - points[:-1]
        # A velocity that made up for the robot's distance from the first row would be a kick, and
        # where the plan is made anew at each step, nothing but kicks would be applied.
        first = following[:1] if points.shape[0] > 1 else jnp.zeros_like(points)
        moves = jnp.concatenate([first, following])
        times = step * jnp.arange(points.shape[0], dtype=jnp.float32)

        def advance(state: Array, inputs: tuple[Array, Array, Array]) -> tuple[Array, Array]:
            target, velocity, t = inputs
            wanted = self.control(dynamics, state, target, velocity)
            # A law need not read all of a state that is not finite.
            control = jnp.where(
                jnp.all(jnp.isfinite(wanted)) & jnp.all(jnp.isfinite(state)),
                jnp.clip(wanted, dynamics.control_min, dynamics.control_max),
                dynamics.default_control,
            )
            after = dynamics.step_at(state, control, t, step)
            return jnp.where(jnp.all(jnp.isfinite(after)), after, state), control

        controls: Array
        _, controls = jax.lax.scan(advance, state, (points - moves, moves / step, times))
        return controls


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
        model = _expected(dynamics, Quadrotor)
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
        nearing = _nearing(self.position_gain / self.velocity_gain, length(*away), braking)
        ax, ay, az = (
            self.velocity_gain * (velocity[i] + nearing * away[i] - state[3 + i]) for i in range(3)
        )
        fz = jnp.maximum(model.gravity - az, LEAST_LIFT * model.gravity)
        aside, most = length(ax, ay), steepest * fz
        is_steep = aside > most
        share = jnp.where(is_steep, most / jnp.where(is_steep, aside, 1.0), 1.0)
        return -share * ax, -share * ay, fz


class UnicycleFollower(Follower):
    """Tracking law for `Unicycle`, in the robot's frame:

        (u_x, u_y) = R(-yaw) (velocity + k (target - p))
        v = max(u_x, 0),   omega = k_yaw atan2(u_y, u_x) |u|^2 / (|u|^2 + 0.1^2)

    The speed is that of Kanayama et al.; their turn rate needs a target that moves, this one turns
    to where the robot should go, so that it also reaches a point. It fades with |u|: at rest on the
    target no direction is preferred. A target behind is turned to on the spot.

    Source: Kanayama, Kimura, Miyazaki, Noguchi, "A stable tracking control method for an autonomous
    mobile robot", ICRA 1990, whose v is u_x.

    Args:
        position_gain: k [1/s].
        heading_gain: k_yaw [1/s]; below `1 / dt`.

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
        """Return speed and turn rate (2,)."""
        _expected(dynamics, Unicycle)
        x, y, yaw = state
        wanted = [
            velocity[i] + self.position_gain * (target[i] - place) for i, place in enumerate((x, y))
        ]
        speed, turn, confidence = _steering(yaw, *wanted)
        return jnp.stack([speed, self.heading_gain * confidence * turn])


class DifferentialDriveFollower(Follower):
    """Tracking law for `DifferentialDrive`: that of `UnicycleFollower`, and a loop for each speed:

        a = k_v (v_wanted - v) + drag v,   alpha = k_omega (omega_wanted - omega) + drag omega

    with v_wanted and omega_wanted as there, but for k and k_yaw that fall with the distance and the
    angle to go, so that braking takes about half of the greatest acceleration.

    Source: Kanayama, Kimura, Miyazaki, Noguchi, "A stable tracking control method for an autonomous
    mobile robot", ICRA 1990.

    Args:
        position_gain: k [1/s]; half of `speed_gain` or less, a quarter for no overshoot.
        heading_gain: k_yaw [1/s]; half of `turn_rate_gain` or less.
        speed_gain: k_v [1/s]; below `1 / dt`.
        turn_rate_gain: k_omega [1/s]; below `1 / dt`.

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
        """Return both accelerations (2,)."""
        model = _expected(dynamics, DifferentialDrive)
        x, y, yaw, v, omega = state
        braking, turn_braking = 0.5 * model.control_max
        away = (target[0] - x, target[1] - y)
        nearing = _nearing(self.position_gain, length(*away), braking)
        speed, turn, confidence = _steering(
            yaw, velocity[0] + nearing * away[0], velocity[1] + nearing * away[1]
        )
        turn_rate = confidence * _nearing(self.heading_gain, jnp.abs(turn), turn_braking) * turn
        return jnp.stack(
            [
                self.speed_gain * (speed - v) + model.drag * v,
                self.turn_rate_gain * (turn_rate - omega) + model.drag * omega,
            ]
        )


def follower_for(dynamics: Dynamics) -> Follower:
    """Return the follower of a model, with its default gains.

    Raises:
        ValueError: a model that has none.
    """
    followers: dict[type[Dynamics], type[Follower]] = {
        Quadrotor: QuadrotorFollower,
        DifferentialDrive: DifferentialDriveFollower,
        Unicycle: UnicycleFollower,
    }
    for model, follower in followers.items():
        if isinstance(dynamics, model):
            return follower()
    raise ValueError(
        f"dynamics is a {type(dynamics).__name__}; accepted: "
        + ", ".join(model.__name__ for model in followers)
    )


def _expected[Model: Dynamics](dynamics: Dynamics, accepted: type[Model]) -> Model:
    """Return the model, which is of the class that a law was made for."""
    if not isinstance(dynamics, accepted):
        raise ValueError(
            f"dynamics is a {type(dynamics).__name__}; accepted: a {accepted.__name__}"
        )
    return dynamics


def _points(
    dynamics: Dynamics, state: StateVector, reference: Float[Array, "T D"]
) -> Float[Array, "T columns"]:
    """Return the reference with as many columns as the model's positions."""
    if reference.ndim != 2 or reference.shape[0] < 1 or reference.shape[1] not in (2, 3):
        raise ValueError(
            f"reference has shape {reference.shape}; accepted: (T, 2) or (T, 3) with T >= 1"
        )
    if "z" not in dynamics.state_names:
        return reference[:, :2]
    if reference.shape[1] == 3:
        return reference
    height = jnp.broadcast_to(dynamics.component(state, "z"), (reference.shape[0], 1))
    return jnp.concatenate([reference, height], axis=1)


def _nearing(gain: Scalar, distance: Scalar, braking: Scalar) -> Scalar:
    """Return the speed per distance at which to near something [1/s].

    It is the gain up to the distance where stopping takes `braking`, and from there on what stops
    with `braking`: `v = sqrt(2 braking (d - braking / (2 gain^2)))`, the same value and slope.
    """
    near = braking / (gain * gain)
    is_far = distance > near
    divisor = jnp.where(is_far, distance, 1.0)
    root = jnp.sqrt(jnp.where(is_far, braking * (2.0 * distance - near), 1.0))
    return jnp.where(is_far, root / divisor, gain)


def _steering(yaw: Scalar, x: Scalar, y: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """Return how a robot that drives forwards takes up a velocity (x, y) of the world.

    Its speed [m/s], the angle to turn by [rad], and how much the angle counts, between 0 and 1.
    """
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)
    ahead, aside = cos * x + sin * y, cos * y - sin * x
    squared = x * x + y * y
    confidence = squared / (squared + SLOW * SLOW)
    return jnp.maximum(ahead, 0.0), angle(ahead, aside), confidence
