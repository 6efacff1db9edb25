"""Distances between a robot and a point, computed component by component."""

import jax.numpy as jnp
from jax import Array

from jaxplore._types import Scalar
from jaxplore.dynamics.base import State


def offset(state: State, point: Array) -> tuple[Scalar, ...]:
    """Compute position minus point, component by component [m].

    Args:
        state: state of the robot.
        point: (2,) or (3,) [m]; the third component is compared with `state["z"]`.
    """
    # Mapped over K samples, each component is one vector of K, which XLA turns into fast loops.
    here = [*state.position]
    if point.shape[0] == 3:
        here.append(state["z"])
    return tuple(a - b for a, b in zip(here, point, strict=True))


def squared(components: tuple[Scalar, ...]) -> Scalar:
    """Compute the squared length of a vector given by its components."""
    # For a reduction over two or three components XLA's CPU back end would start a kernel of its
    # own, whose threads cost more than the sum.
    total = jnp.zeros(())
    for component in components:
        total = total + component * component
    return total


def length(components: tuple[Scalar, ...]) -> Scalar:
    """Compute the length of a vector given by its components; its gradient at 0 is 0.

    The length of a vector with NaN is NaN, so a diverged rollout does not count as at its goal.
    """
    square = squared(components)
    is_zero = square <= 0.0
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, square)))
