"""From where a robot should be to the controls that take it there.

A planner says positions, a proposal wants controls: a feedback law, simulated along the positions
with the model itself, gives the controls that the model can execute.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ControlVector, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics

SLOW = 0.1
"""Speed below which the direction of a motion says little [m/s]."""


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


def expected[Model: Dynamics](dynamics: Dynamics, accepted: type[Model]) -> Model:
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


def nearing(gain: Scalar, distance: Scalar, braking: Scalar) -> Scalar:
    """Return the speed per distance at which to near something [1/s].

    It is the gain up to the distance where stopping takes `braking`, and from there on what stops
    with `braking`: `v = sqrt(2 braking (d - braking / (2 gain^2)))`, the same value and slope.
    """
    near = braking / (gain * gain)
    is_far = distance > near
    divisor = jnp.where(is_far, distance, 1.0)
    root = jnp.sqrt(jnp.where(is_far, braking * (2.0 * distance - near), 1.0))
    return jnp.where(is_far, root / divisor, gain)
