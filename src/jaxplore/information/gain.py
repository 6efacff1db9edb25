"""What one measurement of one cell is worth."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore.sensing.inverse_sensor_model import InverseSensorModel


class IdealSensor(eqx.Module):
    """A sensor that leaves no doubt: one look makes a cell certainly occupied or certainly free.

    The limit of the inverse sensor model for odds of infinity and zero. The gains are
    `-ln o` and `-ln (1 - o)`, on average the cell's entropy, and for a noise-free beam FSMI becomes
    the exact Shannon mutual information between map and measurement.
    """


CellSensor = InverseSensorModel | IdealSensor


def settled(probability: Float[Array, "*N"], sensor: CellSensor) -> Float[Array, "*N"]:
    """Return the probabilities with which beams are expected to meet something: see
    `InverseSensorModel.settled`."""
    return probability if isinstance(sensor, IdealSensor) else sensor.settled(probability)


class CellGains(NamedTuple):
    """What a cell gains [nat] if it is measured `occupied` and if a beam passes it, `free`."""

    occupied: Float[Array, "*N"]
    free: Float[Array, "*N"]


def update_gain(
    probability: Float[Array, "*N"], log_odds_change: Float[Array, "..."], model: InverseSensorModel
) -> Float[Array, "*N"]:
    """Return the information in one update of a cell, `KL(posterior || prior)` [nat].

    Without the clamp this is `f(d, r) = ln((r + 1) / (r + 1/d)) - ln(d) / (r d + 1)` of Zhang,
    Henderson, Sze and Karaman, "FSMI", IJRR 2020, eq. 10, with `d = exp(log_odds_change)` and
    `r = p / (1 - p)` written there as the odds of being free. Through the clamp it is what the map
    really gains: nothing once a cell is saturated, nor where walls stay.

    Settled cells of a decisive model gain nothing: what is certain is not learned. A range whose
    noise puts the end of a beam in front of a known wall would otherwise be news.
    """
    before = model.log_odds(probability)
    after = jnp.clip(before + log_odds_change, model.minimum, model.maximum)
    # KL of two Bernoulli variables from their log-odds: no logarithm of a difference. It is the
    # same for the complements; with the prior's log-odds below 0 nothing large cancels.
    is_likely = before > 0.0
    after = jnp.where(is_likely, -after, after)
    before = jnp.where(is_likely, -before, before)
    posterior = jax.nn.sigmoid(after)
    gain = posterior * (after - before) + jax.nn.softplus(before) - jax.nn.softplus(after)
    is_kept = model.stays(probability, log_odds_change) | model.is_settled(probability)
    return jnp.where(is_kept, 0.0, jnp.maximum(gain, 0.0))


def cell_gains(probability: Float[Array, "*N"], sensor: CellSensor) -> CellGains:
    """Return what each cell gains from either measurement [nat].

    Where a measurement is impossible (free in a cell of probability 1) an ideal sensor's gain is
    given as 0, not infinite.
    """
    if isinstance(sensor, IdealSensor):
        return CellGains(
            -jnp.log(jnp.where(probability > 0.0, probability, 1.0)),
            -jnp.log1p(-jnp.where(probability < 1.0, probability, 0.0)),
        )
    return CellGains(
        update_gain(probability, sensor.occupied, sensor),
        update_gain(probability, sensor.free, sensor),
    )


def expected_gain(probability: Float[Array, "*N"], sensor: CellSensor) -> Float[Array, "*N"]:
    """Return what a beam that reaches a cell gains there on average, noise-free [nat].

    `b = p f(occupied) + (1 - p) f(free)`: with probability p the beam ends in the cell, otherwise
    it passes through. For an ideal sensor it is the cell's entropy.
    """
    gains = cell_gains(probability, sensor)
    return probability * gains.occupied + (1.0 - probability) * gains.free
