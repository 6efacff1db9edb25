"""Plans that moving obstacles have told, such as the other robots of a fleet."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from jaxplore._types import Scalar

FRESH = 0.5
"""Age at which a plan is no longer believed [s]: its sender has planned anew many times since."""


class Plans(NamedTuple):
    """Positions that N obstacles plan to pass, each at equal steps of time.

    Args:
        positions: (N, T, 2) planned positions; row i is due `i * period` after the plan was made
            [m].
        period: time between the rows [s].
        age: (N,) time since each plan was made [s]; infinite without a plan.
    """

    positions: Float[Array, "N T 2"]
    period: Scalar
    age: Float[Array, " N"]

    @classmethod
    def unknown(cls, number: int, steps: int, period: Scalar) -> "Plans":
        """Return no plans, of so many rows, for so many obstacles."""
        return cls(jnp.zeros((number, steps, 2)), period, jnp.full(number, jnp.inf, jnp.float32))

    @property
    def is_fresh(self) -> Bool[Array, " N"]:
        """Whether each plan is young enough to be believed."""
        return self.age < FRESH

    def shift(self, t: Scalar) -> Float[Array, "N 2"]:
        """Return how far each obstacle moves within `t` seconds from now [m].

        The difference of two planned positions, not a position: what was measured since the plan
        was made corrects where it begins. At its end an obstacle stays.
        """
        return self._at(self.age + t) - self._at(self.age)

    def advance(self, elapsed: Scalar) -> "Plans":
        """Return the plans `elapsed` seconds later."""
        return self._replace(age=self.age + elapsed)

    def update(self, positions: Float[Array, "N T 2"], is_heard: Bool[Array, " N"]) -> "Plans":
        """Return the plans with new positions [m], made now, of the obstacles that are heard."""
        return self._replace(
            positions=jnp.where(is_heard[:, None, None], positions, self.positions),
            age=jnp.where(is_heard, 0.0, self.age),
        )

    def _at(self, time: Float[Array, " N"]) -> Float[Array, "N 2"]:
        """Return the planned positions (N, 2) a time after each plan was made [m]."""
        size = self.positions.shape[1]
        row = jnp.clip(jnp.where(self.is_fresh, time, 0.0) / self.period, 0.0, size - 1.0)
        # The weights of linear interpolation, of which two are not 0. A sum over all rows is one
        # short loop in a compiled rollout, where reading two rows by their number is several.
        weight = jnp.maximum(1.0 - jnp.abs(row[:, None] - jnp.arange(size, dtype=jnp.float32)), 0.0)
        return jnp.sum(weight[:, :, None] * self.positions, axis=1)
