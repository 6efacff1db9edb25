"""Compute length and angle of vectors that may be zero, with finite gradients there.

Vectors are given by their components. Mapped over K samples, each component is one vector of K, on
which XLA computes fastest: a reduction over the few components of many samples would go to a kernel
of its own, whose threads cost XLA's CPU back end more than the sum.
"""

import functools
import operator

import jax.numpy as jnp
from jax import Array

from jaxplore._types import Scalar

TINY = 1e-30
"""Squared length below which a vector counts as zero; float32 can still divide by it."""


def squared_length(*components: Scalar) -> Scalar:
    """Return the squared length of a vector."""
    return functools.reduce(operator.add, [component * component for component in components])


def length(*components: Scalar) -> Scalar:
    """Return the length of a vector, with gradient 0 where it is zero.

    The length of a vector with a NaN component is NaN: a diverged rollout is not at its goal.
    """
    squared = squared_length(*components)
    return _root_unless(squared < TINY, squared)


def root(square: Array) -> Array:
    """Return the square root, with gradient 0 where it is 0."""
    return _root_unless(square <= 0.0, square)


def _root_unless(is_zero: Array, square: Array) -> Array:
    # Guard the argument as well: the gradient of the square root at 0 is infinite, and `where`
    # would turn it into NaN.
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, square)))


def angle(x: Scalar, y: Scalar) -> Scalar:
    """Return the angle of (x, y) from the x axis [rad]: 0 with gradient 0 for a zero vector."""
    is_zero = x * x + y * y < TINY
    return jnp.arctan2(jnp.where(is_zero, 0.0, y), jnp.where(is_zero, 1.0, x))
