"""The inverse sensor model: what one measurement of a cell does to its probability."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Float

from jaxplore import _checks
from jaxplore._types import Scalar


class InverseSensorModel(eqx.Module):
    """Log-odds update with clamping (Moravec and Elfes 1985; clamping as in Hornung et al.,
    "OctoMap", Autonomous Robots 2013, eq. 4):

        l <- clip(l + occupied, minimum, maximum)     the cell was measured occupied
        l <- clip(l + free, minimum, maximum)         the beam passed through the cell

    The information engine scores with this very update, so that what it promises is what the map
    will gain.

    The defaults suit a lidar: one look makes a cell known, and the clamp at p = 0.001 keeps known
    corridors from leaking information into every long beam (at p = 0.1 a beam "sees" 10 cells).

    Args:
        occupied: added when a cell is measured occupied, > 0.
        free: added when a beam passes through a cell, < 0.
        minimum: least log-odds a cell can have, < 0.
        maximum: greatest log-odds a cell can have, > 0.

    Raises:
        ValueError: a value with the wrong sign or not finite.
    """

    occupied: Scalar
    free: Scalar
    minimum: Scalar
    maximum: Scalar

    def __init__(
        self,
        occupied: ArrayLike = 2.0,
        free: ArrayLike = -2.0,
        minimum: ArrayLike = -7.0,
        maximum: ArrayLike = 5.0,
    ) -> None:
        self.occupied = _checks.scalar("occupied", occupied, above=0.0)
        self.free = _checks.scalar("free", free, below=0.0)
        self.minimum = _checks.scalar("minimum", minimum, below=0.0)
        self.maximum = _checks.scalar("maximum", maximum, above=0.0)

    def log_odds(self, probability: Float[Array, "*N"]) -> Float[Array, "*N"]:
        """Return `ln(p / (1 - p))` within the clamp, also for p = 0 and p = 1."""
        return jnp.clip(jax.scipy.special.logit(probability), self.minimum, self.maximum)

    def update(
        self, probability: Float[Array, "*N"], log_odds_change: Float[Array, "..."]
    ) -> Float[Array, "*N"]:
        """Return the probability after a change of the log-odds; cells with no change keep it."""
        log_odds = self.log_odds(probability) + log_odds_change
        updated = jax.nn.sigmoid(jnp.clip(log_odds, self.minimum, self.maximum))
        return jnp.where(log_odds_change == 0.0, probability, updated)
