"""The numbers inside a controller, by name: to list, read and replace them."""

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
from jax.typing import ArrayLike

from jaxplore.costs.base import Cost, NamedCost, SumCost, WeightedCost

PREFIX = "controller."
"""May stand before a path, to say of what it is."""
MOST_ELEMENTS = 64
"""Larger arrays are maps and tables, not settings."""


class _Place(NamedTuple):
    """Where a leaf is: attributes and indices on the way to it."""

    steps: tuple[str | int, ...]
    value: Array


def get_parameters(controller: Any) -> dict[str, Array]:
    """Return the small float arrays of a controller, or of any pytree of modules, by their path.

    A path has the names of the fields on the way, as in `weighting.temperature`. A sum of costs is
    entered by the names of its terms, `cost.information.weight`: the class without `Cost`, in lower
    case, or the name given by `Cost.named`; what is there twice has a number from the second on,
    `cost.obstacle-2.weight`. Weights need not be passed through: `cost.obstacle.clearance`.

    Args:
        controller: the pytree; traced or not.
    """
    return {path: place.value for path, place in _places(controller).items()}


def find_parameter(controller: Any, path: str) -> str:
    """Return the whole path of the leaf that a path means.

    Of a path, names in between may be left out as long as one leaf alone fits, and `controller.`
    may stand before it: `controller.temperature` means `weighting.temperature`.

    Raises:
        ValueError: no leaf, or several; the nearest ones are named.
    """
    return _match(path, tuple(_places(controller)))


def set_parameters[C](controller: C, values: Mapping[str, ArrayLike | Sequence[float]]) -> C:
    """Return a controller with other numbers; nothing is compiled anew for it.

    Args:
        controller: the pytree.
        values: by path, see `find_parameter`: one number for all elements, or an array of the
            leaf's shape.

    Raises:
        ValueError: a path that is none, a value of another shape, or that is not finite.
    """
    places = _places(controller)
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

        def there(tree: Any, steps: tuple[str | int, ...] = place.steps) -> Any:
            for step in steps:
                is_field = isinstance(step, str) and step.startswith(".")
                tree = getattr(tree, str(step)[1:]) if is_field else tree[step]
            return tree

        controller = eqx.tree_at(there, controller, new)
    return controller


def nearest(name: str, known: Mapping[str, Any] | tuple[str, ...], number: int = 3) -> str:
    """Return the names most like one, separated by commas, for a message."""
    last = name.rpartition(".")[2]
    exact = [each for each in known if each.rpartition(".")[2] == last]
    close = difflib.get_close_matches(name, list(known), n=number, cutoff=0.0)
    return ", ".join(list(dict.fromkeys([*exact, *close]))[:number])


def _match(path: str, known: tuple[str, ...]) -> str:
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
    """Say whether the wanted names are among the parts in this order, the last one last."""
    if wanted[-1] != parts[-1]:
        return False
    rest = iter(parts)
    return all(name in rest for name in wanted)


def _places(tree: Any) -> dict[str, _Place]:
    found: dict[str, _Place] = {}
    for names, steps, value in _walk(tree, (), ()):
        found.setdefault(".".join(names), _Place(steps, value))
    return found


type _Found = tuple[tuple[str, ...], tuple[str | int, ...], Array]


def _walk(tree: Any, names: tuple[str, ...], steps: tuple[str | int, ...]) -> Iterator[_Found]:
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
        keys = getattr(tree, "_fields", range(len(tree)))
        for index, (key, inner) in enumerate(zip(keys, tree, strict=True)):
            yield from _walk(inner, (*names, str(key)), (*steps, index))


def _walk_cost(
    cost: Cost, names: tuple[str, ...], steps: tuple[str | int, ...]
) -> Iterator[_Found]:
    name, weights, inner, where = _unwrapped(cost, steps)
    yield from _weights(weights, names)
    if not isinstance(inner, SumCost):
        yield from _walk_fields(inner, names, where)
        return
    seen: dict[str, int] = {}
    for each, at in _summands(inner, where):
        name, weights, term, there = _unwrapped(each, at)
        seen[name] = seen.get(name, 0) + 1
        here = (*names, f"{name}-{seen[name]}" if seen[name] > 1 else name)
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
    """Yield what a sum of sums adds up, and where it is."""
    if isinstance(cost, SumCost):
        for index, inner in enumerate(cost.costs):
            yield from _summands(inner, (*steps, ".costs", index))
    else:
        yield cost, steps


type _Weights = tuple[tuple[tuple[str | int, ...], Array], ...]


def _unwrapped(
    cost: Cost, steps: tuple[str | int, ...]
) -> tuple[str, _Weights, Cost, tuple[str | int, ...]]:
    """Return the name of a cost, its weights from the outside in, what they weigh, and where."""
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
    """Yield weights; of several, one in the other, the innermost is `weight`."""
    for index, (at, weight) in enumerate(weights):
        outwards = len(weights) - index
        yield (*names, "weight" if outwards == 1 else f"weight-{outwards}"), at, weight
