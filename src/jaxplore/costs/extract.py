"""Extractors: what a cost reads of a state, by name or by a function of one's own.

A cost never indexes a state. It asks an extractor, a function from a `State` to a number or a
position, so that one cost serves every model:

| extractor | reads |
| --- | --- |
| `position`, `heading`, `speed` | what the model calls so |
| `component("phi")` | the component of that name |
| `from_physical(f)`, `from_virtual(f)` | `f` of that part of an `Augmented` state |
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
    """Return the extractor of the state component called `name`.

    Raises:
        ValueError: a name that is empty or no text. When traced, one that the model does not have.
    """
    if not isinstance(name, str) or not name:
        raise ValueError(f"name is {name!r}; accepted: the name of a state component")
    return _Component(name)


def from_physical(extractor: Extractor) -> Extractor:
    """Return what an extractor reads of the physical part of an `Augmented` state.

    Of a model that has no parts it is what the extractor reads.
    """
    return _Part(extractor, is_physical=True)


def from_virtual(extractor: Extractor) -> Extractor:
    """Return what an extractor reads of the virtual part of an `Augmented` state.

    Raises:
        ValueError: when traced, a model that has no parts.
    """
    return _Part(extractor, is_physical=False)


def extract(name: str, extractor: Extractor, state: State, shape: tuple[int, ...]) -> Any:
    """Return what an extractor reads.

    Args:
        name: of the argument that the extractor was given as, for messages.
        extractor: reads it.
        state: of the robot.
        shape: that it is to have.

    Raises:
        ValueError: it has another shape.
    """
    value = extractor(state)
    if jnp.shape(value) != shape:
        wanted = "one number" if shape == () else f"{shape[0]} numbers"
        raise ValueError(
            f"{name} returns shape {jnp.shape(value)}; accepted: {shape}, {wanted} of one state"
        )
    return value


# Modules without arrays: equal ones are the same program to the compiler, lambdas are not.
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
            physical, virtual = model.split_state(state.values)
            part = (
                State(physical, model.physical)
                if self.is_physical
                else State(virtual, model.virtual)
            )
            return self.extractor(part)
        if self.is_physical:
            return self.extractor(state)
        raise ValueError(
            f"dynamics is {type(model).__name__}, which has no virtual part; accepted: Augmented"
        )
