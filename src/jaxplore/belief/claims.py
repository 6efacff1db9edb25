"""Claims of the robots of a fleet to places: what another one sees sooner is worth less."""

import functools

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Scalar

MOST = 30.0
"""Greatest exponent of a claim: beyond it, the cost would grow without changing any choice."""


def claim_cost(
    own: Float[Array, "*nodes"],
    others: Float[Array, "K *nodes"],
    trust: Float[Array, " K"],
    *,
    sharpness: Scalar,
    decay_length: Scalar,
) -> Float[Array, "*nodes"]:
    """Return what the claims of other robots cost at each place as the end of a path [m]:

        kappa(s) = -decay_length ln share(s),
        share(s) = 1 / (1 + sum_k trust_k exp((d(s) - d_k(s)) / sharpness))

    with d the length of this robot's path to the place s (`own`), and d_k that of robot k's, as
    last heard (`others`) [m]. A length is infinite without a path: a robot to which a place is
    unreachable does not claim it. The trust is between 0, for a robot that was never heard, and 1.

    With trust 1, `share` is the softmax of the lengths: the chance of being the first at s if
    lengths are uncertain by `sharpness` [m]. So kappa is about 0 where this robot is nearer than
    all others, and it grows with the lead of the nearest other. As part of the cost-to-go of
    `jaxplore.belief.exploration_field`, with the same `decay_length`, it weighs the information of
    a place by the share.
    """
    is_claimed = jnp.isfinite(others) & jnp.isfinite(own)
    lead = jnp.where(is_claimed, own - others, 0.0) / sharpness
    claim = jnp.where(is_claimed, jnp.exp(jnp.minimum(lead, MOST)), 0.0)
    # Robot by robot: XLA's sum over a leading axis takes several times as long on a CPU.
    shares = [weight * each for weight, each in zip(jnp.unstack(trust), claim, strict=True)]
    return decay_length * jnp.log1p(functools.reduce(jnp.add, shares))


def trust_in(age: Float[Array, " K"], memory: Scalar) -> Float[Array, " K"]:
    """Return the trust in claims of an age [s], `exp(-age / memory)`; 0 for an infinite age."""
    return jnp.exp(-age / memory)
