"""Rollouts with everything they passed through, for those who look at them."""

from typing import Any, NamedTuple

import jax
from jaxtyping import Array, Float

from jaxplore._types import ControlVector, Scalar, StateVector
from jaxplore.control.rollout import rollout_states, step_costs
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics


class Batch(NamedTuple):
    """M rollouts, time first and samples last.

    Args:
        states: (T, nx, M) reached after each control.
        controls: (T, nu, M).
        costs: (T, M) of each step; what is paid at the end and for the sequence is in the last row,
            so that the sum over time is the cost of the rollout.
    """

    states: Float[Array, "T nx M"]
    controls: Float[Array, "T nu M"]
    costs: Float[Array, "T M"]


def rollout_batch(
    dynamics: Dynamics,
    cost: Cost,
    initial: StateVector,
    controls: Float[Array, "T nu M"],
    dt: Scalar,
    belief: Any = None,
    *,
    applied: ControlVector | None = None,
) -> Batch:
    """Return all states and costs of control sequences.

    A controller does not need them and is faster without, see `rollout_costs`: they take T times
    the memory.

    Args:
        dynamics: the model.
        cost: what is paid.
        initial: (nx,) state from which all start.
        controls: (T, nu, M).
        dt: model step [s].
        belief: what the robot knows.
        applied: (nu,) control before the first one; the default control when absent.
    """
    before = dynamics.default_control if applied is None else applied

    def one(sequence: Array) -> tuple[Array, Array]:
        states = rollout_states(dynamics, initial, sequence, dt)
        return states, step_costs(dynamics, cost, states, sequence, dt, belief, applied=before)

    states, costs = jax.vmap(one, in_axes=-1, out_axes=-1)(controls)
    return Batch(states, controls, costs)
