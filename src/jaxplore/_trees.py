"""Combine pytrees."""

import copy
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp


def stack_trees[Tree](trees: Sequence[Tree]) -> Tree:
    """Return N pytrees of one structure as one, whose arrays have a leading axis of N."""
    stacked: Tree = jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)
    return stacked


class HostOnly[T]:
    """A value that belongs to an object on the host, and on which no compiled program depends.

    All instances compare equal. As a static field, another value therefore does not compile a
    program again. For the same reason a compiled function must neither read nor return the value:
    it would be that of the call for which it was compiled.
    """

    __slots__ = ("value",)

    def __init__(self, value: T) -> None:
        self.value = value

    def __eq__(self, other: object) -> bool:
        return isinstance(other, HostOnly)

    def __hash__(self) -> int:
        return hash(HostOnly)

    def __repr__(self) -> str:
        return repr(self.value)


def with_field[T: eqx.Module](module: T, name: str, value: Any) -> T:
    """Return a module with another value of a field that `eqx.tree_at` cannot set.

    Modules are frozen. `eqx.tree_at` sets leaves, not static fields, and no field that a
    constructor has left at its default.
    """
    same = copy.copy(module)
    object.__setattr__(same, name, value)
    return same
