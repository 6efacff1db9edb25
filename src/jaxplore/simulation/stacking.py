"""Stacked pytrees of one structure, for `jax.vmap` and for selection by index."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from jaxplore._types import Count

type LeafMask = tuple[bool, ...]
"""Whether each array leaf of the controller and the scenario differs between the runs."""


class Stacked(eqx.Module):
    """Several pytrees of one structure; arrays that are equal in all of them are stored once.

    So costs with different weights share one map. `arrays` are the leaves, with a leading axis
    where `differs`. `structure` is that of a pytree of the array leaves. `rest` are the leaves that
    are not arrays, the same in all pytrees.
    """

    arrays: tuple[Array, ...]
    differs: LeafMask = eqx.field(static=True)
    structure: Any = eqx.field(static=True)
    rest: Any

    @classmethod
    def from_trees(
        cls, trees: Sequence[Any], differs: LeafMask | None = None, *, name: str = "members"
    ) -> "Stacked":
        """Stack pytrees of one structure, at least one.

        Leaves that `differs` marks are stacked even if they are equal here, so that several calls
        share a compiled program. `name` is that of the argument, for the error message.

        Raises:
            ValueError: pytrees that differ in more than the values of their arrays.
        """
        split = [eqx.partition(tree, eqx.is_array) for tree in trees]
        flat: list[tuple[list[Array], Any]] = [jax.tree.flatten(arrays) for arrays, _ in split]
        first, structure = flat[0]
        rest = split[0][1]
        shapes = [(leaf.shape, leaf.dtype) for leaf in first]
        for index, ((leaves, kind), (_, other)) in enumerate(zip(flat, split, strict=True)):
            same = kind == structure and shapes == [(leaf.shape, leaf.dtype) for leaf in leaves]
            if not same or not bool(eqx.tree_equal(other, rest)):
                raise ValueError(
                    f"{name}[{index}] differs from the first in more than numbers; accepted: the "
                    "same parts, with the same sizes"
                )
        columns = list(zip(*(leaves for leaves, _ in flat), strict=True))
        given = differs or (False,) * len(columns)
        found = tuple(
            is_given or any(not _is_same(column[0], each) for each in column[1:])
            for is_given, column in zip(given, columns, strict=True)
        )
        arrays = tuple(
            jnp.stack(column) if is_stacked else column[0]
            for is_stacked, column in zip(found, columns, strict=True)
        )
        return cls(arrays, found, structure, rest)

    @property
    def axes(self) -> tuple[int | None, ...]:
        """Axes of `arrays` for `jax.vmap`: 0 or None."""
        return tuple(0 if is_stacked else None for is_stacked in self.differs)

    def tree(self, arrays: Sequence[Array]) -> Any:
        """Rebuild one of the pytrees from its arrays."""
        return eqx.combine(jax.tree.unflatten(self.structure, arrays), self.rest)

    def at(self, i: int | Count) -> Any:
        """Return one of the pytrees; the index may be traced."""
        return self.tree(
            [
                leaf[i] if is_stacked else leaf
                for leaf, is_stacked in zip(self.arrays, self.differs, strict=True)
            ]
        )


def _is_same(one: Array, other: Array) -> bool:
    # Identity comes first: a large shared map is then not compared cell by cell.
    return one is other or np.array_equal(np.asarray(one), np.asarray(other), equal_nan=True)
