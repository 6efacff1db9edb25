"""List, read and replace the parameters of a controller by name."""

import dataclasses
import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from jaxplore import _kinds
from jaxplore._types import ArrayLike
from jaxplore.costs.base import Cost, NamedCost, SumCost, WeightedCost

PREFIX = "controller."
"""Optional prefix of a parameter's path."""
MOST_ELEMENTS = 64
"""Largest number of elements of a parameter: larger arrays are maps and tables."""


class _Place(NamedTuple):
    """Leaf of a pytree and the attributes (with a leading dot) and indices that lead to it."""

    steps: tuple[str | int, ...]
    value: Array


def get_parameters(controller: Any) -> dict[str, Array]:
    """Return the parameters of a controller, or of any pytree of modules, by their path.

    Parameters are float arrays of at most 64 elements. A path joins the names of the fields that
    lead to one, as in `weighting.temperature`. The terms of a sum of costs are entered by name, as
    in `cost.information.weight`: the name given by `Cost.with_name`, or the class name without
    `Cost` in lower case. A repeated name gets a number from the second on,
    `cost.obstacle-2.weight`. The wrapper of a weight is left out of the path,
    `cost.obstacle.clearance`.

    Args:
        controller: pytree that is searched; it may be traced.
    """
    return {path: place.value for path, place in _places(controller).items()}


def find_parameter(controller: Any, path: str) -> str:
    """Return the full path of the parameter that an abbreviated path refers to.

    Names within a path may be left out as long as it fits exactly one parameter, and it may begin
    with `controller.`: `controller.temperature` refers to `weighting.temperature`.

    Args:
        controller: pytree that is searched.
        path: full or abbreviated path.

    Raises:
        ValueError: a path that fits no parameter, or several; the message names the nearest.
    """
    return _match(path, tuple(_parameters_of(controller)))


def set_parameters[C](controller: C, values: Mapping[str, ArrayLike | Sequence[float]]) -> C:
    """Return a controller with other parameter values, without recompilation.

    Args:
        controller: pytree whose parameters are replaced; it stays unchanged.
        values: new values by path, see `find_parameter`: one number for all elements, or an array
            of the parameter's shape.

    Raises:
        ValueError: an unknown path, a value of another shape or one that is not finite.
    """
    if not isinstance(values, Mapping):
        given = _kinds.describe(values)
        raise ValueError(f"values is {given}; accepted: numbers by the path of a parameter")
    places = _parameters_of(controller)
    for path, value in values.items():
        place = places[_match(path, tuple(places))]
        new = jnp.asarray(value, place.value.dtype)
        if new.shape not in ((), place.value.shape):
            raise ValueError(
                f"parameter {path} has shape {new.shape}; accepted: one number, or "
                f"{place.value.shape}"
            )
        if not isinstance(new, jax.core.Tracer) and not np.isfinite(np.asarray(new)).all():
            raise ValueError(f"parameter {path} is {value!r}; accepted: finite numbers")
        new = jnp.broadcast_to(new, place.value.shape)

        # `steps` is a default, because a closure would see later values of the loop variable.
        def there(tree: Any, steps: tuple[str | int, ...] = place.steps) -> Any:
            for step in steps:
                is_field = isinstance(step, str) and step.startswith(".")
                tree = getattr(tree, str(step)[1:]) if is_field else tree[step]
            return tree

        controller = eqx.tree_at(there, controller, new)
    return controller


def split_index(name: str) -> tuple[str, int | None]:
    """Split `path[i]` into the path of a parameter and the index of an element; None without."""
    path, bracket, rest = name.partition("[")
    if not bracket:
        return name, None
    number = rest.removesuffix("]")
    if not rest.endswith("]") or not number.isdigit():
        raise ValueError(
            f"parameter is {name!r}; accepted: a path, or a path with an index, a.b[0]"
        )
    return path, int(number)


def _parameters_of(controller: Any) -> dict[str, _Place]:
    places = _places(controller)
    if not places:  # no path could be right
        given = _kinds.describe(controller)
        raise ValueError(f"controller is {given}; accepted: a controller, or a tree with numbers")
    return places


def nearest(name: str, known: Mapping[str, Any] | tuple[str, ...], number: int = 3) -> str:
    """Return at most `number` known names most similar to a name, separated by commas."""
    # A right last name with a wrong path is the most frequent mistake: list those first.
    last = name.rpartition(".")[2]
    exact = [each for each in known if each.rpartition(".")[2] == last]
    # Without a cutoff the message lists names however different they are.
    close = difflib.get_close_matches(name, list(known), n=number, cutoff=0.0)
    return ", ".join(list(dict.fromkeys([*exact, *close]))[:number])


def _match(path: str, known: tuple[str, ...]) -> str:
    if not isinstance(path, str):
        given = _kinds.describe(path)
        raise ValueError(f"path is {given}; accepted: the path of a parameter, such as {known[0]}")
    # Try the path as given first: a component may itself be called "controller".
    for given in (path, path.removeprefix(PREFIX)):
        if given in known:
            return given
        wanted = given.split(".")
        fits = [each for each in known if _is_within(wanted, each.split("."))]
        if len(fits) == 1:
            return fits[0]
        if fits:
            raise ValueError(
                f"parameter {path} may be any of {', '.join(fits[:6])}; accepted: one of them"
            )
    raise ValueError(f"parameter {path} is not known; accepted: such as {nearest(path, known)}")


def _is_within(wanted: list[str], parts: list[str]) -> bool:
    """Return whether the wanted names are a subsequence of the parts that ends with the last."""
    if wanted[-1] != parts[-1]:
        return False
    rest = iter(parts)  # `in` consumes the iterator, which tests for a subsequence
    return all(name in rest for name in wanted)


def _places(tree: Any) -> dict[str, _Place]:
    found: dict[str, _Place] = {}
    # If two leaves have the same path, it refers to the first.
    for names, steps, value in _walk(tree, (), ()):
        found.setdefault(".".join(names), _Place(steps, value))
    return found


type _Found = tuple[tuple[str, ...], tuple[str | int, ...], Array]


def _walk(tree: Any, names: tuple[str, ...], steps: tuple[str | int, ...]) -> Iterator[_Found]:
    """Yield the parameters of a pytree; `names` and `steps` lead to it from the root."""
    # Costs are dataclasses too, so they come first: wrappers of a cost are left out of the path.
    if isinstance(tree, Cost):
        yield from _walk_cost(tree, names, steps)
    elif isinstance(tree, jax.Array):
        if jnp.issubdtype(tree.dtype, jnp.floating) and tree.size <= MOST_ELEMENTS:
            yield names, steps, tree
    elif dataclasses.is_dataclass(tree):
        yield from _walk_fields(tree, names, steps)
    elif isinstance(tree, Mapping):
        for key, inner in tree.items():
            yield from _walk(inner, (*names, str(key)), (*steps, key))
    elif isinstance(tree, tuple | list):
        # The path has the field names of a named tuple, but the step to a leaf is an index.
        keys = getattr(tree, "_fields", range(len(tree)))
        for index, (key, inner) in enumerate(zip(keys, tree, strict=True)):
            yield from _walk(inner, (*names, str(key)), (*steps, index))


def _walk_cost(
    cost: Cost, names: tuple[str, ...], steps: tuple[str | int, ...]
) -> Iterator[_Found]:
    """Yield the parameters of a cost, with the terms of a sum under their names."""
    name, weights, inner, where = _unwrap(cost, steps)
    yield from _weights(weights, names)
    if not isinstance(inner, SumCost):
        yield from _walk_fields(inner, names, where)
        return
    seen: dict[str, int] = {}
    for each, at in _summands(inner, where):
        name, weights, term, there = _unwrap(each, at)
        seen[name] = seen.get(name, 0) + 1
        here = (*names, f"{name}-{seen[name]}" if seen[name] > 1 else name)
        # A sum with a name or weight of its own is one term, and its terms are listed below it.
        if isinstance(term, SumCost):
            yield from _walk_cost(each, here, at)
        else:
            yield from _weights(weights, here)
            yield from _walk_fields(term, here, there)


def _walk_fields(
    module: Any, names: tuple[str, ...], steps: tuple[str | int, ...]
) -> Iterator[_Found]:
    for field in dataclasses.fields(module):
        if not field.metadata.get("static", False):
            inner = getattr(module, field.name, None)
            yield from _walk(inner, (*names, field.name), (*steps, f".{field.name}"))


def _summands(
    cost: Cost, steps: tuple[str | int, ...]
) -> Iterator[tuple[Cost, tuple[str | int, ...]]]:
    """Yield the terms of nested sums, with the steps that lead to them."""
    if isinstance(cost, SumCost):
        for index, inner in enumerate(cost.costs):
            yield from _summands(inner, (*steps, ".costs", index))
    else:
        yield cost, steps


type _Weights = tuple[tuple[tuple[str | int, ...], Array], ...]


def _unwrap(
    cost: Cost, steps: tuple[str | int, ...]
) -> tuple[str, _Weights, Cost, tuple[str | int, ...]]:
    """Return the name of a cost, its weights from the outside in, the inner cost and its steps."""
    name, weights = "", []
    while isinstance(cost, WeightedCost | NamedCost):
        if isinstance(cost, WeightedCost):
            weights.append(((*steps, ".weight"), cost.weight))
        else:
            name = name or cost.name
        cost, steps = cost.cost, (*steps, ".cost")
    if not name:
        kind = type(cost).__name__.removesuffix("Cost")
        name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", kind).lower()
    return name, tuple(weights), cost, steps


def _weights(weights: _Weights, names: tuple[str, ...]) -> Iterator[_Found]:
    """Yield nested weights: the innermost is `weight`, the next ones `weight-2`, `weight-3`, ..."""
    for index, (at, weight) in enumerate(weights):
        outwards = len(weights) - index
        yield (*names, "weight" if outwards == 1 else f"weight-{outwards}"), at, weight
