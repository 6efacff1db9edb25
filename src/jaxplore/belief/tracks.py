"""Moving obstacles as the robot knows them."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from jaxplore import _checks
from jaxplore._types import Scalar, Vector


class Tracks(eqx.Module):
    """Moving discs as the robot's tracker knows them; it tells them apart without fail.

    Each goes on straight while it is out of sight, and is forgotten when that has lasted: it may be
    anywhere then, and who keeps clear of all the places where it may be runs into walls. Their
    number M is static.

    Args:
        positions: (M, 2) of their centres now [m].
        velocities: (M, 2) [m/s].
        radii: (M,) [m].
        std: (M,) standard deviation of the position along either axis when it was measured [m].
        age: (M,) time since then [s].
        growth: standard deviation of the velocity along either axis [m/s].
        is_known: (M,) false: never seen, or forgotten; costs and predictions leave it out.
        memory: how long one that is out of sight is believed in [s].
    """

    positions: Float[Array, "M 2"]
    velocities: Float[Array, "M 2"]
    radii: Float[Array, " M"]
    std: Float[Array, " M"]
    age: Float[Array, " M"]
    growth: Scalar
    is_known: Bool[Array, " M"]
    memory: Scalar

    @classmethod
    def none(cls) -> "Tracks":
        """Return those of a robot that expects nothing to move: M = 0."""
        return cls.unseen(())

    @classmethod
    def unseen(cls, radii: Vector, growth: ArrayLike = 0.2, memory: ArrayLike = 3.0) -> "Tracks":
        """Return those of discs of which none has been seen yet.

        Args:
            radii: (M,) [m].
            growth: standard deviation of the velocity along either axis [m/s].
            memory: how long one that is out of sight is believed in [s].

        Raises:
            ValueError: radii that are not M finite numbers >= 0, a negative growth, a memory that
                is not positive.
        """
        if not _checks.is_traced(radii):
            given = np.asarray(radii, np.float32)
            if given.ndim != 1:
                raise ValueError(f"radii has shape {given.shape}; accepted: (M,)")
            is_bad = ~np.isfinite(given) | (given < 0.0)
            if is_bad.any():
                value = given[is_bad][0]
                raise ValueError(f"radii has a value {value}; accepted: finite numbers >= 0.0")
            radii = given
        sizes = jnp.asarray(radii, jnp.float32)
        number = sizes.shape[0]
        return cls(
            positions=jnp.zeros((number, 2)),
            velocities=jnp.zeros((number, 2)),
            radii=sizes,
            std=jnp.zeros(number),
            age=jnp.zeros(number),
            growth=_checks.scalar("growth", growth, at_least=0.0),
            is_known=jnp.zeros(number, bool),
            memory=_checks.scalar("memory", memory, above=0.0),
        )

    def predicted(self, t: Scalar) -> Float[Array, "M 2"]:
        """Return where they are `t` seconds from now (M, 2) [m], by straight motion."""
        return self.positions + t * self.velocities

    def deviation(self, t: Scalar) -> Float[Array, " M"]:
        """Return the standard deviation (M,) of where they are `t` seconds from now [m].

            sqrt(std^2 + (growth (age + t))^2)

        An error of the velocity lasts, so that of the position grows with the time, not its root.
        """
        drift = self.growth * (self.age + t)
        return jnp.hypot(self.std, drift)

    def update(
        self,
        measured_positions: Float[Array, "M 2"],
        measured_velocities: Float[Array, "M 2"],
        is_seen: Bool[Array, " M"],
        position_std: Scalar,
        elapsed: Scalar,
    ) -> "Tracks":
        """Return what is known after a look.

        Those that are seen are where they were measured. The others have gone on straight, or are
        forgotten.

        A measurement that is not finite is none.

        Args:
            measured_positions: (M, 2) [m].
            measured_velocities: (M, 2) [m/s].
            is_seen: (M,) which of them are measured.
            position_std: standard deviation of a measured position along either axis [m].
            elapsed: time since the last look [s].
        """
        measured = jnp.concatenate([measured_positions, measured_velocities], axis=-1)
        is_measured = is_seen & jnp.isfinite(measured).all(axis=-1)
        takes = is_measured[:, None]
        age = jnp.where(is_measured, 0.0, self.age + elapsed)
        return Tracks(
            positions=jnp.where(takes, measured_positions, self.predicted(elapsed)),
            velocities=jnp.where(takes, measured_velocities, self.velocities),
            radii=self.radii,
            std=jnp.where(is_measured, position_std, self.std),
            age=age,
            growth=self.growth,
            is_known=(self.is_known | is_measured) & (age <= self.memory),
            memory=self.memory,
        )
