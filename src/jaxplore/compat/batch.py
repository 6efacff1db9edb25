"""Rollouts with all states and costs, for inspection."""

from typing import Any, NamedTuple

import jax
from jaxtyping import Array, Float

from jaxplore._types import ControlVector, Scalar, StateVector
from jaxplore.control.trajectory import rollout_states, step_costs
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import Dynamics


class RolloutBatch(NamedTuple):
    """M rollouts, with time as the first axis and samples as the last.

    Args:
        states: states (T, nx, M) after each control.
        controls: controls (T, nu, M).
        costs: costs (T, M) of each step. The last row includes the terminal cost and the cost of
            the control sequence, so that the sum over time is the cost of the rollout.
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
) -> RolloutBatch:
    """Roll out control sequences and return all states and costs.

    This takes T times the memory of `rollout_costs`, which controllers use.

    Args:
        dynamics: model of the robot.
        cost: cost that is evaluated.
        initial: initial state (nx,) of all rollouts.
        controls: control sequences (T, nu, M).
        dt: time step of the model [s].
        belief: belief of the robot, which is passed to the cost.
        applied: control (nu,) that was applied before the first one; the default control if None.
    """
    before = dynamics.default_control if applied is None else applied

    def one(sequence: Array) -> tuple[Array, Array]:
        states = rollout_states(dynamics, initial, sequence, dt)
        return states, step_costs(dynamics, cost, states, sequence, dt, belief, applied=before)

    states, costs = jax.vmap(one, in_axes=-1, out_axes=-1)(controls)
    return RolloutBatch(states, controls, costs)
