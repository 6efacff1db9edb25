"""The follower of any robot on the ground: a wanted twist, and the control that leads to it."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Flag, Scalar, StateVector, Twist
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.vectors import angle, length
from jaxplore.planning.strategy.follower import SLOW, Follower, approach_gain

ITERATIONS = 3
"""Newton steps to a control: at rest, steering shows no effect before the first one adds speed."""
SWEEPS = 8
"""Sweeps over the controls in each Newton step."""
PROBE = 0.02
"""Change of a control by which the change of the twist is measured [half ranges]."""
DAMPING = 1e-4
"""Weight of the controls, in half ranges, against the error of the twist."""
LEAST_SHARE = 0.3
"""Share of the speed with which a car drives on although the target is beside it: it cannot turn
without driving."""


class TwistFollower(Follower):
    """Tracking law for any model with a position and a heading on the ground.

    The wanted twist is, in the robot's frame,

        u = R(-yaw) (velocity + k (target - p)),   s = -1 if u_x < 0 for a car, else 1
        v = u_x,   omega = k_yaw atan2(s u_y, s u_x) |u|^2 / (|u|^2 + 0.1^2)

    A car, which has a turning radius, thus drives backwards along a reference that moves backwards,
    if it `reverses` (s = -1). It has a speed of at least 0.3 |u| in the direction s, a turn rate of
    at most |v| over its turning radius, and does not control v_y, which is its slip. Any other
    robot drives forwards only, and turns. One that can move sideways has v_y = u_y.

    The control is the one whose twist after the response time comes nearest, by Newton's method on
    the model:

        min over control of |twist(step(x, control, response)) - wanted|^2

    k falls with the distance, so that braking takes about half of the greatest deceleration.

    Sources: Kanayama, Kimura, Miyazaki, Noguchi, "A stable tracking control method for an
    autonomous mobile robot", ICRA 1990, for the law; its inversion by the model is that of
    resolved-motion control, Whitney, "Resolved motion rate control of manipulators and human
    prostheses", 1969, with the damping of Nakamura and Hanafusa, 1986.

    Args:
        position_gain: gain on the position error, k [1/s].
        heading_gain: gain on the heading error, k_yaw [1/s].
        response: time in which the twist is reached [s]; longer than a step.
        reverses: whether a car drives backwards.

    Raises:
        ValueError: a value that is not positive.
    """

    position_gain: Scalar
    heading_gain: Scalar
    response: Scalar
    reverses: Flag

    def __init__(
        self,
        position_gain: ArrayLike = 1.2,
        heading_gain: ArrayLike = 4.0,
        response: ArrayLike = 0.2,
        *,
        reverses: bool = True,
    ) -> None:
        self.position_gain = _checks.scalar("position_gain", position_gain, above=0.0)
        self.heading_gain = _checks.scalar("heading_gain", heading_gain, above=0.0)
        self.response = _checks.scalar("response", response, above=0.0)
        self.reverses = jnp.asarray(_kinds.flag("reverses", reverses))

    def control(
        self,
        dynamics: Dynamics,
        state: StateVector,
        target: Float[Array, " D"],
        velocity: Float[Array, " D"],
    ) -> ControlVector:
        """Evaluate the law: the control that leads to the wanted twist (nu,)."""
        if not drives(dynamics):
            raise ValueError(
                f"dynamics is a {type(dynamics).__name__}; accepted: a model with x, y and yaw, "
                "without z"
            )

        half_range = dynamics.control_half_range
        size = dynamics.control_size
        # The control itself, and two more for each of its components: at a bound of the model one
        # of them shows no effect.
        probes = PROBE * jnp.concatenate([jnp.zeros((1, size)), jnp.eye(size), -jnp.eye(size)])

        def twists(control: ControlVector) -> tuple[Twist, Float[Array, "3 nu"]]:
            """Return the twist after the response time, and its change by half a range."""

            # Differences in place of derivatives: one mapped step compiles in a fraction of the
            # time.
            def twist(probe: Array) -> Twist:
                given = control + half_range * probe
                return dynamics.twist(dynamics.step(state, given, self.response), given)

            found = jax.vmap(twist)(probes)
            return found[0], (found[1 : 1 + size] - found[1 + size :]).T / (2.0 * PROBE)

        def improve(_: Array, control: ControlVector) -> ControlVector:
            found, slope = twists(control)
            # The change of speed that the controls can bring about within the response time.
            acceleration = jnp.abs(slope[0]).sum() / self.response
            wanted, weight = self._compute_twist(dynamics, state, target, velocity, acceleration)
            normal = slope.T @ (weight[:, None] * slope) + DAMPING * jnp.eye(size)
            low = (dynamics.control_min - control) / half_range
            high = (dynamics.control_max - control) / half_range
            move = _solve_bounded(normal, slope.T @ (weight * (wanted - found)), low, high)
            return control + half_range * move

        result: ControlVector = jax.lax.fori_loop(0, ITERATIONS, improve, dynamics.default_control)
        return result

    def _compute_twist(
        self,
        dynamics: Dynamics,
        state: StateVector,
        target: Float[Array, " D"],
        velocity: Float[Array, " D"],
        acceleration: Scalar,
    ) -> tuple[Twist, Twist]:
        """Return the wanted twist, and the weight of each of its components."""
        x, y, yaw = dynamics.pose(state)
        away = (target[0] - x, target[1] - y)
        # A robot that cannot speed up where it is would have no gain at all.
        braking = jnp.maximum(0.5 * acceleration, SLOW)
        gain = approach_gain(self.position_gain, length(*away), braking)
        east, north = velocity[0] + gain * away[0], velocity[1] + gain * away[1]
        sin, cos = sin_cos(yaw)
        ahead, aside = cos * east + sin * north, cos * north - sin * east
        fast = length(ahead, aside)
        is_car = dynamics.turning_radius > 0.0
        sign = jnp.where(is_car & self.reverses & (ahead < 0.0), -1.0, 1.0)
        turn = angle(sign * ahead, sign * aside)
        least = jnp.where(is_car, LEAST_SHARE * fast, 0.0)
        speed = sign * jnp.maximum(sign * ahead, least)
        squared = fast * fast
        turn_rate = self.heading_gain * turn * squared / (squared + SLOW * SLOW)
        # A car would speed up for a turn rate that its wanted speed does not allow.
        radius = jnp.where(is_car, dynamics.turning_radius, 1.0)
        most = jnp.where(is_car, jnp.abs(speed) / radius, jnp.inf)
        turn_rate = jnp.clip(turn_rate, -most, most)
        sideways = jnp.where(is_car, 0.0, 1.0)
        return jnp.stack([speed, aside, turn_rate]), jnp.stack([1.0, sideways, 1.0])


def _solve_bounded(
    normal: Float[Array, "n n"], right: Float[Array, " n"], low: Array, high: Array
) -> Float[Array, " n"]:
    """Return x of least x' normal x / 2 - right x within bounds, by coordinate descent.

    Solved without the bounds, the steering would suit a speed that is out of reach.
    """

    def sweep(_: Array, x: Array) -> Array:
        for index in range(normal.shape[0]):
            step = (right[index] - normal[index] @ x) / normal[index, index]
            x = x.at[index].set(jnp.clip(x[index] + step, low[index], high[index]))
        return x

    result: Array = jax.lax.fori_loop(0, SWEEPS, sweep, jnp.zeros(normal.shape[0]))
    return result


def drives(dynamics: Dynamics) -> bool:
    """Return whether a model is that of a robot on the ground with a heading."""
    names = dynamics.state_names
    return {"x", "y", "yaw"} <= set(names) and "z" not in names
