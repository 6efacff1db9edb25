"""What has been seen of a place, and when: for search, and for patrol."""

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.special import entr
from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import GridMask, GridValues, Scalar

NEVER = float("inf")
"""Idleness of a cell that was never seen [s]."""


class IdlenessMap(eqx.Module):
    """Keeps how long ago each cell was seen, and what it is worth to look again.

    Seen right now, a cell is known to be empty of what is looked for. After a time t unseen it has
    come back with probability q, and a look removes the entropy h of that,

        q(t) = (1 - exp(-t / memory)) / 2,    interest = weight * h(q)

    where `memory` is the time constant of forgetting. With an infinite memory, a search, a cell is
    worth `weight * ln 2` until it is seen, and nothing afterwards; with a finite one, a patrol, it
    becomes worth a look again. t is the *idleness* of the patrolling literature.

    Source: idleness: Machado, Ramalho, Zucker, Drogoul, "Multi-agent patrolling: an empirical
    analysis of alternative architectures", MABS 2002.

    Args:
        memory: [s]; never forgotten when absent.
        weight: worth of one such bit, relative to a bit of the occupancy map.

    Raises:
        ValueError: a memory that is not positive, a negative weight.
    """

    memory: Scalar | None
    weight: Scalar

    def __init__(self, memory: ArrayLike | None = None, weight: ArrayLike = 1.0) -> None:
        self.memory = None if memory is None else _checks.scalar("memory", memory, above=0.0)
        self.weight = _checks.scalar("weight", weight, at_least=0.0)

    def init(self, shape: tuple[int, int]) -> GridValues:
        """Return the idleness (H, W) of cells that were never seen [s]."""
        return jnp.full(shape, NEVER)

    def seen(self, idleness: GridValues, is_seen: GridMask, elapsed: Scalar) -> GridValues:
        """Return the idleness (H, W) after a look [s].

        Args:
            idleness: (H, W) before [s].
            is_seen: (H, W) which cells were seen.
            elapsed: time since the last look [s].
        """
        return jnp.where(is_seen, 0.0, idleness + elapsed)

    def interest(self, idleness: GridValues) -> GridValues:
        """Return what a look at each cell (H, W) is worth [nat]."""
        if self.memory is None:
            chance = jnp.where(jnp.isinf(idleness), 0.5, 0.0)
        else:
            chance = -0.5 * jnp.expm1(-idleness / self.memory)
        return self.weight * (entr(chance) + entr(1.0 - chance))
