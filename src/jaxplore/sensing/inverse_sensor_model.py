"""The inverse sensor model: what one measurement of a cell does to its probability."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Bool, Float

from jaxplore import _checks
from jaxplore._types import Scalar
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD

ODDS_OCCUPIED, ODDS_FREE = math.exp(0.85), math.exp(-0.4)
"""Factors on a cell's odds that are customary with FSMI."""
UNCLAMPED = 100.0
"""Log-odds that no probability in single precision reaches: a clamp there is none."""


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
        is_decisive: whether one look settles a cell: then walls are not changed by beams that pass
            through them, and a cell at the clamp is certain to the information engine; static.

    Raises:
        ValueError: a value with the wrong sign or not finite.
    """

    occupied: Scalar
    free: Scalar
    minimum: Scalar
    maximum: Scalar
    is_decisive: bool = eqx.field(static=True)

    def __init__(
        self,
        occupied: ArrayLike = 2.0,
        free: ArrayLike = -2.0,
        minimum: ArrayLike = -7.0,
        maximum: ArrayLike = 5.0,
        *,
        is_decisive: bool = False,
    ) -> None:
        self.is_decisive = is_decisive
        self.occupied = _checks.scalar("occupied", occupied, above=0.0)
        self.free = _checks.scalar("free", free, below=0.0)
        self.minimum = _checks.scalar("minimum", minimum, below=0.0)
        self.maximum = _checks.scalar("maximum", maximum, above=0.0)

    @classmethod
    def from_odds(
        cls,
        occupied: ArrayLike = ODDS_OCCUPIED,
        free: ArrayLike = ODDS_FREE,
        clamp: tuple[ArrayLike, ArrayLike] | None = None,
    ) -> "InverseSensorModel":
        """Return a model from the factors by which a measurement multiplies a cell's odds.

        The defaults are those of the FSMI literature, log-odds of 0.85 and -0.4, without a clamp.

        Args:
            occupied: factor when the cell is measured occupied, > 1.
            free: factor when a beam passes through the cell, in (0, 1).
            clamp: least and greatest log-odds; None for no clamp.

        Raises:
            ValueError: odds on the wrong side of 1, a clamp that does not enclose 0.
        """
        occupied = _checks.scalar("occupied", occupied, above=1.0)
        free = _checks.scalar("free", free, above=0.0, below=1.0)
        minimum, maximum = (-UNCLAMPED, UNCLAMPED) if clamp is None else clamp
        return cls(jnp.log(occupied), jnp.log(free), minimum, maximum)

    @classmethod
    def line_of_sight(
        cls, free: ArrayLike = 0.01, occupied: ArrayLike = 0.99
    ) -> "InverseSensorModel":
        """Return a model for which one look settles a cell: seen free it gets one probability, hit
        the other, and walls stay.

        The update of the quadrotor design notes, as log-odds: the steps are as long as the clamp is
        wide. A settled cell is certain to the information engine: taken at its word, p = 0.01 makes
        one cell in a hundred of a known hall a surprise, and a long view of it worth more than an
        unknown corner.

        Args:
            free: probability of a cell that a beam has passed, in (0, 0.5).
            occupied: probability of a cell that was hit, in (0.5, 1).

        Raises:
            ValueError: a probability outside its range.
        """
        low = jax.scipy.special.logit(_checks.scalar("free", free, above=0.0, below=0.5))
        high = jax.scipy.special.logit(_checks.scalar("occupied", occupied, above=0.5, below=1.0))
        return cls(high - low, low - high, low, high, is_decisive=True)

    def log_odds(self, probability: Float[Array, "*N"]) -> Float[Array, "*N"]:
        """Return `ln(p / (1 - p))` within the clamp, also for p = 0 and p = 1."""
        # Guarded where the slope is infinite, which the clip's zero would make NaN.
        is_certain = (probability <= 0.0) | (probability >= 1.0)
        inner = jax.scipy.special.logit(jnp.where(is_certain, 0.5, probability))
        certain = jnp.where(probability <= 0.0, self.minimum, self.maximum)
        return jnp.where(is_certain, certain, jnp.clip(inner, self.minimum, self.maximum))

    def update(
        self, probability: Float[Array, "*N"], log_odds_change: Float[Array, "..."]
    ) -> Float[Array, "*N"]:
        """Return the probability after a change of the log-odds; cells with no change keep it."""
        log_odds = self.log_odds(probability) + log_odds_change
        updated = jax.nn.sigmoid(jnp.clip(log_odds, self.minimum, self.maximum))
        is_kept = (log_odds_change == 0.0) | self.stays(probability, log_odds_change)
        return jnp.where(is_kept, probability, updated)

    def settled(self, probability: Float[Array, "*N"]) -> Float[Array, "*N"]:
        """Return the probabilities as the information engine takes them: 0 and 1 at the clamp of a
        model that is decisive, as they are otherwise."""
        is_settled, is_wall = self.is_settled(probability), probability > 0.5
        return jnp.where(is_settled, jnp.where(is_wall, 1.0, 0.0), probability)

    def is_settled(self, probability: Float[Array, "*N"]) -> Bool[Array, "*N"]:
        """Say which cells are at the clamp of a model that is decisive."""
        if not self.is_decisive:
            return jnp.zeros_like(probability, bool)
        log_odds = self.log_odds(probability)
        return (log_odds < self.minimum + 1e-3) | (log_odds > self.maximum - 1e-3)

    def stays(
        self, probability: Float[Array, "*N"], log_odds_change: Float[Array, "..."]
    ) -> Bool[Array, "*N"]:
        """Say which cells are walls that a change towards free does not change."""
        if not self.is_decisive:
            return jnp.zeros_like(probability, bool)
        return (log_odds_change < 0.0) & (probability > OCCUPIED_THRESHOLD)
