"""Statistics of the known map."""

import jax.numpy as jnp

from jaxplore._types import GridMask, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.belief.zones import is_unknown, unknown_fraction
from jaxplore.report.exploration.data import MapProgress


def map_progress(belief: Belief, reachable: GridMask, time: Scalar) -> MapProgress:
    """Compute coverage, entropy, the shares of unknown cells and the idleness.

    Args:
        belief: the robot's belief.
        reachable: (H, W) cells that the robot's centre can reach.
        time: time since the start, an upper bound of the idleness [s].
    """

    def share(total: Scalar) -> Scalar:
        return total / jnp.sum(reachable, dtype=jnp.float32)

    known = jnp.sum(belief.grid.is_free & reachable, dtype=jnp.float32)
    mean, worst = jnp.zeros(()), jnp.zeros(())
    if belief.idleness is not None:
        # The idleness of a cell that was never seen is infinite; here it counts from the start.
        idle = jnp.where(reachable, jnp.minimum(belief.idleness, time), 0.0)
        mean, worst = share(jnp.sum(idle)), jnp.max(idle)
    return MapProgress(
        coverage=share(known),
        entropy=jnp.sum(jnp.where(reachable, belief.grid.entropy, 0.0)),
        unknown=share(jnp.sum(is_unknown(belief.grid) & reachable, dtype=jnp.float32)),
        unknown_map=unknown_fraction(belief.grid),
        mean_idleness=mean,
        worst_idleness=worst,
    )
