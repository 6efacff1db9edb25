"""Relax a cost-to-go tile by tile: in the order of its values, and within the CPU's cache."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore._types import Scalar

TILE = 24
"""Nodes on a side of the tiles that are relaxed at a time: a tile fits the CPU's cache."""
SWEEPS = 4
"""Sweeps between two checks for convergence; a check costs as much as a sweep."""

Relax = Callable[..., Array]
"""Function of a cost-to-go (..., h, w) and of parts (..., h, w), which include a margin, and of
numbers. It returns the cost-to-go within the margin after one sweep."""


def relaxed(
    start: Float[Array, "*C H W"],
    parts: Sequence[tuple[Array, float | bool]],
    relax: Relax,
    margin: int,
    numbers: Sequence[Scalar] = (),
) -> Array:
    """Lower a cost-to-go by sweeps until none changes it.

    On accelerators all nodes are relaxed at once; the number of sweeps is the number of steps of
    the longest shortest path. On a CPU tiles are relaxed one after another, the tile with the
    smallest new value at its edge first, so most tiles are visited only a few times. Both give the
    same bits, because the sum along a path does not depend on when it is computed.

    Args:
        start: cost-to-go (..., H, W) at the sources; infinite elsewhere.
        parts: arrays (..., H, W) that a sweep reads, such as costs, each with its value off the
            map.
        relax: one sweep.
        margin: number of rows and columns around a node whose values the sweep reads, at most
            `TILE`; static.
        numbers: further arguments of a sweep.
    """
    outside = [jnp.inf, *(value for _, value in parts)]
    arrays = (start, *(array for array, _ in parts), *numbers)

    def by_tiles(*given: Array) -> Array:
        return relaxed_by_tiles(given, outside, relax, margin)

    def everywhere(*given: Array) -> Array:
        return relaxed_everywhere(given, outside, relax, margin)

    # Under `vmap` the maps are processed one after another: each has its own order of tiles.
    one_by_one = jax.custom_batching.sequential_vmap(by_tiles)  # type: ignore[no-untyped-call]
    value: Array = jax.lax.platform_dependent(*arrays, cpu=one_by_one, default=everywhere)
    return value


def relaxed_everywhere(
    given: Sequence[Array], outside: Sequence[float | bool], relax: Relax, margin: int
) -> Array:
    """Relax all nodes at once until none changes.

    Args:
        given: cost-to-go, parts and numbers of `relaxed`.
        outside: values of the cost-to-go and of the parts off the map.
        relax: one sweep.
        margin: as of `relaxed`; static.
    """
    arrays, numbers = given[: len(outside)], given[len(outside) :]
    first, *others = (
        jnp.pad(each, _around(each, margin), constant_values=value)
        for each, value in zip(arrays, outside, strict=True)
    )
    return _within(_settled(first, [*others, *numbers], relax, margin), margin)


def relaxed_by_tiles(
    given: Sequence[Array], outside: Sequence[float | bool], relax: Relax, margin: int
) -> Array:
    """Relax tile by tile until no tile has a neighbour that changed since its last visit.

    Args:
        given: cost-to-go, parts and numbers of `relaxed`.
        outside: values of the cost-to-go and of the parts off the map.
        relax: one sweep.
        margin: as of `relaxed`; static.
    """
    arrays, numbers = given[: len(outside)], given[len(outside) :]
    height, width = given[0].shape[-2:]
    rows, columns = -(-height // TILE), -(-width // TILE)
    # The margin gives every tile neighbours on all sides. The last tiles are completed.
    more = (rows * TILE - height, columns * TILE - width)
    value, *parts = (
        jnp.pad(each, _around(each, margin, more), constant_values=fill)
        for each, fill in zip(arrays, outside, strict=True)
    )
    tiles = _within(value, margin).reshape(-1, rows, TILE, columns, TILE)
    # Priority of each tile: the smallest changed value next to it, initially the smallest value in
    # it; infinite if nothing changed.
    due = jnp.pad(tiles.min(axis=(0, 2, 4)), 1, constant_values=jnp.inf)
    is_tile = jnp.pad(jnp.ones((rows, columns), bool), 1)
    side = TILE + 2 * margin

    def window(array: Array, corner: tuple[Array, Array]) -> Array:
        leading = array.shape[:-2]
        first: tuple[Array | int, ...] = (*(0 for _ in leading), *corner)
        return jax.lax.dynamic_slice(array, first, (*leading, side, side))

    def visit(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        value, due = carry
        first = jnp.argmin(due[1:-1, 1:-1])
        row, column = first // columns, first % columns
        corner = (row * TILE, column * TILE)
        before, *own = (window(each, corner) for each in (value, *parts))
        after = _within(_settled(before, [*own, *numbers], relax, margin), margin)
        # Values that fell near the edge of the tile become due in the neighbours on that side.
        fallen = jnp.where(after < _within(before, margin), after, jnp.inf)
        fallen = fallen.reshape(-1, TILE, TILE).min(axis=0)
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


def _settled(start: Array, parts: Sequence[Array], relax: Relax, margin: int) -> Array:
    """Relax all nodes within the margin until none changes."""
    place = (*(0 for _ in start.shape[:-2]), margin, margin)

    def sweep(_: Array, value: Array) -> Array:
        nearest = jnp.minimum(_within(value, margin), relax(value, *parts))
        return jax.lax.dynamic_update_slice(value, nearest, place)

    def sweeps(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        before, _ = carry
        after = jax.lax.fori_loop(0, SWEEPS, sweep, before)
        return after, jnp.any(after < before)

    value, _ = jax.lax.while_loop(lambda carry: carry[1], sweeps, (start, jnp.array(True)))
    return value


def _around(array: Array, margin: int, more: tuple[int, int] = (0, 0)) -> list[tuple[int, int]]:
    """Return the padding of the last two axes by a margin, and by more at their ends."""
    return [*((0, 0) for _ in array.shape[:-2]), *((margin, margin + each) for each in more)]


def _within(array: Array, margin: int) -> Array:
    return array[..., margin:-margin, margin:-margin]
