"""What one beam is worth: the FSMI family over the cells that it crosses.

A beam crosses cells 0 ... n-1, nearest first; cell i is occupied with probability o_i. The beam's
first hit is in cell j with probability `P(e_j) = o_j prod_{l<j} (1 - o_l)`, and with probability
`P(e_none) = prod_l (1 - o_l)` there is none. A reading in cell k updates the map: the cells before
k as free, cell k as occupied, and is worth

    C_k = f_occ,k + sum_{i<k} f_emp,i

with f the divergence between a cell's posterior and prior (`jaxplore.information.gain`); no return
is worth `sum_i f_emp,i`. So the beam's information is (Zhang, Henderson, Sze and Karaman, "FSMI:
Fast computation of Shannon mutual information for information-theoretic mapping", IJRR 2020,
Theorem 1, with the no-return event that it leaves out)

    I = sum_j sum_k P(e_j) G_kj C_k + P(e_none) sum_i f_emp,i            [nat]

It is the expectation over maps and readings of `sum_i KL(posterior_i || prior_i)`. Ordered by cells
instead of readings,

    I = sum_k v_k,   v_k = f_occ,k P(reading in k) + f_emp,k P(reading behind k, or none)

a sum of non-negative terms in which nothing cancels, and which says what each cell contributes.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Bool, Float

from jaxplore import _checks
from jaxplore._types import Scalar
from jaxplore.information.gain import CellGains, CellSensor, cell_gains
from jaxplore.information.noise import RangeNoise
from jaxplore.sensing.inverse_sensor_model import InverseSensorModel


def beam_information(
    probability: Float[Array, " n"],
    sensor: CellSensor | None = None,
    *,
    noise: RangeNoise | None = None,
    no_return: bool = True,
    edges: Float[Array, " n+1"] | None = None,
) -> Scalar:
    """Return the expected information of one beam [nat]: the sum of `cell_information`."""
    return cell_information(
        probability, sensor, noise=noise, no_return=no_return, edges=edges
    ).sum()


def cell_information(
    probability: Float[Array, " n"],
    sensor: CellSensor | None = None,
    *,
    noise: RangeNoise | None = None,
    no_return: bool = True,
    edges: Float[Array, " n+1"] | None = None,
) -> Float[Array, " n"]:
    """Return what each cell along a beam contributes to its expected information [nat].

    Args:
        probability: (n,) of being occupied, nearest cell first.
        sensor: what a measurement does to a cell: the map's own `InverseSensorModel`, with its
            clamp, or `IdealSensor()` for Shannon's mutual information. When absent
            `InverseSensorModel.from_odds()`, unclamped log-odds of 0.85 and -0.4.
        noise: of the range; None for none. `GaussianNoise` (exact or banded), `UniformNoise`,
            `ToeplitzNoise`.
        no_return: whether a beam that meets nothing counts, as passing every cell. Leaving it out
            loses most of the value of open space.
        edges: (n + 1,) increasing distances at which the cells begin and end, in the unit of the
            noise; 0 ... n when absent.

    Raises:
        ValueError: no cells, a probability outside [0, 1], edges that do not fit or increase.
    """
    values = _checks.probabilities("probability", probability, 1)
    size, cell_size = values.shape[0], None
    if edges is None:
        edges, cell_size = jnp.arange(size + 1, dtype=jnp.float32), 1.0
    else:
        edges = _checked_edges(edges, size)
    sensor = InverseSensorModel.from_odds() if sensor is None else sensor
    return contributions(values, cell_gains(values, sensor), noise, no_return, edges, cell_size)


def contributions(
    probability: Float[Array, " n"],
    gains: CellGains,
    noise: RangeNoise | None,
    no_return: bool,
    edges: Float[Array, " n+1"],
    cell_size: float | None,
    in_range: Bool[Array, " n"] | None = None,
) -> Float[Array, " n"]:
    """Return what each cell contributes, from the gains of the cells: this module's formula.

    Cells out of range, all at the far end, only fill the array: a reading there is discarded.
    """
    passed = jnp.cumprod(1.0 - probability)
    hit = probability * jnp.concatenate([jnp.ones(1), passed[:-1]])
    if noise is None and no_return:
        behind = passed  # reading behind k, or none: the beam passed k
    else:
        if noise is not None:
            hit = noise.measured(hit, edges, cell_size)
            hit = hit if in_range is None else jnp.where(in_range, hit, 0.0)
        behind = jnp.append(jnp.cumsum(hit[::-1])[::-1][1:], 0.0)
        behind = behind + passed[-1] if no_return else behind
    return gains.occupied * hit + gains.free * behind


def cauchy_schwarz_information(
    probability: Float[Array, " n"],
    std: ArrayLike,
    *,
    edges: Float[Array, " n+1"] | None = None,
) -> Scalar:
    """Return the Cauchy-Schwarz quadratic mutual information of one beam, for comparison.

        I_CS = ln sum_l w_l N(0; 2 s^2) + ln [ prod_i q_i sum_ij p_i p_j N(mu_i - mu_j; 2 s^2) ]
               - 2 ln sum_ij p_i w_j N(mu_i - mu_j; 2 s^2)

    with p the probabilities of the first hit, the one of no return last and at the end of the last
    cell, `q = o^2 + (1 - o)^2` and `w_l = p_l^2 prod_{k>l} q_k`. Charrow, Liu, Kumar and Michael,
    "Information-theoretic mapping using Cauchy-Schwarz quadratic mutual information", ICRA 2015,
    eq. 8. It is a divergence of its own, not comparable in size with nats of Shannon's, and knows
    no inverse sensor model.

    Args:
        probability: (n,) of being occupied, nearest cell first.
        std: of the range noise, s, in the unit of `edges`.
        edges: (n + 1,) distances at which the cells begin and end; 0 ... n when absent.

    Raises:
        ValueError: no cells, a probability outside [0, 1], edges that do not fit or increase, a
            standard deviation that is not positive.
    """
    values = _checks.probabilities("probability", probability, 1)
    deviation = _checks.scalar("std", std, above=0.0)
    size = values.shape[0]
    edges = (
        jnp.arange(size + 1, dtype=jnp.float32) if edges is None else _checked_edges(edges, size)
    )
    free = 1.0 - values
    square = values * values + free * free
    passed = jnp.concatenate([jnp.ones(1), jnp.cumprod(free)])
    first_hit = jnp.append(values, 1.0) * passed
    # w divided by the product of all q, which cancels: of long beams both would underflow.
    passed_square = jnp.concatenate([jnp.ones(1), jnp.cumprod(free * free / square)])
    weight = jnp.append(values * values / square, 1.0) * passed_square
    centre = jnp.append(0.5 * (edges[1:] + edges[:-1]), edges[-1])
    between = (centre[:, None] - centre[None, :]) / deviation
    density = jnp.exp(-0.25 * between * between)
    information = (
        jnp.log(weight.sum())
        + jnp.log(first_hit @ density @ first_hit)
        - 2.0 * jnp.log(first_hit @ density @ weight)
    )
    return jnp.maximum(information, 0.0)


def _checked_edges(edges: Array, size: int) -> Array:
    if edges.shape != (size + 1,):
        raise ValueError(f"edges has shape {edges.shape}; accepted: ({size + 1},)")
    if not isinstance(edges, Tracer):
        distances = np.asarray(edges)
        if not (np.isfinite(distances).all() and (np.diff(distances) > 0.0).all()):
            raise ValueError(f"edges is {distances}; accepted: increasing finite distances")
    return edges
