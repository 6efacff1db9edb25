"""Fusion: one control sequence from those of several controllers."""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore._types import Count
from jaxplore.dynamics.base import State

Sequences = Float[Array, "N T nu"]
Plan = Float[Array, "T nu"]
Evaluate = Callable[[Sequences], tuple[Float[Array, " N"], Float[Array, " N"]]]
"""Gives the cost of control sequences under the common objective, and how far they collide."""


class Candidates(NamedTuple):
    """What the members of a portfolio propose.

    Args:
        controls: (N, T, nu) on one time grid.
        costs: (N,) under the common objective, what collides included; not finite if a plan is not.
        hazards: (N,) the share of it that is paid for collisions and the risk of one; 0 for a plan
            without.
        uncertainties: (N,) spread of the weighted samples, in half ranges of the controls.
    """

    controls: Sequences
    costs: Float[Array, " N"]
    hazards: Float[Array, " N"]
    uncertainties: Float[Array, " N"]


class Situation(NamedTuple):
    """Where the robot is while it chooses.

    Args:
        state: of the robot.
        belief: what it knows.
        evaluate: rolls out other control sequences under the same objective.
    """

    state: State
    belief: Any
    evaluate: Evaluate


class Fused(NamedTuple):
    """What a fusion makes of the candidates.

    Args:
        controls: (T, nu).
        shares: (N,) how much each member has in it; adds up to 1.
        is_replaced: whether a safer plan took the place of the mixture.
    """

    controls: Plan
    shares: Float[Array, " N"]
    is_replaced: Bool[Array, ""]


class Fusion(eqx.Module):
    """Makes one plan of several. To permute the members permutes the shares and nothing else."""

    def init(self) -> Any:
        """Return what the fusion remembers between steps: nothing by default."""
        return ()

    @abc.abstractmethod
    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Return the plan and the new memory."""

    def check(self, names: tuple[str, ...]) -> None:
        """Raise a `ValueError` if the fusion does not fit members of these names."""
        return


def cheapest(costs: Float[Array, " N"]) -> Count:
    """Return the index of the least finite cost; 0 if there is none."""
    return jnp.argmin(jnp.where(jnp.isfinite(costs), costs, jnp.inf)).astype(jnp.int32)


def mixture(candidates: Candidates, votes: Float[Array, " N"]) -> Fused:
    """Return the mean with these weights; without any weight, that of all alike."""
    total = jnp.sum(votes)
    alike = jnp.full_like(votes, 1.0 / votes.shape[0])
    shares = jnp.where(total > 0.0, votes / jnp.where(total > 0.0, total, 1.0), alike)
    controls = jnp.einsum("n,ntu->tu", shares, candidates.controls)
    return Fused(controls, shares, jnp.array(False))


def one_of(candidates: Candidates, index: Count) -> Fused:
    """Return the plan of one member."""
    shares = jax.nn.one_hot(index, candidates.costs.shape[0])
    return Fused(candidates.controls[index], shares, jnp.array(False))
