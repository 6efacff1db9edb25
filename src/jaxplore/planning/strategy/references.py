"""Where a strategic layer sends the robot: references made from what it knows."""

import abc

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import Scalar
from jaxplore.belief.belief import Belief
from jaxplore.belief.guidance import GuidanceField
from jaxplore.maps.field import ScalarField
from jaxplore.planning.strategy.gradient_reference import GradientReference


class StrategicReference(eqx.Module):
    """A rule by which a strategic layer makes a reference.

    `walk` says how fast it goes and how long it is.
    """

    walk: eqx.AbstractVar[GradientReference]

    @abc.abstractmethod
    def __call__(
        self, belief: Belief, potential: ScalarField, start: Float[Array, "3"]
    ) -> Float[Array, "T 3"]:
        """Return the positions after 1 ... T steps [m].

        Args:
            belief: what the robot knows.
            potential: information of a scan around the robot [nat].
            start: (x, y, z) [m]; z is kept.
        """


class ClimbingReference(StrategicReference):
    """Climb the information field, or follow the guidance field where that leads to more.

    The field around the robot goes flat where all in reach is known, and has tops that are low:
    a climb ends there. Guidance knows the way through the whole map to what remains, and to the
    goal in the end. Of both walks the climb is taken if its end is worth `min_gain` more.

    Source: `field_gradient_trajectory` of the quadrotor design notes; the way out is ours.

    Args:
        walk: how a field is climbed; the notes' 40 steps of 0.05 s at 2 m/s when absent.
        min_gain: by how much the end of the climb must be worth more [nat].

    Raises:
        ValueError: a negative gain.
    """

    walk: GradientReference
    min_gain: Scalar

    def __init__(self, walk: GradientReference | None = None, min_gain: ArrayLike = 1.0) -> None:
        self.walk = GradientReference() if walk is None else walk
        self.min_gain = _checks.scalar("min_gain", min_gain, at_least=0.0)

    def __call__(
        self, belief: Belief, potential: ScalarField, start: Float[Array, "3"]
    ) -> Float[Array, "T 3"]:
        """Return the positions after 1 ... T steps [m]."""
        climbing = self.walk(potential, belief.grid, start)
        guided = follow(self.walk, belief.guidance, belief, start)
        gain = potential(climbing[-1, :2]) - potential(guided[-1, :2])
        return jnp.where(gain > self.min_gain, climbing, guided)


def follow(
    walk: GradientReference, field: GuidanceField, belief: Belief, start: Float[Array, "3"]
) -> Float[Array, "T 3"]:
    """Return the positions of a robot that goes down a cost to go [m]."""
    heights = ScalarField(-field.values, field.frame, -field.outside)
    return walk(heights, belief.grid, start)
