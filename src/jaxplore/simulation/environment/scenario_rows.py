"""Several scenarios of one size as one."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore._types import Count
from jaxplore.simulation.exploration.scenario import Scenario


def stacked(scenarios: tuple[Any, ...]) -> tuple[Scenario, Scenario | None]:
    """Return what scenarios share, and rows of what differs; each without the other's arrays.

    Args:
        scenarios: one, or several that differ in the values of their arrays only.

    Raises:
        ValueError: none, something else, or scenarios that differ in more.
    """
    if not scenarios or not all(isinstance(each, Scenario) for each in scenarios):
        raise ValueError(f"scenarios is {scenarios!r}; accepted: a scenario, or several")
    if len(scenarios) == 1:
        return scenarios[0], None
    arrays, rest = zip(*(eqx.partition(each, eqx.is_array) for each in scenarios), strict=True)
    structures = [eqx.filter_eval_shape(lambda each: each, each) for each in arrays]
    for index in range(1, len(scenarios)):
        if structures[index] != structures[0] or rest[index] != rest[0]:
            raise ValueError(
                f"scenarios[{index}] differs from the first in its size or parts; accepted: "
                "scenarios of the same size and parts"
            )

    def is_same(*leaves: Array) -> bool:
        return all(np.array_equal(leaves[0], leaf) for leaf in leaves[1:])

    def rows(*leaves: Array) -> Array | None:
        return None if is_same(*leaves) else jnp.stack(leaves)

    def common(*leaves: Array) -> Array | None:
        return leaves[0] if is_same(*leaves) else None

    shared: Scenario = eqx.combine(jax.tree.map(common, *arrays), rest[0])
    several: Scenario = jax.tree.map(rows, *arrays)
    return shared, several


def picked(shared: Scenario, several: Scenario | None, choice: Count) -> Scenario:
    """Return one of the scenarios that were stacked.

    Args:
        shared: what they share.
        several: rows of what differs; None if there is one.
        choice: which.
    """
    if several is None:
        return shared
    one: Scenario = eqx.combine(jax.tree.map(lambda rows: rows[choice], several), shared)
    return one
