"""Costs of shortest paths on a lattice in a volume."""

import itertools
import math

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float


def volume_geodesic(
    source: Float[Array, "D H W"],
    slowness: Float[Array, "D H W"],
    half_open: Bool[Array, "D2 H2 W2"],
) -> Float[Array, "D H W"]:
    """Return the least cost of a path from each node to a source, over 26 neighbours.

        d(n) = min( source(n), min over neighbours m of d(m) + |n - m| (s(n) + s(m)) / 2 )

    Lengths and costs are in node spacings. `source` is infinite where no path may end, and the
    slowness s is > 0. The cost is infinite without a path and at closed nodes.

    A step is possible if both nodes and the point half-way between them are open. `half_open` are
    the open points of the lattice with half the spacing, (2 D - 1, 2 H - 1, 2 W - 1), with the
    nodes at even indices. The values are those of Dijkstra's algorithm. They are found by sweeps
    along the three axes, back and forth, until nothing changes: a straight path takes one sweep,
    however long it is.

    Source: Zhao, "A fast sweeping method for eikonal equations", Mathematics of Computation 2004,
    for the order of the updates.
    """
    is_open = half_open[::2, ::2, ::2]
    start = jnp.where(is_open, source, jnp.inf)

    def sweep_all(state: tuple[Array, Array]) -> tuple[Array, Array]:
        before, _ = state
        values = before
        for axis, is_reversed in itertools.product(range(3), (False, True)):
            values = _sweep(values, slowness, half_open, axis, is_reversed)
        return values, jnp.any(values < before)

    values, _ = jax.lax.while_loop(lambda each: each[1], sweep_all, (start, jnp.asarray(True)))
    return values


def _sweep(values: Array, slowness: Array, half_open: Array, axis: int, is_reversed: bool) -> Array:
    """Update the planes across an axis one after another, each from the one before it."""
    if values.shape[axis] < 2:
        return values
    planes, costs, halves = (jnp.moveaxis(each, axis, 0) for each in (values, slowness, half_open))
    # Of the planes of half the spacing, the odd ones lie between the nodes.
    is_open, between = halves[::2, ::2, ::2], halves[1::2]
    if is_reversed:
        planes, costs, is_open, between = (each[::-1] for each in (planes, costs, is_open, between))

    def step(
        carry: tuple[Array, Array], plane: tuple[Array, Array, Array, Array]
    ) -> tuple[tuple[Array, Array], Array]:
        (previous, its_cost), (own, cost, opens, middle) = carry, plane
        rows, columns = own.shape
        wide = jnp.pad(previous, 1, constant_values=jnp.inf)
        its = jnp.pad(its_cost, 1)
        # Index 2 n + d of the middle plane is n + (d + 1) of its parity classes, d = -1, 0, 1.
        middle = jnp.pad(middle, 1)
        least = own
        for down, right in itertools.product((-1, 0, 1), repeat=2):
            length = math.sqrt(1.0 + down * down + right * right)
            there = wide[1 + down : 1 + down + rows, 1 + right : 1 + right + columns]
            mean = 0.5 * (cost + its[1 + down : 1 + down + rows, 1 + right : 1 + right + columns])
            is_clear = middle[
                1 + down : 1 + down + 2 * rows - 1 : 2, 1 + right : 1 + right + 2 * columns - 1 : 2
            ]
            least = jnp.minimum(least, jnp.where(is_clear, there + length * mean, jnp.inf))
        least = jnp.where(opens, least, jnp.inf)
        return (least, cost), least

    rest = (planes[1:], costs[1:], is_open[1:], between)
    _, updated = jax.lax.scan(step, (planes[0], costs[0]), rest)
    updated = jnp.concatenate([planes[:1], updated])
    return jnp.moveaxis(updated[::-1] if is_reversed else updated, 0, axis)
