"""Objectives divided by what they vary, so that weights say how much each counts."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore._types import Scalar

FLOOR = 1e-3
"""Least spread that an objective is divided by, unless others are given."""


class Normalisation(eqx.Module):
    """The scale of each objective: its spread among rollouts, smoothed over time, above a floor.

        s_o = max(floor_o, spread_o),   spread_o = mean of |J_o - mean J_o|

    Args:
        floors: (O,).
        smoothing_time: of the spread [s].
        is_on: whether objectives are divided at all; static.
    """

    floors: Float[Array, " O"]
    smoothing_time: Scalar
    is_on: bool = eqx.field(static=True)

    def scale(self, spread: Float[Array, " O"]) -> Float[Array, " O"]:
        """Return what objectives of this spread are divided by (O,)."""
        return jnp.maximum(spread, self.floors) if self.is_on else jnp.ones_like(spread)

    def updated(
        self,
        spread: Float[Array, " O"],
        values: Float[Array, "O K"],
        hard: Float[Array, " K"],
        elapsed: Scalar,
        axis: str,
    ) -> Float[Array, " O"]:
        """Return the spread (O,) after a step; nothing new leaves it, the first is taken as it is.

        Over the rollouts of all members that pay nothing hard, if there are any: those that run
        into a wall would say how bad the worst is, not how much the others differ. Each value is
        compared with the mean of its own member, since members that look farther pay more.

        Args:
            spread: (O,) before; 0 before the first step.
            values: (O, K) of this member's rollouts.
            hard: (K,) what they pay that is not weighed.
            elapsed: time since the last step [s].
            axis: name of the mapped axis of members.
        """
        is_free = hard <= 0.0
        num_free = jax.lax.psum(  # type: ignore[no-untyped-call]
            jnp.sum(is_free, dtype=jnp.float32), axis
        )
        is_counted = jnp.isfinite(values) & (is_free | (num_free == 0.0))
        count = jnp.sum(is_counted, axis=1, dtype=jnp.float32)
        kept = jnp.where(is_counted, values, 0.0)
        mean = (jnp.sum(kept, axis=1) / jnp.maximum(count, 1.0))[:, None]
        away = jnp.sum(jnp.where(is_counted, jnp.abs(values - mean), 0.0), axis=1)
        total, number = jax.lax.psum((away, count), axis)  # type: ignore[no-untyped-call]
        now: Array = total / jnp.maximum(number, 1.0)
        share = -jnp.expm1(-elapsed / self.smoothing_time)
        after = jnp.where(spread > 0.0, spread + share * (now - spread), now)
        return jnp.where((now > 0.0) & jnp.isfinite(now), after, spread)
