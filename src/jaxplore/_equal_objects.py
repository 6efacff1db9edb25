"""Do the same for several things, of which some are equal, by one compiled body for equal ones."""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp


class Alike[T](eqx.Module):
    """N things, of which some are the same object: each object is stored once.

    So N equal robots need no more memory than one, and a compiled program has one part for all of
    them (`each`). `kinds` are the distinct things, and thing i is `kinds[kind_of[i]]`.
    """

    kinds: tuple[T, ...]
    kind_of: tuple[int, ...] = eqx.field(static=True)

    def __init__(self, things: Sequence[T]) -> None:
        found: list[T] = []
        number = []
        for thing in things:
            place = next((i for i, one in enumerate(found) if one is thing), len(found))
            if place == len(found):
                found.append(thing)
            number.append(place)
        self.kinds, self.kind_of = tuple(found), tuple(number)

    @property
    def all(self) -> tuple[T, ...]:
        """The N things."""
        return tuple(self.kinds[kind] for kind in self.kind_of)

    def at(self, places: Sequence[int]) -> "Alike[T]":
        """Return the things at some places."""
        return Alike([self.all[place] for place in places])

    def map(self, function: Callable[[T], T]) -> "Alike[T]":
        """Return as many things, each of which a function makes of one here."""
        kinds = tuple(function(kind) for kind in self.kinds)
        same: Alike[T] = eqx.tree_at(lambda at: at.kinds, self, kinds)
        return same

    def beside[U](self, other: "Alike[U]") -> "Alike[tuple[T, U]]":
        """Return as many pairs, each of a thing here and one of others."""
        places = list(zip(self.kind_of, other.kind_of, strict=True))
        made = {(one, two): (self.kinds[one], other.kinds[two]) for one, two in places}
        return Alike([made[place] for place in places])

    def each(
        self, function: Callable[..., Any], *rows: Sequence[Any], is_large: bool = False
    ) -> list[Any]:
        """Return `function(thing, *row)` for each thing, with one compiled body for equal ones.

        On a CPU the body is a loop over the equal things (`jax.lax.map`), so that its branches stay
        branches. Elsewhere they are computed at once (`jax.vmap`). The rows of equal things are
        copied into one array and from it. On a CPU that costs more than it saves if they have large
        arrays, such as maps (`is_large`): then each thing has a body of its own there.

        `rows` are sequences of N pytrees. Those of equal things have the same structure and shapes.
        """
        results: list[Any] = [None] * len(self.kind_of)
        for kind, thing in enumerate(self.kinds):
            places = [i for i, own in enumerate(self.kind_of) if own == kind]
            mine = [tuple(column[i] for column in rows) for i in places]
            found = _results(function, thing, mine, is_large=is_large)
            for place, result in zip(places, found, strict=True):
                results[place] = result
        return results


def _results(
    function: Callable[..., Any], thing: Any, rows: Sequence[Any], *, is_large: bool
) -> list[Any]:
    """Return the results of a function for one thing and each of some rows."""

    def one(row: Any) -> Any:
        return function(thing, *row)

    if len(rows) == 1:
        # Nothing is stacked for one: it is computed as without others, to the bit.
        return map_unrolled(one, rows)
    # The one place that decides how many equal things are computed at a time.
    found: list[Any] = jax.lax.platform_dependent(
        list(rows),
        cpu=functools.partial(map_unrolled if is_large else map_in_turn, one),
        default=functools.partial(map_at_once, one),
    )
    return found


def map_unrolled(one: Callable[[Any], Any], rows: Sequence[Any]) -> list[Any]:
    """Return a function's results for some rows, by a body for each."""
    return [one(row) for row in rows]


def map_in_turn(one: Callable[[Any], Any], rows: Sequence[Any]) -> list[Any]:
    """Return a function's results for some rows, by a loop."""
    return _rows(jax.lax.map(one, _stack(rows)), len(rows))


def map_at_once(one: Callable[[Any], Any], rows: Sequence[Any]) -> list[Any]:
    """Return a function's results for some rows, all computed together."""
    return _rows(jax.vmap(one)(_stack(rows)), len(rows))


def _stack(rows: Sequence[Any]) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *rows)


def _rows(stacked: Any, number: int) -> list[Any]:
    return [jax.tree.map(lambda leaf, i=i: leaf[i], stacked) for i in range(number)]
