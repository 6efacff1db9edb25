"""Rows of arrays that have one for each robot, in an order that does not depend on theirs."""

import jax.numpy as jnp
from jaxtyping import Array, Int

from jaxplore._types import Count


def others(rows: Array, identity: Int[Array, " N"], index: int | Count) -> Array:
    """Return the rows (N - 1, ...) of all robots but that at place `index`, by their identity."""
    rest = jnp.arange(identity.shape[0] - 1, dtype=jnp.int32)
    rest = rest + (rest >= identity[index]).astype(jnp.int32)
    return jnp.take(rows, jnp.argsort(identity)[rest], axis=0)


def by_identity(rows: Array, identity: Int[Array, " N"]) -> Array:
    """Return the rows (N, ...) of all robots by their identity."""
    return jnp.take(rows, jnp.argsort(identity), axis=0)
