"""One objective by which the plans of several controllers compare."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import ControlVector, Scalar, StateVector
from jaxplore.control.rollout import Trajectory, rollout, rollout_objectives
from jaxplore.costs.base import Cost, SumCost, WeightedCost
from jaxplore.dynamics.base import Dynamics


class CommonObjective(eqx.Module):
    """Prices plans from where the robot is by one common objective, `sum_o f_o J_o + J_hard`.

    Args:
        dynamics: the model.
        hard: J_hard, what is never traded.
        objectives: J_o by name.
        factors: (O,) f_o.
        dt: model step of the plans [s].
        observation: (nx,) the robot's state.
        belief: what it knows.
        applied: (nu,) the control given out last.
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
        """Return what plans cost (N,), and how much of it is hard (N,)."""
        paid = rollout_objectives(
            self.dynamics,
            (self.hard, *self.objectives.values()),
            self.observation,
            jnp.moveaxis(controls, 0, -1),
            self.dt,
            self.belief,
            applied=self.applied,
        )
        # What has no weight may be anything, also no number.
        counted = jnp.where(self.factors[:, None] > 0.0, paid[1:], 0.0)
        return paid[0] + self.factors @ counted, paid[0]

    def follow(self, controls: Float[Array, "T nu"], dt: Scalar) -> Trajectory:
        """Return what a plan with steps of `dt` leads to, and its cost term by term."""
        terms = tuple(
            WeightedCost(factor, cost.named(name))
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
