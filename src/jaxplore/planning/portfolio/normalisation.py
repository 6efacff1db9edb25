"""Normalisation: divide each objective by its spread, so that weights are comparable."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Scalar

FLOOR = 1e-3
"""Default lower bound of the spread that an objective is divided by."""


class Normalisation(eqx.Module):
    """Scale of each objective: its mean absolute deviation among rollouts, smoothed over time.

        s_o = max(floor_o, spread_o),   spread_o = mean of |J_o - mean J_o|

    `smoothing_time` is the time constant of the smoothing [s]. If `is_on` is false, all scales
    are 1.
    """

    floors: Float[Array, " O"]
    smoothing_time: Scalar
    is_on: bool = eqx.field(static=True)

    def scale(self, spread: Float[Array, " O"]) -> Float[Array, " O"]:
        """Return the divisors (O,) of objectives with this spread (O,)."""
        return jnp.maximum(spread, self.floors) if self.is_on else jnp.ones_like(spread)

    def update(
        self,
        spread: Float[Array, " O"],
        values: Float[Array, "O K"],
        hard: Float[Array, " K"],
        elapsed: Scalar,
        axis: str,
    ) -> Float[Array, " O"]:
        """Update the spread of the objectives (O,) with the rollouts of a step.

            spread <- spread + (1 - exp(-elapsed / smoothing_time)) (new - spread)

        The spread is 0 before the first step. The first new one is taken unsmoothed; one that is 0
        or not finite is ignored. `values` (O, K) are the objectives of this member's rollouts, and
        `hard` (K,) their hard costs. `elapsed` is the time since the last step [s]. `axis` is the
        name of the mapped axis of members.
        """
        # Rollouts that collide do not count, as long as others are left: the depth of a collision
        # would hide the differences between the rollouts that may be chosen.
        is_free = hard <= 0.0
        num_free = jax.lax.psum(  # type: ignore[no-untyped-call]
            jnp.sum(is_free, dtype=jnp.float32), axis
        )
        is_counted = jnp.isfinite(values) & (is_free | (num_free == 0.0))
        count = jnp.sum(is_counted, axis=1, dtype=jnp.float32)
        kept = jnp.where(is_counted, values, 0.0)
        # Each member is compared with its own mean, since a longer horizon costs more.
        mean = (jnp.sum(kept, axis=1) / jnp.maximum(count, 1.0))[:, None]
        away = jnp.sum(jnp.where(is_counted, jnp.abs(values - mean), 0.0), axis=1)
        total, number = jax.lax.psum((away, count), axis)  # type: ignore[no-untyped-call]
        now: Array = total / jnp.maximum(number, 1.0)
        # Exponential smoothing for any control period: the share of a step grows with its length.
        share = -jnp.expm1(-elapsed / self.smoothing_time)
        after = jnp.where(spread > 0.0, spread + share * (now - spread), now)
        return jnp.where((now > 0.0) & jnp.isfinite(now), after, spread)
