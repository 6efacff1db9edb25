"""What one measurement of one cell is worth."""

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore.sensing.inverse_sensor_model import InverseSensorModel


def update_gain(
    probability: Float[Array, "*N"], log_odds_change: Float[Array, "..."], model: InverseSensorModel
) -> Float[Array, "*N"]:
    """Return the information in one update of a cell, `KL(posterior || prior)` [nat].

    Without the clamp this is `f(d, r) = ln((r + 1) / (r + 1/d)) - ln(d) / (r d + 1)` of Zhang,
    Henderson, Sze and Karaman, "FSMI", IJRR 2020, eq. 10, with `d = exp(log_odds_change)` and
    `r = p / (1 - p)` written there as the odds of being free. Through the clamp it is what the map
    really gains: nothing once a cell is saturated.
    """
    before = model.log_odds(probability)
    after = jnp.clip(before + log_odds_change, model.minimum, model.maximum)
    # KL of two Bernoulli variables from their log-odds: no logarithm of a difference.
    posterior = jax.nn.sigmoid(after)
    gain = posterior * (after - before) + jax.nn.softplus(before) - jax.nn.softplus(after)
    return jnp.maximum(gain, 0.0)


def expected_gain(probability: Float[Array, "*N"], model: InverseSensorModel) -> Float[Array, "*N"]:
    """Return what a beam that reaches a cell gains there on average, noise-free [nat].

    `b = p f(occupied) + (1 - p) f(free)`: with probability p the beam ends in the cell, otherwise
    it passes through.
    """
    occupied = update_gain(probability, model.occupied, model)
    free = update_gain(probability, model.free, model)
    return probability * occupied + (1.0 - probability) * free
