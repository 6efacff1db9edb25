"""Roll out one control sequence, with all states and each term of the cost, for inspection."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore._types import ControlVector, Scalar, StateVector
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics, State


class Trajectory(NamedTuple):
    """Trajectory of one rollout.

    Args:
        states: (T + 1, nx) states, the initial one first.
        controls: (T, nu) controls.
        terms: cost of each term by name, summed over time.
    """

    states: Float[Array, "T+1 nx"]
    controls: Float[Array, "T nu"]
    terms: dict[str, Scalar]


def rollout(
    dynamics: Dynamics,
    cost: Cost,
    initial: StateVector,
    controls: Float[Array, "T nu"],
    dt: Scalar,
    belief: Any = None,
    *,
    applied: ControlVector | None = None,
) -> Trajectory:
    """Simulate one control sequence and return its trajectory with the cost of each term.

    Args:
        dynamics: model of the robot.
        cost: cost to evaluate; terms of the same name are added.
        initial: (nx,) initial state.
        controls: (T, nu) control sequence.
        dt: model step [s].
        belief: what the robot knows of the world.
        applied: (nu,) control before the first one; the default control when absent.
    """
    before = dynamics.default_control if applied is None else applied
    # The states are computed once and read by every term.
    reached = rollout_states(dynamics, initial, controls, dt)
    terms: dict[str, Scalar] = {}
    for name, term in cost.terms():
        paid = step_costs(dynamics, term, reached, controls, dt, belief, applied=before)
        terms[name] = terms.get(name, jnp.zeros(())) + jnp.sum(paid)
    return Trajectory(jnp.concatenate([initial[None], reached]), controls, terms)


def rollout_states(
    dynamics: Dynamics, initial: StateVector, controls: Float[Array, "T nu"], dt: Scalar
) -> Float[Array, "T nx"]:
    """Simulate one control sequence and return the states (T, nx), without the initial one."""

    def advance(state: Array, inputs: tuple[Array, Array]) -> tuple[Array, Array]:
        control, t = inputs
        reached = dynamics.step_at(state, control, t - dt, dt)
        return reached, reached

    times = dt * jnp.arange(1, controls.shape[0] + 1, dtype=dt.dtype)
    return jax.lax.scan(advance, initial, (controls, times))[1]


def step_costs(
    dynamics: Dynamics,
    cost: Cost,
    states: Float[Array, "T nx"],
    controls: Float[Array, "T nu"],
    dt: Scalar,
    belief: Any,
    *,
    applied: ControlVector,
) -> Float[Array, " T"]:
    """Return the cost of each step of a rollout.

    The last one includes the terminal cost and that of the sequence. `states` are those that the
    controls lead to, and `applied` is the control before.
    """
    times = dt * jnp.arange(1, controls.shape[0] + 1, dtype=dt.dtype)

    def evaluate(state: Array, control: Array, t: Array) -> Array:
        return cost.stage(State(state, dynamics, control), control, t, belief)

    ending = cost.terminal(State(states[-1], dynamics, controls[-1]), belief)
    ending = ending + cost.sequence(controls, applied, dt, dynamics)
    return jax.vmap(evaluate)(states, controls, times).at[-1].add(ending)
