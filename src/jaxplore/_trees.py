"""Combine pytrees."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp


def stack_trees[Tree](trees: Sequence[Tree]) -> Tree:
    """Return N pytrees of one structure as one, whose arrays have a leading axis of N."""
    stacked: Tree = jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)
    return stacked
