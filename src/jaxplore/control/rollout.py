"""Rollouts: what many control sequences lead to and cost."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Scalar, StateVector
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics, State
from jaxplore.information.belief import Belief


def rollout_costs(
    dynamics: Dynamics,
    cost: Cost,
    initial: StateVector,
    controls: Float[Array, "T nu K"],
    dt: Scalar,
    belief: Belief,
) -> Float[Array, " K"]:
    """Return the cost of each control sequence.

    The samples are on the last axis and costs are added up inside the scan over time: nothing of
    size T x K is stored. The states travel as one vector of K per component, the layout in which
    XLA makes one loop of a whole step.

    Args:
        dynamics: the model.
        cost: what is paid.
        initial: (nx,) state from which all start.
        controls: (T, nu, K).
        dt: model step [s].
        belief: what the robot knows.
    """
    num_samples = controls.shape[2]

    def sample_step(components: tuple[Array, ...], control: Array, t: Array) -> tuple[Array, Array]:
        reached = dynamics.step(jnp.stack(components), control, dt)
        return reached, cost.stage(State(reached, dynamics), control, t, belief)

    step_all = jax.vmap(sample_step, in_axes=(0, -1, None), out_axes=(-1, 0))

    def advance(
        carry: tuple[tuple[Array, ...], Array], inputs: tuple[Array, Array]
    ) -> tuple[tuple[tuple[Array, ...], Array], None]:
        components, total = carry
        control, t = inputs
        reached, paid = step_all(components, control, t)
        return (tuple(reached), total + paid), None

    start = tuple(jnp.broadcast_to(value, (num_samples,)) for value in initial)
    times = dt * jnp.arange(1, controls.shape[0] + 1, dtype=jnp.float32)
    (last, total), _ = jax.lax.scan(advance, (start, jnp.zeros(num_samples)), (controls, times))
    final = jax.vmap(
        lambda components: cost.terminal(State(jnp.stack(components), dynamics), belief)
    )(last)
    return total + final


class Trajectory(NamedTuple):
    """One rollout: `states` (T + 1, nx) with the initial one, `terms` the cost of each named term
    added up over time."""

    states: Float[Array, "T+1 nx"]
    terms: dict[str, Scalar]


def rollout(
    dynamics: Dynamics,
    cost: Cost,
    initial: StateVector,
    controls: Float[Array, "T nu"],
    dt: Scalar,
    belief: Belief,
) -> Trajectory:
    """Return the states that one control sequence leads to, and what each term of a cost takes.

    Args:
        dynamics: the model.
        cost: what is paid; terms of the same name are added.
        initial: (nx,).
        controls: (T, nu).
        dt: model step [s].
        belief: what the robot knows.
    """

    def advance(state: Array, control: Array) -> tuple[Array, Array]:
        reached = dynamics.step(state, control, dt)
        return reached, reached

    _, reached = jax.lax.scan(advance, initial, controls)
    times = dt * jnp.arange(1, controls.shape[0] + 1, dtype=jnp.float32)
    terms: dict[str, Scalar] = {}
    for name, term in cost.terms():
        paid = jax.vmap(
            lambda state, control, t, term=term: term.stage(
                State(state, dynamics), control, t, belief
            )
        )(reached, controls, times)
        total = jnp.sum(paid) + term.terminal(State(reached[-1], dynamics), belief)
        terms[name] = terms.get(name, jnp.zeros(())) + total
    return Trajectory(jnp.concatenate([initial[None], reached]), terms)
