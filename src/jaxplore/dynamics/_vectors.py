"""Length and angle of vectors that may be zero: finite there, and so are their gradients."""

import functools
import operator

import jax.numpy as jnp

from jaxplore._types import Scalar

TINY = 1e-30
"""A vector whose squared length is below this is zero; float32 still divides by it."""


def length(*components: Scalar) -> Scalar:
    """Return the length of a vector, with gradient 0 where it is zero."""
    squared = functools.reduce(operator.add, [component * component for component in components])
    is_zero = squared < TINY
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, squared)))


def angle(x: Scalar, y: Scalar) -> Scalar:
    """Return the angle of (x, y) from the x axis [rad], with gradient 0 where both are zero."""
    is_zero = x * x + y * y < TINY
    return jnp.arctan2(jnp.where(is_zero, 0.0, y), jnp.where(is_zero, 1.0, x))
