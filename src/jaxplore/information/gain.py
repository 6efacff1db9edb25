"""Compute the information gained by one measurement of one cell."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore.sensing.inverse_sensor_model import InverseSensorModel


class IdealSensor(eqx.Module):
    """Ideal sensor: one measurement makes a cell certainly occupied or certainly free.

    It is the limit of the inverse sensor model for odds of infinity and zero. The gains are
    `-ln o` and `-ln (1 - o)`, whose expectation is the entropy of the cell. For a noise-free beam
    FSMI becomes the exact Shannon mutual information between map and measurement.
    """


CellSensor = InverseSensorModel | IdealSensor


def settle(probability: Float[Array, "*N"], sensor: CellSensor) -> Float[Array, "*N"]:
    """Return the probabilities with which beams are expected to end in cells.

    See `InverseSensorModel.settle`; an ideal sensor leaves them unchanged.
    """
    return probability if isinstance(sensor, IdealSensor) else sensor.settle(probability)


class CellGains(NamedTuple):
    """Information gained in a cell [nat]: `occupied` if it is measured so, `free` if passed."""

    occupied: Float[Array, "*N"]
    free: Float[Array, "*N"]


def update_gain(
    probability: Float[Array, "*N"], log_odds_change: Float[Array, "..."], model: InverseSensorModel
) -> Float[Array, "*N"]:
    """Return the information gained by one update of a cell, `KL(posterior || prior)` [nat].

    Without the clamp this is `f(d, r) = ln((r + 1) / (r + 1/d)) - ln(d) / (r d + 1)` of Zhang,
    Henderson, Sze and Karaman, "FSMI", IJRR 2020, eq. 10, with `d = exp(log_odds_change)` and
    `r = p / (1 - p)`, written there as the odds of being free. With the clamp it is the gain of the
    map itself: 0 for a saturated cell, and 0 for an occupied cell that the model keeps occupied.

    Settled cells of a decisive model gain nothing, because they count as certain. Otherwise a noisy
    reading in front of a known wall would count as information.

    Args:
        probability: probability of occupancy (*N).
        log_odds_change: log-odds that the measurement adds.
        model: inverse sensor model.
    """
    before = model.log_odds(probability)
    after = jnp.clip(before + log_odds_change, model.minimum, model.maximum)
    # KL divergence of two Bernoulli variables, computed from their log-odds without the logarithm
    # of a difference. It is symmetric under complements, so flip to a prior with log-odds below 0,
    # for which no large terms cancel.
    is_likely = before > 0.0
    after = jnp.where(is_likely, -after, after)
    before = jnp.where(is_likely, -before, before)
    posterior = jax.nn.sigmoid(after)
    gain = posterior * (after - before) + jax.nn.softplus(before) - jax.nn.softplus(after)
    is_kept = model.stays(probability, log_odds_change) | model.is_settled(probability)
    return jnp.where(is_kept, 0.0, jnp.maximum(gain, 0.0))


def cell_gains(probability: Float[Array, "*N"], sensor: CellSensor) -> CellGains:
    """Return the information that each cell gains from either measurement [nat].

    For an impossible measurement, such as free in a cell of probability 1, the gain of an ideal
    sensor is set to 0 instead of infinity.
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
    """Return the expected information that a noise-free beam gains in a cell it reaches [nat].

    `b = p f(occupied) + (1 - p) f(free)`: with probability p the beam ends in the cell, otherwise
    it passes. For an ideal sensor b is the entropy of the cell.
    """
    gains = cell_gains(probability, sensor)
    return probability * gains.occupied + (1.0 - probability) * gains.free
