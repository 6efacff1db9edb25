"""Checks of the arguments of a portfolio that differ between its members."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._trees import stack_trees
from jaxplore._types import Rows, Vector
from jaxplore.costs.base import Cost


def stack_costs(name: str, costs: Sequence[Cost], number: int) -> Cost:
    """Stack N costs of one kind into one cost whose arrays have a leading axis of N."""
    given = tuple(costs)
    # Costs are stacked array by array, which needs the same arrays of the same shapes in each.
    structures = {
        (jax.tree.structure(cost), tuple(jnp.shape(leaf) for leaf in jax.tree.leaves(cost)))
        for cost in given
    }
    if len(given) != number or not all(isinstance(cost, Cost) for cost in given):
        raise ValueError(
            f"objectives[{name!r}] has {len(given)} entries; accepted: a cost, or one for each of "
            f"the {number} members"
        )
    if len(structures) != 1:
        raise ValueError(
            f"objectives[{name!r}] has costs of different kinds; accepted: one kind, in which only "
            "numbers differ"
        )
    return stack_trees(given)


def normalise_weights(
    weights: Rows | Mapping[str, Mapping[str, float]],
    names: Sequence[str] | None,
    objectives: tuple[str, ...],
    argument: str = "weights",
) -> tuple[Float[Array, "N O"], tuple[str, ...]]:
    """Return the weights (N, O) with rows that add up to 1, and the names of the members.

    Weights in a mapping go by member and objective, and absent ones are 0. Members whose weights
    are an array are named "1", "2" ... without `names`. Messages call the weights `argument`.
    """
    if isinstance(weights, Mapping):
        if names is not None:
            raise ValueError(f"names is {names!r} beside weights by name; accepted: one of them")
        names = tuple(weights)
        weights = [values_in_order(row, objectives) for row in weights.values()]
    if isinstance(weights, jax.core.Tracer):
        given: Any = weights
    else:
        try:
            given = np.asarray(weights, np.float32)
        except (TypeError, ValueError):
            # The check of the shape below refuses it, with the message that names what is accepted.
            given = np.zeros(0, np.float32)
    if given.ndim != 2 or given.shape[0] < 1 or given.shape[1] != len(objectives):
        raise ValueError(
            f"{argument} has shape {given.shape}; accepted: (N, {len(objectives)}), one for each "
            f"member and objective ({', '.join(objectives)})"
        )
    if not _kinds.is_traced(given):
        if not (np.isfinite(given) & (given >= 0.0)).all():
            raise ValueError(f"{argument} is {given.tolist()}; accepted: finite numbers >= 0")
        if (given.sum(axis=1) <= 0.0).any():
            raise ValueError(
                f"{argument} is {given.tolist()}; accepted: in each row a weight that is not 0"
            )
    count = given.shape[0]
    if names is not None and not isinstance(names, (list, tuple)):
        text = _kinds.describe(names)
        raise ValueError(f"names is {text}; accepted: {count} different names")
    labels = tuple(str(index + 1) for index in range(count)) if names is None else tuple(names)
    if len(labels) != count or len(set(labels)) != count:
        raise ValueError(f"names is {labels}; accepted: {count} different names")
    rows = jnp.asarray(given, jnp.float32)
    return rows / jnp.sum(rows, axis=1, keepdims=True), labels


def values_in_order(row: Any, objectives: tuple[str, ...], absent: float = 0.0) -> Any:
    """Return the values of a mapping in the order of the objectives; pass anything else through."""
    if not isinstance(row, Mapping):
        return row
    for name in row:
        if name not in objectives:
            raise ValueError(f"objective is {name!r}; accepted: {', '.join(objectives)}")
    return [row.get(name, absent) for name in objectives]


def positive_each(name: str, value: Vector | None, number: int) -> Float[Array, " N"] | None:
    """Return one positive number for each of N members, or None where none are given."""
    if value is None:
        return None
    given = _checks.vector(name, value, number)
    if not _kinds.is_traced(given) and (np.asarray(given) <= 0.0).any():
        raise ValueError(f"{name} is {given.tolist()}; accepted: {number} positive numbers")
    return given


def check_objectives(objectives: object) -> None:
    """Raise a `ValueError` unless `objectives` maps names to costs, or to one for each member."""
    if not isinstance(objectives, Mapping):
        given = _kinds.describe(objectives)
        raise ValueError(f"objectives is {given}; accepted: costs by the name of the objective")
    for name, cost in objectives.items():
        each = cost if isinstance(cost, (list, tuple)) else [cost]
        for one in each:
            _kinds.instance(f"objectives[{name!r}]", one, Cost)
