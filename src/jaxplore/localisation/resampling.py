"""Draw particles by their weights."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxplore._types import Scalar

Weights = Float[Array, " K"]


def effective_sample_size(weights: Weights) -> Scalar:
    """Return `1 / sum w^2`: K with equal weights, 1 if one particle has all."""
    return 1.0 / (weights**2).sum()


def low_variance_indices(weights: Weights, offset: Scalar) -> Int[Array, " K"]:
    """Draw K particles by the low-variance sampler: particle i floor(K w_i) or ceil(K w_i) times.

    Draw j is the first particle whose cumulative weight exceeds `(j + offset) / K`. The weights add
    up to 1, and the offset is random, uniform in [0, 1).

    Source: Thrun, Burgard and Fox, "Probabilistic Robotics", 2005, table 4.4.
    """
    number = weights.shape[0]
    return indices_at(weights, (jnp.arange(number, dtype=jnp.float32) + offset) / number)


def indices_at(weights: Weights, levels: Float[Array, " M"]) -> Int[Array, " M"]:
    """Return the first particle (M,) whose cumulative weight exceeds each level in [0, 1).

    The weights add up to 1.
    """
    cumulative = jnp.cumsum(weights)
    # The sum is 1 only up to rounding; a level beyond it would be a particle without weight.
    levels = levels * cumulative[-1]
    index = jnp.searchsorted(cumulative, levels, side="right")
    return jnp.minimum(index, weights.shape[0] - 1)
