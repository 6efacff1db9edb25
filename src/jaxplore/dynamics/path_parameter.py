"""Model the virtual state of path following: the progress along the path."""

from typing import ClassVar

import jax.numpy as jnp

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Scalar, StateVector
from jaxplore.dynamics.base import Dynamics
from jaxplore.geometry.path import Path


class PathParameter(Dynamics):
    """Progress phi [m] along a path with its rate [m/s] as the control, for `Augmented`:

        phi' = clip(phi + dt * clip(rate, min_rate, max_rate), 0, end)

    The rate is clipped before it is used, and so before it is rewarded: a rate that does not move
    phi earns nothing.

    Source: Lam, Manzie and Good, "Model predictive contouring control", CDC 2010, eq. 6.

    Args:
        max_rate: upper bound of the rate [m/s].
        end: arc length at which the path ends [m]; by default phi is unbounded, as on a closed
            path.
        min_rate: lower bound of the rate [m/s].

    Raises:
        ValueError: a maximum rate or an end that is not positive, a minimum rate above the maximum.
    """

    state_names: ClassVar[tuple[str, ...]] = ("phi",)
    control_names: ClassVar[tuple[str, ...]] = ("phi_rate",)

    control_min: ControlVector
    control_max: ControlVector
    end: Scalar | None
    radius: Scalar

    def __init__(
        self, max_rate: ArrayLike, end: ArrayLike | None = None, min_rate: ArrayLike = 0.0
    ) -> None:
        high = _checks.scalar("max_rate", max_rate, above=0.0)
        low = _checks.scalar("min_rate", min_rate)
        if not _kinds.is_traced(high, low) and float(low) > float(high):
            raise ValueError(f"min_rate is {min_rate!r}; accepted: at most max_rate, {max_rate!r}")
        self.control_min, self.control_max = low[None], high[None]
        self.end = None if end is None else _checks.scalar("end", end, above=0.0)
        self.radius = jnp.zeros(())  # a virtual state has no extent

    @classmethod
    def along(cls, path: Path, max_rate: ArrayLike) -> "PathParameter":
        """Build the progress model of a path: bounded by the end of an open path, or unbounded."""
        return cls(max_rate, None if path.is_closed else path.length)

    def step(self, state: StateVector, control: ControlVector, dt: Scalar) -> StateVector:
        """Return phi (1,) after `dt` seconds."""
        # Clip here as well: an unclipped rate could otherwise move phi faster than it may.
        rate = jnp.clip(control[0], self.control_min[0], self.control_max[0])
        phi = jnp.maximum(state[0] + dt * rate, 0.0)
        return jnp.stack([phi if self.end is None else jnp.minimum(phi, self.end)])
