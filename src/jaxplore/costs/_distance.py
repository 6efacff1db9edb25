"""Distances between a robot and a point, computed component by component."""

from jax import Array

from jaxplore._types import Scalar
from jaxplore.dynamics.base import State


def offset(state: State, point: Array) -> tuple[Scalar, ...]:
    """Compute position minus point, component by component [m].

    The third component of a point in space is compared with `state["z"]`.
    """
    # Mapped over K samples, each component is one vector of K, which XLA turns into fast loops.
    here = [*state.position]
    if point.shape[0] == 3:
        here.append(state["z"])
    return tuple(a - b for a, b in zip(here, point, strict=True))
