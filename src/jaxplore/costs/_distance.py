"""How far a robot is from a point."""

import jax.numpy as jnp
from jax import Array

from jaxplore._types import Scalar
from jaxplore.dynamics.base import State


def offset(state: State, point: Array) -> tuple[Scalar, ...]:
    """Return position - point, component by component [m].

    Args:
        state: of the robot.
        point: (2,) or (3,) [m]; the third component is compared with `state["z"]`.
    """
    # Components, not vectors: of K samples each is one vector of K, in which XLA computes fastest.
    here = [*state.position]
    if point.shape[0] == 3:
        here.append(state["z"])
    return tuple(a - b for a, b in zip(here, point, strict=True))


def squared(components: tuple[Scalar, ...]) -> Scalar:
    """Return the squared length of a vector given by its components.

    A reduction over the few components of many samples would go to a kernel of its own, whose
    threads cost XLA's CPU back end more than the sum.
    """
    total = jnp.zeros(())
    for component in components:
        total = total + component * component
    return total


def length(components: tuple[Scalar, ...]) -> Scalar:
    """Return the length of a vector given by its components; its gradient at zero is zero.

    That of a vector that is not a number is none: a diverged rollout is not at its goal.
    """
    square = squared(components)
    is_zero = square <= 0.0
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, square)))
