"""Sums and minima over N items, such as obstacles, by a scan over the items.

Mapped over K samples, an array of one value per item becomes (K, N) and is reduced sample by
sample. A scan computes each item on vectors of K samples. With 100 items it is five times as fast
on a CPU, and its compile time does not grow with N.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxplore._types import Count, Scalar

UNROLL = 8
"""Items per iteration of the scan: fewer iterations, while the program stays short."""


def add_up(value: Callable[[Any], Scalar], items: Any) -> Scalar:
    """Sum `value(item)` over all items, a pytree of arrays whose first axis counts them."""

    def add(total: Scalar, each: Any) -> tuple[Scalar, None]:
        return total + value(each), None

    return jax.lax.scan(add, jnp.zeros(()), items, unroll=UNROLL)[0]


def least(value: Callable[[Any], Scalar], items: Any) -> tuple[Scalar, Count]:
    """Find the least `value(item)`, NaN if one is NaN, and the index of the first item that has it.

    `items` is a pytree of arrays whose first axis counts them.
    """
    count = jax.tree.leaves(items)[0].shape[0]

    def take(best: tuple[Scalar, Count], item: tuple[Any, Count]) -> tuple[Any, None]:
        each, index = item
        candidate = value(each)
        # NaN counts as least: a comparison alone would skip it, and a rollout whose position is not
        # finite would be far from everything.
        is_less = (candidate < best[0]) | jnp.isnan(candidate)
        return (jnp.where(is_less, candidate, best[0]), jnp.where(is_less, index, best[1])), None

    start = (jnp.full((), jnp.inf, float), jnp.zeros((), jnp.int32))
    indices = jnp.arange(count, dtype=jnp.int32)
    result: tuple[Scalar, Count] = jax.lax.scan(take, start, (items, indices), unroll=UNROLL)[0]
    return result
