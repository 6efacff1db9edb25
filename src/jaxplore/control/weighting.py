"""How much each rollout counts."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import Scalar


class Weighting(eqx.Module):
    """Maps costs to weights."""

    @abc.abstractmethod
    def weights(
        self, costs: Float[Array, " K"], importance: Float[Array, " K"]
    ) -> Float[Array, " K"]:
        """Return weights (K,) that add up to 1, or are all 0 if no cost is finite."""


class Softmax(Weighting):
    """`w_k = softmax(-(J_k / temperature + importance_k))` (Williams et al. 2017, eq. 22).

    Args:
        temperature: lambda, in units of cost: differences of this size matter.

    Raises:
        ValueError: a temperature that is not positive.
    """

    temperature: Scalar

    def __init__(self, temperature: ArrayLike) -> None:
        self.temperature = _checks.scalar("temperature", temperature, above=0.0)

    def weights(
        self, costs: Float[Array, " K"], importance: Float[Array, " K"]
    ) -> Float[Array, " K"]:
        """Return the weights; a rollout whose cost is not finite has none."""
        # lambda multiplies the importance term of the cost and divides the cost: the same thing.
        exponent = costs / self.temperature + importance
        exponent = jnp.where(jnp.isfinite(exponent), exponent, jnp.inf)
        least = jnp.min(exponent)
        relative = jnp.exp(jnp.where(jnp.isfinite(least), least, 0.0) - exponent)
        total = jnp.sum(relative)
        return relative / jnp.where(total > 0.0, total, 1.0)
