"""Angles."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def wrap_angle(angle: Float[Array, "*N"]) -> Float[Array, "*N"]:
    """Return the same direction in [-pi, pi) [rad]."""
    return jnp.mod(angle + jnp.pi, 2.0 * jnp.pi) - jnp.pi
