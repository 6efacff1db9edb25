"""The common objective: one cost that makes the plans of all members comparable."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import ControlVector, Scalar, StateVector
from jaxplore.control.rollout import rollout_objectives
from jaxplore.control.trajectory import Trajectory, rollout
from jaxplore.costs.base import Cost, SumCost, WeightedCost
from jaxplore.dynamics.base import Dynamics


class CommonObjective(eqx.Module):
    """Evaluates plans from the current state under `sum_o f_o J_o + J_hard`.

    `hard` is the cost J_hard, which no member trades for an objective. `objectives` are the J_o by
    name, and `factors` (O,) the f_o. `dt` is the model step of the plans [s], and `applied` (nu,)
    the control of the last step.
    """

    dynamics: Dynamics
    hard: Cost
    objectives: Mapping[str, Cost]
    factors: Float[Array, " O"]
    dt: Scalar
    observation: StateVector
    belief: Any
    applied: ControlVector

    def __call__(
        self, controls: Float[Array, "N T nu"]
    ) -> tuple[Float[Array, " N"], Float[Array, " N"]]:
        """Evaluate N plans and return their costs (N,) and the hard part of these costs (N,)."""
        # One rollout for all plans, hard cost first; samples are on the last axis there.
        paid = rollout_objectives(
            self.dynamics,
            (self.hard, *self.objectives.values()),
            self.observation,
            jnp.moveaxis(controls, 0, -1),
            self.dt,
            self.belief,
            applied=self.applied,
        )
        # An objective without weight may be infinite or NaN, and 0 times that is NaN.
        counted = jnp.where(self.factors[:, None] > 0.0, paid[1:], 0.0)
        return paid[0] + self.factors @ counted, paid[0]

    def trajectory(self, controls: Float[Array, "T nu"], dt: Scalar) -> Trajectory:
        """Simulate a plan with steps of `dt` [s] and return its trajectory and the cost by term."""
        terms = tuple(
            WeightedCost(factor, cost.with_name(name))
            for factor, (name, cost) in zip(self.factors, self.objectives.items(), strict=True)
        )
        return rollout(
            self.dynamics,
            SumCost((*terms, self.hard)),
            self.observation,
            controls,
            dt,
            self.belief,
            applied=self.applied,
        )
