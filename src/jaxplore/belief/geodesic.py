"""Costs of shortest paths on a lattice, and the narrow nodes that they need."""

import functools

import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from jaxplore.belief.descent import NEIGHBOURS, corner_of, neighbour
from jaxplore.belief.tiles import Part, relax_costs

DIAGONAL = 2.0**0.5
"""Length of a step to a diagonal neighbour [node spacings]."""


def geodesic(
    initial: Float[Array, "H W"],
    slowness: Float[Array, "H W"],
    is_open: Bool[Array, "H W"],
    corners: Bool[Array, "H W"] | None = None,
) -> Float[Array, "H W"]:
    """Return the cost-to-go `min over s of initial(s) + cost of the shortest path from s`.

    `initial` is infinite where no path ends. Paths connect each open node with its 8 neighbours,
    with the diagonal ones only past a clear corner (`clear_corners`; all are when None). A step of
    length l, in node spacings, costs `l * (slowness(from) + slowness(to)) / 2`, with slowness > 0.
    The values are those of Dijkstra's algorithm, found by relaxing many nodes at once until none
    changes (Bellman-Ford), which on a grid is a minimum of shifted arrays.
    """
    # Split each step's cost in two: leave with the neighbour's half, arrive with the own half.
    half = 0.5 * jnp.where(is_open, slowness, jnp.inf)
    start = jnp.where(is_open, initial, jnp.inf)
    parts = [Part(half, jnp.inf, 1)]
    if corners is not None:
        parts.append(Part(jnp.where(corners, 0.0, jnp.inf), jnp.inf, 1))
    return relax_costs(start, parts, _relax, 1)


def narrow_passages(
    value: Float[Array, "H W"],
    half: Float[Array, "H W"],
    is_narrow: Bool[Array, "H W"],
    corners: Bool[Array, "H W"] | None,
    begins: Bool[Array, "H W"] | None = None,
) -> Bool[Array, "H W"]:
    """Return the narrow nodes through which shortest paths from other nodes lead.

    Paths may also begin at the narrow nodes `begins`. `value` is the cost-to-go of `geodesic`, and
    `half` half the cost of a step of one node spacing. `corners` are those that a diagonal step may
    pass; all when None.
    """
    costs = []
    for step in NEIGHBOURS:
        length = DIAGONAL if all(step) else 1.0
        there = neighbour(value + length * half, step, jnp.inf) + length * half
        if corners is not None and all(step):
            there = jnp.where(neighbour(corners, corner_of(step), False), there, jnp.inf)
        costs.append(there)
    least = functools.reduce(jnp.minimum, costs)
    # A source is where a path ends. The tolerance is for another order of the additions.
    goes_on = jnp.isfinite(value) & (least <= value + 1e-4 * (1.0 + jnp.abs(value)))
    steps = [goes_on & (cost == least) for cost in costs]

    first = jnp.zeros_like(is_narrow)
    if begins is not None:
        first = is_narrow & begins & jnp.isfinite(value)

    def follow(carry: tuple[Array, Array]) -> tuple[Array, Array]:
        is_used, _ = carry
        comes_from = ~is_narrow | is_used
        led_to = [
            neighbour(comes_from & taken, (-step[0], -step[1]), False)
            for step, taken in zip(NEIGHBOURS, steps, strict=True)
        ]
        more = is_narrow & functools.reduce(jnp.logical_or, led_to) | first
        return more, jnp.any(more & ~is_used)

    is_used, _ = jax.lax.while_loop(lambda carry: carry[1], follow, (first, jnp.array(True)))
    return is_used


def _relax(value: Array, half: Array, detour: Array | None = None) -> Array:
    """Return the least cost-to-go by a step to a neighbour. All arrays have a margin of 1.

    `half` is half the cost of a step of one node spacing, and `detour` what a diagonal step past
    each corner costs more; 0 when None.
    """
    height, width = value.shape[0] - 2, value.shape[1] - 2

    def shift(values: Array, down: int, right: int) -> Array:
        return values[1 + down : 1 + down + height, 1 + right : 1 + right + width]

    own = shift(half, 0, 0)
    # Take the minimum over straight and over diagonal neighbours before adding the node's own half,
    # which saves an addition per neighbour.
    leaving, leaving_diagonally = value + half, value + DIAGONAL * half
    along = [shift(leaving, *step) for step in NEIGHBOURS[:4]]
    across = [
        shift(leaving_diagonally, *step)
        + (0.0 if detour is None else shift(detour, *corner_of(step)))
        for step in NEIGHBOURS[4:]
    ]
    return jnp.minimum(
        functools.reduce(jnp.minimum, along) + own,
        functools.reduce(jnp.minimum, across) + DIAGONAL * own,
    )
