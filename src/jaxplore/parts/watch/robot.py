"""Track how long ago each cell was observed, for search and patrol."""

from typing import ClassVar

import jax.numpy as jnp
from jax.scipy.special import entr
from jaxtyping import Array, Bool, Float

from jaxplore import _checks
from jaxplore._types import ArrayLike, GridMask, GridValues, Scalar
from jaxplore.belief.part import Observation, Part
from jaxplore.maps.occupancy_grid import OccupancyGrid

NEVER = float("inf")
"""Idleness of a cell that was never observed [s]."""
MOST_DOUBLINGS = 5.0
"""Number of doublings after which the interest of a cell stays the same."""


class IdlenessMap(Part):
    """Idleness of each cell, the time since it was observed, and the information of observing it.

    Right after an observation, a cell is known to hold no target. After a time t without an
    observation it holds one with probability q. Observing the cell removes the entropy h of q:

        q(t) = (1 - exp(-t / memory)) / 2,    interest = weight * h(q)

    `memory` is the time constant of forgetting. With an infinite memory (search), the interest of a
    cell is `weight * ln 2` until it is observed, and 0 afterwards. With a finite memory (patrol),
    it grows again. t is the *idleness* of the patrolling literature.

    With a finite memory the interest of a cell does not grow beyond `weight * ln 2`, and a small
    corner far away stays less attractive than the large yard nearby. With `doubling`, the interest
    is multiplied by

        min(2^(t / doubling), 32)

    so that what was not seen for long becomes worth the way. A cell that was never seen then begins
    with an idleness of `memory`.

    Source: Machado, Ramalho, Zucker, Drogoul, "Multi-agent patrolling: an empirical analysis of
    alternative architectures", MABS 2002.

    Args:
        memory: time constant of forgetting [s]; by default observations are never forgotten.
        weight: weight of this information, relative to information on the occupancy.
        doubling: time in which the interest of an unobserved cell doubles [s]; it does not grow
            beyond `weight * ln 2` when absent.

    Raises:
        ValueError: a time that is not positive, a negative weight, a time of doubling without a
            memory.
    """

    name: ClassVar[str] = "watch"
    is_patrol: ClassVar[bool] = True

    memory: Scalar | None
    weight: Scalar
    doubling: Scalar | None

    def __init__(
        self,
        memory: ArrayLike | None = None,
        weight: ArrayLike = 1.0,
        doubling: ArrayLike | None = None,
    ) -> None:
        self.memory = None if memory is None else _checks.scalar("memory", memory, above=0.0)
        self.weight = _checks.scalar("weight", weight, at_least=0.0)
        self.doubling = None
        if doubling is not None:
            self.doubling = _checks.scalar("doubling", doubling, above=0.0)
            if self.memory is None:
                raise ValueError("memory is None; accepted: a time [s], with a time of doubling")

    def init(self, grid: OccupancyGrid) -> GridValues:
        """Return the idleness (H, W) of the cells of a map that were never observed [s]."""
        if self.doubling is None or self.memory is None:
            return jnp.full(grid.shape, NEVER)
        return jnp.full(grid.shape, self.memory)

    def observe(self, own: GridValues, observation: Observation) -> GridValues:
        """Return the idleness (H, W) after a scan [s]; see `update`."""
        return self.update(own, observation.is_seen, observation.elapsed)

    def merge(
        self, own: GridValues, told: Float[Array, "N H W"], is_heard: Bool[Array, " N"]
    ) -> GridValues:
        """Return the idleness (H, W) [s]: a cell that any of the robots has seen is seen."""
        heard = jnp.where(is_heard[:, None, None], told, NEVER)
        return jnp.minimum(own, heard.min(axis=0))

    def update(self, idleness: GridValues, is_seen: GridMask, elapsed: Scalar) -> GridValues:
        """Return the idleness (H, W) after a scan [s].

        Args:
            idleness: idleness (H, W) before the scan [s].
            is_seen: mask (H, W) of the cells that the scan observed.
            elapsed: time since the last scan [s].
        """
        return jnp.where(is_seen, 0.0, idleness + elapsed)

    def interest(self, own: GridValues) -> GridValues:
        """Return the information (H, W) of observing each cell [nat], from their idleness."""
        idleness = own
        # Without forgetting only cells that were never observed are uncertain. expm1 keeps the
        # digits of short times.
        if self.memory is None:
            chance = jnp.where(jnp.isinf(idleness), 0.5, 0.0)
        else:
            chance = -0.5 * jnp.expm1(-idleness / self.memory)
        interest = self.weight * (entr(chance) + entr(1.0 - chance))
        if self.doubling is None:
            return interest
        return interest * jnp.exp2(jnp.minimum(idleness / self.doubling, MOST_DOUBLINGS))
