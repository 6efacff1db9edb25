"""Relax a cost-to-go tile by tile: in the order of its values, and within the CPU's cache."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore._types import Scalar

Relax = Callable[..., Array]
"""Function of a cost-to-go (..., h, w) with its margin, of parts (..., h, w) with theirs, and of
numbers. It returns the cost-to-go within the margin after one sweep."""


class Part(NamedTuple):
    """Values that a sweep reads, such as costs.

    Args:
        values: array (..., H, W).
        outside: its value off the map.
        margin: number of rows and columns around a node whose values the sweep reads; static.
    """

    values: Array
    outside: float | bool
    margin: int


class Tiling(NamedTuple):
    """How the CPU relaxes.

    Args:
        side: nodes on a side of the tiles that are relaxed at a time. A tile with all that a sweep
            reads fits the CPU's cache, and is too small to be split between threads.
        sweeps: sweeps between two checks for convergence. A check of a single layer of nodes costs
            as much as a sweep.
    """

    side: int = 24
    sweeps: int = 4


class Outline(NamedTuple):
    """What is static of a cost-to-go and its parts: values off the map, and margins that a sweep
    reads."""

    outside: tuple[float | bool, ...]
    margins: tuple[int, ...]


def relax_costs(
    start: Float[Array, "*C H W"],
    parts: Sequence[Part],
    relax: Relax,
    margin: int,
    numbers: Sequence[Scalar] = (),
    tiling: Tiling = Tiling(),  # noqa: B008
) -> Array:
    """Lower a cost-to-go by sweeps until none changes it.

    On accelerators all nodes are relaxed at once; the number of sweeps is the number of steps of
    the longest shortest path. On a CPU tiles are relaxed one after another, the tile with the
    smallest new value at its edge first, so most tiles are visited only a few times. Both give the
    same bits, because the sum along a path does not depend on when it is computed.

    `start` is infinite outside the sources. A sweep, `relax`, reads `parts`, `numbers` and the
    cost-to-go up to `margin` rows and columns around a node, at most the side of a tile; static.
    """
    outline = Outline(
        (jnp.inf, *(each.outside for each in parts)), (margin, *(each.margin for each in parts))
    )
    arrays = (start, *(each.values for each in parts), *numbers)

    def by_tiles(*given: Array) -> Array:
        return relax_by_tiles(given, outline, relax, tiling)

    def everywhere(*given: Array) -> Array:
        return relax_everywhere(given, outline, relax, tiling)

    # Under `vmap` the maps are processed one after another: each has its own order of tiles.
    one_by_one = jax.custom_batching.sequential_vmap(by_tiles)  # type: ignore[no-untyped-call]
    value: Array = jax.lax.platform_dependent(*arrays, cpu=one_by_one, default=everywhere)
    return value


def relax_everywhere(
    given: Sequence[Array], outline: Outline, relax: Relax, tiling: Tiling
) -> Array:
    """Relax all nodes at once until none changes; see `relax_costs`."""
    number = len(outline.outside)
    first, *others = (
        jnp.pad(each, _around(each, margin), constant_values=outside)
        for each, outside, margin in zip(given[:number], *outline, strict=True)
    )
    margin = outline.margins[0]
    settled = _relax_all(first, [*others, *given[number:]], relax, margin, tiling.sweeps)
    return _crop(settled, margin)


def relax_by_tiles(given: Sequence[Array], outline: Outline, relax: Relax, tiling: Tiling) -> Array:
    """Relax tile by tile until no tile has a neighbour that changed since its last visit."""
    number, side, margin = len(outline.outside), tiling.side, outline.margins[0]
    height, width = given[0].shape[-2:]
    rows, columns = -(-height // side), -(-width // side)
    # The margin gives every tile neighbours on all sides. The last tiles are completed.
    more = (rows * side - height, columns * side - width)
    value, *parts = (
        jnp.pad(each, _around(each, beside, more), constant_values=outside)
        for each, outside, beside in zip(given[:number], *outline, strict=True)
    )
    # Priority of each tile: the smallest changed value in it or next to it; infinite if nothing
    # changed. A source at the edge of its tile may have all its neighbours in other tiles.
    length = side + 2 * margin
    least = value.reshape(-1, *value.shape[-2:]).min(axis=0)
    first = jax.lax.reduce_window(
        least, jnp.inf, jax.lax.min, (length, length), (side, side), "VALID"
    )
    due = jnp.pad(first, 1, constant_values=jnp.inf)
    is_tile = jnp.pad(jnp.ones((rows, columns), bool), 1)

    def window(array: Array, corner: tuple[Array, Array], beside: int) -> Array:
        leading, length = array.shape[:-2], side + 2 * beside
        first: tuple[Array | int, ...] = (*(0 for _ in leading), *corner)
        return jax.lax.dynamic_slice(array, first, (*leading, length, length))

    def visit(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        value, due = carry
        first = jnp.argmin(due[1:-1, 1:-1])
        row, column = first // columns, first % columns
        corner = (row * side, column * side)
        # Behind the barrier XLA does not read `before` from `value` once more after its update,
        # for which it would copy the whole map in each visit.
        before, *own = _barrier(
            *(
                window(each, corner, beside)
                for each, beside in zip((value, *parts), outline.margins, strict=True)
            )
        )
        settled = _relax_all(before, [*own, *given[number:]], relax, margin, tiling.sweeps)
        after = _crop(settled, margin)
        # Values that fell near the edge of the tile become due in the neighbours on that side.
        fallen = jnp.where(after < _crop(before, margin), after, jnp.inf)
        fallen = fallen.reshape(-1, side, side).min(axis=0)
        above, below = fallen[:margin], fallen[-margin:]
        left, right = fallen[:, :margin].min(), fallen[:, -margin:].min()
        around = [
            [above[:, :margin].min(), above.min(), above[:, -margin:].min()],
            [left, jnp.inf, right],
            [below[:, :margin].min(), below.min(), below[:, -margin:].min()],
        ]
        # The tile is settled. Only a value that falls in a neighbour makes it due again.
        due = due.at[row + 1, column + 1].set(jnp.inf)
        others = jnp.minimum(jax.lax.dynamic_slice(due, (row, column), (3, 3)), jnp.asarray(around))
        due = jax.lax.dynamic_update_slice(due, others, (row, column))
        place: tuple[Array | int, ...] = (
            *(0 for _ in after.shape[:-2]),
            corner[0] + margin,
            corner[1] + margin,
        )
        value = jax.lax.dynamic_update_slice(value, after, place)
        # The margin holds no tiles: a value that falls at the map's edge makes nothing due.
        return value, jnp.where(is_tile, due, jnp.inf)

    value, _ = jax.lax.while_loop(lambda carry: jnp.isfinite(carry[1]).any(), visit, (value, due))
    return value[..., margin : margin + height, margin : margin + width]


def _relax_all(
    start: Array, parts: Sequence[Array], relax: Relax, margin: int, num_sweeps: int
) -> Array:
    """Relax all nodes within the margin until none changes."""
    place = (*(0 for _ in start.shape[:-2]), margin, margin)

    def sweep(value: Array) -> tuple[Array, Array]:
        own = _crop(value, margin)
        nearest = jnp.minimum(own, relax(value, *parts))
        # Behind the barrier nothing reads the old values, so they are replaced in place.
        nearest, is_lower = _barrier(nearest, jnp.any(nearest < own))
        return jax.lax.dynamic_update_slice(value, nearest, place), is_lower

    def sweeps(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        value = jax.lax.fori_loop(1, num_sweeps, lambda _, each: sweep(each)[0], carry[0])
        return sweep(value)

    value, _ = jax.lax.while_loop(lambda carry: carry[1], sweeps, (start, jnp.array(True)))
    return value


def _barrier(*arrays: Array) -> Sequence[Array]:
    """Return arrays that XLA computes before anything that reads them, and only once."""
    same: Sequence[Array] = jax.lax.optimization_barrier(arrays)  # type: ignore[no-untyped-call]
    return same


def _around(array: Array, margin: int, more: tuple[int, int] = (0, 0)) -> list[tuple[int, int]]:
    """Return the padding of the last two axes by a margin, and by more at their ends."""
    return [*((0, 0) for _ in array.shape[:-2]), *((margin, margin + each) for each in more)]


def _crop(array: Array, margin: int) -> Array:
    return array[..., margin:-margin, margin:-margin]
