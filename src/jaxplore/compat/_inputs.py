"""What goes into a compiled function: each array once.

A path that two costs follow is one array in two places. As two inputs the compiler could not know
that they are equal, and would look everything up twice.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
from jax import Array


class Inputs(NamedTuple):
    """A pytree, taken apart.

    Args:
        arrays: its arrays, each once.
        structure: the rest, which is static.
    """

    arrays: tuple[Array, ...]
    structure: "Structure"


class Structure:
    """All of a pytree but its arrays; equal ones are the same program.

    Its hash is computed once: that of a controller takes longer than half of a command's overhead.

    Args:
        treedef: of the pytree.
        leaves: for each of its leaves the number of its array, or what is no array.
    """

    __slots__ = ("_hash", "leaves", "treedef")

    def __init__(self, treedef: Any, leaves: tuple[tuple[int | None, Any], ...]) -> None:
        self.treedef = treedef
        self.leaves = leaves
        self._hash = hash((treedef, leaves))

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        if self is other:
            return True
        return (
            isinstance(other, Structure)
            and self._hash == other._hash
            and self.leaves == other.leaves
            and bool(self.treedef == other.treedef)
        )


def take_apart(tree: Any) -> Inputs:
    """Return the arrays of a pytree, each once, and the rest."""
    values, treedef = jax.tree.flatten(tree)
    numbers: dict[int, int] = {}
    arrays: list[Array] = []
    leaves: list[tuple[int | None, Any]] = []
    for value in values:
        if not eqx.is_array(value):
            leaves.append((None, value))
            continue
        if id(value) not in numbers:
            numbers[id(value)] = len(arrays)
            arrays.append(value)
        leaves.append((numbers[id(value)], None))
    return Inputs(tuple(arrays), Structure(treedef, tuple(leaves)))


def put_together(inputs: Inputs) -> Any:
    """Return the pytree again."""
    leaves = [
        value if number is None else inputs.arrays[number]
        for number, value in inputs.structure.leaves
    ]
    return jax.tree.unflatten(inputs.structure.treedef, leaves)
