"""Pass a pytree to a compiled function with each of its arrays once.

An array that two costs share, such as a path, occurs twice in the pytree. As two separate inputs
the compiler could not know that they are equal, and would evaluate every look-up twice.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
from jax import Array


class Inputs(NamedTuple):
    """Pytree, split into its arrays and its static structure.

    Args:
        arrays: distinct arrays of the pytree.
        structure: everything else, which is static.
    """

    arrays: tuple[Array, ...]
    structure: "Structure"


class Structure:
    """Everything of a pytree except its arrays; equal structures share one compiled program.

    The hash is computed once, because hashing a controller takes more than half of the overhead of
    a call.

    Args:
        treedef: tree structure from `jax.tree.flatten`.
        leaves: for each leaf the index of its array, or the leaf itself if it is not an array.
    """

    __slots__ = ("_hash", "leaves", "treedef")

    def __init__(self, treedef: Any, leaves: tuple[tuple[int | None, Any], ...]) -> None:
        self.treedef = treedef
        self.leaves = leaves
        self._hash = hash((treedef, leaves))

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> bool:
        # jax.jit compares cache keys on each call: identity and hash are the fast ways out.
        if self is other:
            return True
        return (
            isinstance(other, Structure)
            and self._hash == other._hash
            and self.leaves == other.leaves
            and bool(self.treedef == other.treedef)
        )


def split_arrays(tree: Any) -> Inputs:
    """Split a pytree into its distinct arrays and its static structure."""
    values, treedef = jax.tree.flatten(tree)
    # Arrays are compared by identity: comparing values would force a transfer from the device.
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


def join_arrays(inputs: Inputs) -> Any:
    """Rebuild the pytree from its arrays and its structure."""
    leaves = [
        value if number is None else inputs.arrays[number]
        for number, value in inputs.structure.leaves
    ]
    return jax.tree.unflatten(inputs.structure.treedef, leaves)
