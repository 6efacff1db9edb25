"""Followers: turn a reference of positions into controls by simulating a feedback law.

A strategic layer gives positions, a proposal needs controls. The law is simulated with the model
itself, so the model can execute the controls.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, ControlVector, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics

SLOW = 0.1
"""Speed below which the direction of a velocity is taken as unreliable [m/s]."""


class Follower(eqx.Module):
    """A feedback law, and its simulation along a reference of positions.

        u_i = clip(control(x_i, r_{i-1}, (r_i - r_{i-1}) / dt)),   x_{i+1} = step(x_i, u_i, dt)

    Row r_i is the target at (i + 1) dt, so r_{i-1} is the target at the time of x_i. Before its
    first row the reference has the velocity of the first interval; a single row stands still.

    The controls can be given to `BiasedProposal` as its reference, for the same horizon and step.
    The code is written for one robot and can be mapped by `vmap`. Each model has a follower class
    of its own, see `follower_for`.
    """

    @abc.abstractmethod
    def control(
        self,
        dynamics: Dynamics,
        state: StateVector,
        target: Float[Array, " D"],
        velocity: Float[Array, " D"],
    ) -> ControlVector:
        """Evaluate the feedback law (nu,); the result may exceed the bounds.

        Args:
            dynamics: model of the robot.
            state: (nx,) state of the robot.
            target: (2,) position to be at now, or (3,) for a model with `z` [m].
            velocity: velocity of the target, of the same shape [m/s].

        Raises:
            ValueError: a model of another class, a target without z for a model with z.
        """

    def __call__(
        self,
        dynamics: Dynamics,
        state: StateVector,
        reference: Float[Array, "T D"],
        dt: ArrayLike,
    ) -> Float[Array, "T nu"]:
        """Simulate the law along a reference and return its controls, within the bounds.

        Where the control of the law or the state is not finite, the default control is used. Where
        the model returns a state that is not finite, the simulation continues from the last one.
        The reference (T, 2) or (T, 3) are positions after 1 ... T steps [m]. Without a third
        column, a model with `z` keeps its height; a model without `z` ignores the column.
        """
        step = _checks.scalar("dt", dt, above=0.0)
        points = _points(dynamics, state, reference)
        intervals = points[1:] - points[:-1]
        # The first velocity is not that from the robot to the first row: it would be a kick, and a
        # controller that plans anew at each step would apply nothing but kicks.
        first = intervals[:1] if points.shape[0] > 1 else jnp.zeros_like(points)
        moves = jnp.concatenate([first, intervals])
        times = step * jnp.arange(points.shape[0], dtype=jnp.float32)

        def advance(state: Array, inputs: tuple[Array, Array, Array]) -> tuple[Array, Array]:
            target, velocity, t = inputs
            wanted = self.control(dynamics, state, target, velocity)
            # A law may ignore a component of the state that is not finite, so both are checked.
            control = jnp.where(
                jnp.all(jnp.isfinite(wanted)) & jnp.all(jnp.isfinite(state)),
                jnp.clip(wanted, dynamics.control_min, dynamics.control_max),
                dynamics.default_control,
            )
            after = dynamics.step_at(state, control, t, step)
            return jnp.where(jnp.all(jnp.isfinite(after)), after, state), control

        controls: Array
        # A row minus its interval is the row before, the target at the time of the state.
        _, controls = jax.lax.scan(advance, state, (points - moves, moves / step, times))
        return controls


def require_model[Model: Dynamics](dynamics: Dynamics, accepted: type[Model]) -> Model:
    """Return the model if it is of the class that a law is made for; otherwise raise."""
    if not isinstance(dynamics, accepted):
        raise ValueError(
            f"dynamics is a {type(dynamics).__name__}; accepted: a {accepted.__name__}"
        )
    return dynamics


def _points(
    dynamics: Dynamics, state: StateVector, reference: Float[Array, "T D"]
) -> Float[Array, "T columns"]:
    """Return the reference with as many columns as the model has position components."""
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


def approach_gain(gain: Scalar, distance: Scalar, braking: Scalar) -> Scalar:
    """Compute the ratio of speed to distance at which to approach a target [1/s].

        v / d = gain                                               for d <= braking / gain^2
        v = sqrt(2 braking (d - braking / (2 gain^2)))             beyond

    Near the target the approach is exponential. Farther away the gain falls, so that the robot can
    stop with the deceleration `braking`. Value and slope of v are continuous. The distance d is in
    m and the deceleration in m/s^2, or they are an angle in rad and in rad/s^2.
    """
    # The guards keep the gradient finite at distance 0.
    near = braking / (gain * gain)
    is_far = distance > near
    divisor = jnp.where(is_far, distance, 1.0)
    root = jnp.sqrt(jnp.where(is_far, braking * (2.0 * distance - near), 1.0))
    return jnp.where(is_far, root / divisor, gain)
