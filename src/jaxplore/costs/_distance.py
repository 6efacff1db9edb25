"""How far a robot is from a point."""

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
