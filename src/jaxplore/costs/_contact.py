"""Distances that costs measure: of the discs that cover a robot, and the least of many.

Mapped over K samples, an array of one value per item becomes (K, N) and is reduced sample by
sample. A scan (`least`) computes each item on vectors of K samples. With 100 items it is five times
as fast on a CPU, and its compile time does not grow with N.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array

from jaxplore._types import Count, Scalar
from jaxplore.dynamics.base import State
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.footprint import Disc

UNROLL = 8
"""Items per iteration of the scan: fewer iterations, while the program stays short."""
Lever = tuple[Scalar, ...]
"""Offset from the position of a robot to the centre of a disc, (x, y) [m]; empty for no offset."""


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


def offset(state: State, point: Array) -> tuple[Scalar, ...]:
    """Compute position minus point, component by component [m].

    The third component of a point in space is compared with `state["z"]`.
    """
    # Mapped over K samples, each component is one vector of K, which XLA turns into fast loops.
    here = [*state.position]
    if point.shape[0] == 3:
        here.append(state["z"])
    return tuple(a - b for a, b in zip(here, point, strict=True))


def levers(state: State) -> tuple[Lever, ...]:
    """Compute the offset of each disc that covers the robot.

    For a robot that is one disc the offset is empty, so that its heading is not computed.
    """
    footprint = state.dynamics.footprint
    if isinstance(footprint, Disc):
        return ((),)
    sin, cos = sin_cos(state.heading)
    return tuple((ahead * cos, ahead * sin) for ahead in footprint.offsets)


def add_lever(components: tuple[Scalar, ...], lever: Lever) -> tuple[Scalar, ...]:
    """Add an offset to a vector; a third component, the height, does not change."""
    # `zip` stops at the shorter vector: the lever of a single disc is empty, and none has a height.
    moved = tuple(a + b for a, b in zip(components, lever, strict=False))
    return moved + components[len(moved) :]


def contact(state: State, margin: Scalar, reaction_time: Scalar) -> Scalar:
    """Compute the distance of a disc's centre below which the robot is too close [m]."""
    return state.dynamics.footprint.radius + margin + reaction_time * jnp.abs(state.speed)


def depth(distance: Scalar, too_close: Scalar) -> Scalar:
    """Compute by how much a distance is too small, in units of 5 cm."""
    return jnp.maximum(too_close - distance, 0.0) / 0.05


def penalty(distance: Scalar, clearance: Scalar, too_close: Scalar, collision: Scalar) -> Scalar:
    """Compute the cost of a distance d of a disc's centre to an obstacle [m].

        ((clearance - d)_+ / clearance)^2 + collision * ((too_close - d)_+ / 0.05 m)^2

    The factor `collision` is the cost of being 5 cm too close.
    """
    near = jnp.maximum(clearance - distance, 0.0) / clearance
    deep = depth(distance, too_close)
    return near * near + collision * deep * deep
