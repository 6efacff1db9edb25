"""Compute the expected information of one range beam: the FSMI family.

A beam crosses cells 0 ... n-1, nearest first; cell i is occupied with probability o_i. The beam's
first hit is in cell j with probability `P(e_j) = o_j prod_{l<j} (1 - o_l)`, and with probability
`P(e_none) = prod_l (1 - o_l)` it hits nothing. A reading in cell k updates the cells before k as
free and cell k as occupied. Its information is

    C_k = f_occ,k + sum_{i<k} f_emp,i

with f the divergence of a cell's posterior from its prior (`jaxplore.information.gain`). The
information of no return is `sum_i f_emp,i`. With the range noise G (`jaxplore.information.noise`),
the expected information of the beam is

    I = sum_j sum_k P(e_j) G_kj C_k + P(e_none) sum_i f_emp,i            [nat]

which is the expectation of `sum_i KL(posterior_i || prior_i)` over maps and readings. Summed over
cells instead of readings it is

    I = sum_k v_k,   v_k = f_occ,k P(reading in k) + f_emp,k P(reading behind k, or none)

All terms are non-negative, so nothing cancels, and v_k is the contribution of cell k.

Source: Zhang, Henderson, Sze and Karaman, "FSMI: Fast computation of Shannon mutual information for
information-theoretic mapping", IJRR 2020, Theorem 1, extended by the no-return event.
"""

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jaxtyping import Bool, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, Scalar
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
    """Return the contribution of each cell along a beam to its expected information [nat].

    Args:
        probability: probability of occupancy (n,), nearest cell first.
        sensor: update of a cell by a measurement: the `InverseSensorModel` of the map with its
            clamp, or `IdealSensor()` for Shannon's mutual information. The default
            `InverseSensorModel.from_odds()` adds log-odds of 0.85 and -0.4 without a clamp.
        noise: range noise: `GaussianNoise` (exact or banded), `UniformNoise` or `ToeplitzNoise`;
            None for no noise.
        no_return: whether a beam that meets nothing counts as passing every cell. Without it most
            of the information of open space is lost.
        edges: increasing distances (n + 1,) at which the cells begin and end, in the unit of the
            noise; 0 ... n by default.

    Raises:
        ValueError: no cells, a probability outside [0, 1], edges that do not fit or increase.
    """
    values = _checks.probabilities("probability", probability, 1)
    size, cell_size = values.shape[0], None
    if edges is None:
        edges, cell_size = jnp.arange(size + 1, dtype=jnp.float32), 1.0
    else:
        edges = _check_edges(edges, size)
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
    """Return the contribution of each cell [nat], v_k of this module's formula, the nearest first.

    The cells begin and end at the distances `edges`. `cell_size` is the side of a grid cell in the
    unit of `edges`; None if the cells are not grid cells. If `no_return`, a beam that meets nothing
    counts as passing every cell. Cells that are not `in_range` pad the far end, and a reading there
    is discarded.
    """
    passed = jnp.cumprod(1.0 - probability)
    hit = probability * jnp.concatenate([jnp.ones(1), passed[:-1]])
    if noise is None and no_return:
        behind = passed  # without noise: a reading behind k, or none, means the beam passed k
    else:
        if noise is not None:
            hit = noise.apply(hit, edges, cell_size)
            hit = hit if in_range is None else jnp.where(in_range, hit, 0.0)
        # Sum from the far end: as 1 minus a sum from the near end, small values would cancel.
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

    with p the probabilities of the first hit, `q = o^2 + (1 - o)^2` and
    `w_l = p_l^2 prod_{k>l} q_k`. The last entry of p is the probability of no return, at the end of
    the last cell. I_CS is another divergence than Shannon's: its values are not comparable with
    nats, and it does not use an inverse sensor model.

    Source: Charrow, Liu, Kumar and Michael, "Information-theoretic mapping using Cauchy-Schwarz
    quadratic mutual information", ICRA 2015, eq. 8.

    Args:
        probability: probability of occupancy (n,), nearest cell first.
        std: standard deviation s of the range noise, in the unit of `edges`.
        edges: distances (n + 1,) at which the cells begin and end; 0 ... n by default.

    Raises:
        ValueError: no cells, a probability outside [0, 1], edges that do not fit or increase, a
            standard deviation that is not positive.
    """
    values = _checks.probabilities("probability", probability, 1)
    deviation = _checks.scalar("std", std, above=0.0)
    size = values.shape[0]
    edges = jnp.arange(size + 1, dtype=jnp.float32) if edges is None else _check_edges(edges, size)
    free = 1.0 - values
    square = values * values + free * free
    passed = jnp.concatenate([jnp.ones(1), jnp.cumprod(free)])
    first_hit = jnp.append(values, 1.0) * passed
    # w is divided by the product of all q, which cancels in I_CS: for long beams both underflow.
    passed_square = jnp.concatenate([jnp.ones(1), jnp.cumprod(free * free / square)])
    weight = jnp.append(values * values / square, 1.0) * passed_square
    centre = jnp.append(0.5 * (edges[1:] + edges[:-1]), edges[-1])
    between = (centre[:, None] - centre[None, :]) / deviation
    # The exponent of N(d; 2 s^2) is -d^2 / (4 s^2). Its factor in front cancels in I_CS.
    density = jnp.exp(-0.25 * between * between)
    information = (
        jnp.log(weight.sum())
        + jnp.log(first_hit @ density @ first_hit)
        - 2.0 * jnp.log(first_hit @ density @ weight)
    )
    # The divergence is never negative, but rounding can make it so.
    return jnp.maximum(information, 0.0)


def _check_edges(edges: Array, size: int) -> Array:
    if edges.shape != (size + 1,):
        raise ValueError(f"edges has shape {edges.shape}; accepted: ({size + 1},)")
    if not isinstance(edges, Tracer):
        distances = np.asarray(edges)
        if not (np.isfinite(distances).all() and (np.diff(distances) > 0.0).all()):
            raise ValueError(f"edges is {distances}; accepted: increasing finite distances")
    return edges
