"""Optimal assignment of rows to columns, for tables of fixed size."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from jaxplore._types import Count, Scalar

UNASSIGNED = -1
"""Column of a row without one."""
FORBIDDEN = 1e4
"""Cost of a pair that may not be, far above all others."""


def assign(cost: Float[Array, "N M"], is_allowed: Bool[Array, "N M"]) -> Int[Array, " N"]:
    """Assign as many rows as possible to columns of their own, at the least sum of costs.

    Return the column of each row, or `UNASSIGNED`. Pairs that are not allowed get a cost of
    `FORBIDDEN` and are taken back in the end. So more pairs are always better than a lower sum, if
    all costs are well below `FORBIDDEN`.

    Source: the shortest augmenting paths of Jonker and Volgenant, "A shortest augmenting path
    algorithm for dense and sparse linear assignment problems", Computing 38, 1987; O(n^3).
    """
    rows, columns = cost.shape
    size = max(rows, columns)
    table = jnp.full((size, size), FORBIDDEN)
    table = table.at[:rows, :columns].set(jnp.where(is_allowed, cost, FORBIDDEN))
    # Column `size` is virtual: each path begins there.
    padded = jnp.concatenate([table, jnp.zeros((size, 1))], axis=1)
    start = (
        jnp.zeros(size),
        jnp.zeros(size + 1),
        jnp.full(size + 1, UNASSIGNED, jnp.int32),
    )

    def add(row: Count, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        of_rows, of_columns, owner = carry
        owner = owner.at[size].set(row)
        path = (
            jnp.asarray(size, jnp.int32),
            jnp.full(size + 1, jnp.inf),
            jnp.zeros(size + 1, bool),
            jnp.full(size + 1, size, jnp.int32),
            of_rows,
            of_columns,
        )

        def is_open(path: tuple[Count, Array, Array, Array, Array, Array]) -> Array:
            return owner[path[0]] != UNASSIGNED

        def extend(
            path: tuple[Count, Array, Array, Array, Array, Array],
        ) -> tuple[Count, Array, Array, Array, Array, Array]:
            column, least, is_used, before, of_rows, of_columns = path
            is_used = is_used.at[column].set(True)
            own = owner[column]
            reduced = padded[own] - of_rows[own] - of_columns
            is_better = ~is_used & (reduced < least)
            least = jnp.where(is_better, reduced, least)
            before = jnp.where(is_better, column, before)
            free = jnp.where(is_used, jnp.inf, least).at[size].set(jnp.inf)
            following = jnp.argmin(free).astype(jnp.int32)
            step: Scalar = free[following]
            # Rows of used columns are all different, so nothing is added twice.
            raised = jnp.where(is_used, step, 0.0)
            of_rows = of_rows.at[jnp.where(is_used, owner, size)].add(raised, mode="drop")
            of_columns = of_columns - raised
            least = jnp.where(is_used, least, least - step)
            return following, least, is_used, before, of_rows, of_columns

        column, _, _, before, of_rows, of_columns = jax.lax.while_loop(is_open, extend, path)

        def turn(carry: tuple[Count, Array]) -> tuple[Count, Array]:
            at, owner = carry
            return before[at], owner.at[at].set(owner[before[at]])

        _, owner = jax.lax.while_loop(lambda carry: carry[0] != size, turn, (column, owner))
        return of_rows, of_columns, owner

    _, _, owner = jax.lax.fori_loop(0, size, add, start)
    found = jnp.zeros(size, jnp.int32).at[owner[:size]].set(jnp.arange(size, dtype=jnp.int32))
    column = found[:rows]
    in_table = jnp.clip(column, 0, columns - 1)
    may_be = (column < columns) & is_allowed[jnp.arange(rows), in_table]
    return jnp.where(may_be, column, UNASSIGNED)
