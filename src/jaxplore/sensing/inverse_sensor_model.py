"""Update the occupancy of a cell by a measurement: the inverse sensor model."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Bool, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, Scalar
from jaxplore._xla import compute
from jaxplore.maps.occupancy_grid import OCCUPIED_THRESHOLD

ODDS_OCCUPIED, ODDS_FREE = math.exp(0.85), math.exp(-0.4)
"""Factors on the odds of a cell that the FSMI literature uses."""
UNCLAMPED = 100.0
"""Log-odds beyond those of every probability in single precision: a clamp there has no effect."""


class InverseSensorModel(eqx.Module):
    """Log-odds update with clamping:

        l <- clip(l + occupied, minimum, maximum)     if the cell was measured occupied
        l <- clip(l + free, minimum, maximum)         if a beam passed through the cell

    Expected information is computed with the same update, so that it predicts the information that
    the map really gains.

    The defaults suit a lidar. One measurement makes a cell free or occupied. The clamp at p = 0.001
    keeps the cells of known corridors from adding up to information along every long beam: at
    p = 0.1 a beam is expected to end after 10 free cells.

    Sources: Moravec and Elfes 1985; clamping as in Hornung et al., "OctoMap", Autonomous Robots
    2013, eq. 4.

    Args:
        occupied: log-odds added when a cell is measured occupied, > 0.
        free: log-odds added when a beam passes through a cell, < 0.
        minimum: lower clamp of the log-odds, < 0.
        maximum: upper clamp of the log-odds, > 0.
        is_decisive: whether one measurement settles a cell; static. Then occupied cells stay
            occupied when a beam passes through them, and a cell at a clamp counts as certain in
            expected information.

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
        self.is_decisive = _kinds.flag("is_decisive", is_decisive)
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
        """Build a model from the factors by which a measurement multiplies the odds of a cell.

        The defaults are those of the FSMI literature, log-odds of 0.85 and -0.4, without a clamp.

        Args:
            occupied: factor if the cell is measured occupied, > 1.
            free: factor if a beam passes through the cell, in (0, 1).
            clamp: lower and upper clamp of the log-odds; None for no clamp.

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
        """Build a decisive model: one measurement settles a cell, and occupied cells stay occupied.

        This is the update of the quadrotor design notes in log-odds; each update is as large as the
        range of the clamp. A settled cell counts as certain in expected information. Otherwise
        p = 0.01 would predict that one cell in a hundred of a known hall is occupied, and a long
        view of the hall would have more information than an unknown corner.

        Args:
            free: probability of a cell that a beam has passed, in (0, 0.5).
            occupied: probability of a cell that was hit, in (0.5, 1).

        Raises:
            ValueError: a probability outside its range.
        """
        low = jax.scipy.special.logit(_checks.scalar("free", free, above=0.0, below=0.5))
        high = jax.scipy.special.logit(_checks.scalar("occupied", occupied, above=0.5, below=1.0))
        # A step as large as the range of the clamp takes any cell from one clamp to the other.
        span = compute(lambda _, low, high: high - low, low, high)
        return cls(span, compute(lambda _, span: -span, span), low, high, is_decisive=True)

    def log_odds(self, probability: Float[Array, "*N"]) -> Float[Array, "*N"]:
        """Return the log-odds `ln(p / (1 - p))`, clipped to the clamp; p may be 0 or 1."""
        # At p = 0 and 1 the slope is infinite, and times the zero slope of the clip it would be
        # NaN.
        is_certain = (probability <= 0.0) | (probability >= 1.0)
        inner = jax.scipy.special.logit(jnp.where(is_certain, 0.5, probability))
        certain = jnp.where(probability <= 0.0, self.minimum, self.maximum)
        return jnp.where(is_certain, certain, jnp.clip(inner, self.minimum, self.maximum))

    def update(
        self, probability: Float[Array, "*N"], log_odds_change: Float[Array, "..."]
    ) -> Float[Array, "*N"]:
        """Return the probability after a change of the log-odds.

        A cell whose change is 0 keeps its probability to the bit.
        """
        log_odds = self.log_odds(probability) + log_odds_change
        updated = jax.nn.sigmoid(jnp.clip(log_odds, self.minimum, self.maximum))
        # Converting to log-odds and back would change the last bits of unmeasured cells, and clip
        # those beyond the clamp.
        is_kept = (log_odds_change == 0.0) | self.stays(probability, log_odds_change)
        return jnp.where(is_kept, probability, updated)

    def settle(self, probability: Float[Array, "*N"]) -> Float[Array, "*N"]:
        """Return the probabilities that expected information is computed with.

        For a decisive model, cells at the clamp become exactly 0 or 1. Other probabilities are
        unchanged.
        """
        is_settled, is_wall = self.is_settled(probability), probability > 0.5
        return jnp.where(is_settled, jnp.where(is_wall, 1.0, 0.0), probability)

    def is_settled(self, probability: Float[Array, "*N"]) -> Bool[Array, "*N"]:
        """Return the mask of the cells at the clamp; none for a model that is not decisive."""
        if not self.is_decisive:
            return jnp.zeros_like(probability, bool)
        # Grids store probabilities, whose rounding moves the log-odds slightly off the clamp.
        log_odds = self.log_odds(probability)
        return (log_odds < self.minimum + 1e-3) | (log_odds > self.maximum - 1e-3)

    def stays(
        self, probability: Float[Array, "*N"], log_odds_change: Float[Array, "..."]
    ) -> Bool[Array, "*N"]:
        """Return the mask of the occupied cells that a change towards free leaves occupied."""
        if not self.is_decisive:
            return jnp.zeros_like(probability, bool)
        return (log_odds_change < 0.0) & (probability > OCCUPIED_THRESHOLD)
