"""Extractors: functions that read a number or a position from a `State`.

A cost does not index the state vector. It calls an extractor, so that one cost serves all models:

| extractor | reads |
| --- | --- |
| `position`, `heading`, `speed` | the quantity that the model defines under this name |
| `component("phi")` | the state component of this name |
| `from_physical(f)`, `from_virtual(f)` | `f` of one part of an `Augmented` state |
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp

from jaxplore._types import Position, Scalar
from jaxplore.dynamics.augmented import Augmented
from jaxplore.dynamics.base import State

Extractor = Callable[[State], Any]


def position(state: State) -> Position:
    """Return the position (x, y) [m]."""
    return state.position


def heading(state: State) -> Scalar:
    """Return the heading [rad]."""
    return state.heading


def speed(state: State) -> Scalar:
    """Return the forward speed [m/s]."""
    return state.speed


def component(name: str) -> Extractor:
    """Return the extractor of the state component called `name`, which the model must have."""
    if not isinstance(name, str) or not name:
        raise ValueError(f"name is {name!r}; accepted: the name of a state component")
    return _Component(name)


def from_physical(extractor: Extractor) -> Extractor:
    """Apply an extractor to the physical part of an `Augmented` state.

    For a model without parts it is applied to the whole state.
    """
    return _Part(extractor, is_physical=True)


def from_virtual(extractor: Extractor) -> Extractor:
    """Apply an extractor to the virtual part of an `Augmented` state, which the model must have."""
    return _Part(extractor, is_physical=False)


def extract(name: str, extractor: Extractor, state: State, shape: tuple[int, ...]) -> Any:
    """Apply an extractor and check the shape of the result.

    Args:
        name: name of the argument that holds the extractor, for error messages.
        extractor: extractor to apply.
        state: state of the robot.
        shape: required shape of the result.

    Raises:
        ValueError: a result of another shape.
    """
    value = extractor(state)
    if jnp.shape(value) != shape:
        wanted = "one number" if shape == () else f"{shape[0]} numbers"
        raise ValueError(
            f"{name} returns shape {jnp.shape(value)}; accepted: {shape}, {wanted} of one state"
        )
    return value


# Modules instead of lambdas: two equal modules have the same hash and share a compiled program.
class _Component(eqx.Module):
    name: str = eqx.field(static=True)

    def __call__(self, state: State) -> Scalar:
        return state[self.name]


class _Part(eqx.Module):
    extractor: Extractor = eqx.field(static=True)
    is_physical: bool = eqx.field(static=True)

    def __call__(self, state: State) -> Any:
        model = state.dynamics
        if isinstance(model, Augmented):
            controls = None if state.control is None else model.split_control(state.control)
            models, index = (model.physical, model.virtual), 0 if self.is_physical else 1
            values = model.split_state(state.values)[index]
            given = None if controls is None else controls[index]
            return self.extractor(State(values, models[index], given))
        if self.is_physical:
            return self.extractor(state)
        raise ValueError(
            f"dynamics is {type(model).__name__}, which has no virtual part; accepted: Augmented"
        )
