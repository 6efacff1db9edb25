"""Leave out stored scans when there is no more room for new ones."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from jaxplore._types import Pose
from jaxplore.geometry.motion import between, compose, propagate_covariance
from jaxplore.localisation.localiser import LocaliserState
from jaxplore.localisation.stored_scans import StoredScans

SPARE = 64
"""Number of scans for which there must be room; otherwise every second one is left out."""


def is_nearly_full(state: LocaliserState) -> bool:
    """Check whether stored scans should be thinned out before more are stored."""
    return int(state.scans.number) > state.scans.capacity - SPARE


def halve(rows: Array) -> Array:
    """Return every second row, with zeros behind them."""
    kept = rows[::2]
    return jnp.zeros_like(rows).at[: len(kept)].set(kept)


@eqx.filter_jit
def thin_scans(state: LocaliserState) -> LocaliserState:
    """Return the state with every second stored scan left out.

    Motions between neighbours are composed, with their covariances. A closed loop of a scan that is
    left out becomes one of the scan before it.
    """
    scans, closures = state.scans, state.closures
    first, second = scans.motions[1::2], jnp.roll(scans.motions, -1, axis=0)[1::2]
    added = jnp.roll(scans.covariances, -1, axis=0)[1::2]
    # Scan 2 k + 2 follows scan 2 k by the motions 2 k + 1 and 2 k + 2.
    motions = jax.vmap(compose)(first, second)
    covariances = jax.vmap(propagate_covariance)(first, second, scans.covariances[1::2], added)
    capacity = scans.capacity

    def shift_rows(rows: Array, former: Array) -> Array:
        after = rows[: (capacity + 1) // 2 - 1]
        return jnp.zeros_like(former).at[1 : 1 + len(after)].set(after)

    def anchor(pair: Array, motion: Pose) -> Pose:
        older, newer = scans.poses[pair], scans.poses[2 * (pair // 2)]
        before = between(newer[0], older[0])
        return compose(compose(before, motion), between(older[1], newer[1]))

    return state._replace(
        scans=StoredScans(
            halve(scans.poses),
            shift_rows(motions, scans.motions),
            shift_rows(covariances, scans.covariances),
            halve(scans.way),
            halve(scans.ranges),
            halve(scans.is_return),
            (scans.number + 1) // 2,
        ),
        closures=closures._replace(
            pairs=closures.pairs // 2,
            motions=jax.vmap(anchor)(closures.pairs, closures.motions),
            examined=(closures.examined + 1) // 2,
        ),
    )
