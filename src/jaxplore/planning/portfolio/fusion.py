"""Fusion: make one control sequence of those of several members."""

import abc
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore._types import Count, Scalar
from jaxplore.dynamics.base import State

Sequences = Float[Array, "N T nu"]
Plan = Float[Array, "T nu"]
Evaluate = Callable[[Sequences], tuple[Float[Array, " N"], Float[Array, " N"]]]
"""Evaluates control sequences: cost under the common objective, and the part for collisions."""


class Candidates(NamedTuple):
    """Plans of the N members of a portfolio, and their costs.

    Args:
        controls: (N, T, nu) control sequences on one time grid.
        costs: (N,) costs under the common objective, including collisions; not finite for a plan
            that is not finite.
        hazards: (N,) part of these costs that is due to collisions or their risk; 0 without any.
        uncertainties: (N,) spread of the weighted samples, in half ranges of the controls.
    """

    controls: Sequences
    costs: Float[Array, " N"]
    hazards: Float[Array, " N"]
    uncertainties: Float[Array, " N"]


class Situation(NamedTuple):
    """State and belief of the robot at the time of a fusion.

    Args:
        state: state of the robot.
        belief: what the robot knows of the world.
        evaluate: function that evaluates other control sequences under the same objective.
        dt: model step of the plans [s]; None where no fusion rolls them out.
    """

    state: State
    belief: Any
    evaluate: Evaluate
    dt: Scalar | None = None


class Fused(NamedTuple):
    """Fused plan.

    Args:
        controls: (T, nu) control sequence.
        shares: (N,) weight of each member in it; adds up to 1.
        is_replaced: whether a member's plan replaced the mixture because it is safer or cheaper.
    """

    controls: Plan
    shares: Float[Array, " N"]
    is_replaced: Bool[Array, ""]


class Fusion(eqx.Module):
    """A rule that makes one plan of N.

    A plan that is not finite has no share, whatever its member's cost is (`is_usable`). Without any
    finite plan the fused one is not finite either.

    Except where members have roles by name, a permutation of the members permutes the shares and
    changes nothing else.
    """

    def init(self) -> Any:
        """Return the initial memory; empty for a fusion without one."""
        return ()

    @abc.abstractmethod
    def __call__(
        self, memory: Any, candidates: Candidates, situation: Situation
    ) -> tuple[Fused, Any]:
        """Fuse the candidates; return the fused plan and the new memory."""

    def check(self, names: tuple[str, ...]) -> None:
        """Raise a `ValueError` if the fusion does not fit members of these names."""
        return


def is_usable(candidates: Candidates) -> Bool[Array, " N"]:
    """Return which plans are finite (N,)."""
    return jnp.all(jnp.isfinite(candidates.controls), axis=(1, 2))


def least_finite(costs: Float[Array, " N"]) -> Count:
    """Return the index of the least finite cost; 0 if no cost is finite."""
    return jnp.argmin(jnp.where(jnp.isfinite(costs), costs, jnp.inf)).astype(jnp.int32)


def weighted_mean(candidates: Candidates, votes: Float[Array, " N"]) -> Fused:
    """Average the finite plans with these votes (N,), or with equal weights if all votes are 0."""
    usable = is_usable(candidates)
    votes = jnp.where(usable, votes, 0.0)
    # All votes are 0 if no cost is finite. The mean of the plans that are finite even then is safe.
    total = jnp.sum(votes)
    alike = jnp.where(usable | ~usable.any(), 1.0, 0.0)
    alike = alike / jnp.sum(alike)
    shares = jnp.where(total > 0.0, votes / jnp.where(total > 0.0, total, 1.0), alike)
    # A plan without a share is left out of the sum: 0 times NaN would be NaN.
    counted = jnp.where((shares > 0.0)[:, None, None], candidates.controls, 0.0)
    return Fused(jnp.einsum("n,ntu->tu", shares, counted), shares, jnp.array(False))


def select_member(candidates: Candidates, index: Count) -> Fused:
    """Return the plan of one member as the fused plan.

    If it is not finite, it is the plan of least cost among those that are.
    """
    usable = is_usable(candidates)
    another = least_finite(jnp.where(usable, candidates.costs, jnp.inf))
    # Without a finite cost, any plan that is finite.
    another = jnp.where(usable[another], another, jnp.argmax(usable))
    index = jnp.where(usable[index], index, another).astype(jnp.int32)
    shares = jax.nn.one_hot(index, candidates.costs.shape[0])
    return Fused(candidates.controls[index], shares, jnp.array(False))
