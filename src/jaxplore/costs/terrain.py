"""Costs of the ground: how hard it is to drive on, and how nearly it cannot be."""

import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import ControlVector, Scalar
from jaxplore.belief.belief import Belief
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State


class TerrainCost(Cost):
    """Slope and roughness of the ground under the robot,

        (slope / steep)^2 + roughness / rough

    so that it goes around a hill if the detour is worth it, and keeps to smooth ground. Reads
    `belief.ground`; where it is absent the ground is level and costs nothing.

    Args:
        steep: slope that costs 1 [m/m].
        rough: roughness that costs 1 [m].

    Raises:
        ValueError: a value that is not positive.
    """

    steep: Scalar
    rough: Scalar

    def __init__(self, steep: ArrayLike = 0.3, rough: ArrayLike = 0.05) -> None:
        self.steep = _checks.scalar("steep", steep, above=0.0)
        self.rough = _checks.scalar("rough", rough, above=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return the cost of driving here."""
        if belief.ground is None:
            return jnp.zeros(())
        slope = belief.ground.slope_field(state.position) / self.steep
        return slope * slope + belief.ground.roughness_field(state.position) / self.rough


class TraversabilityCost(Cost):
    """How little of the ground's traversability is left, and how far it is below what is allowed,

        (1 - traversability)^2 + barrier * ((threshold + margin - traversability)_+ / margin)^2

    Reads `belief.ground`; where it is absent all ground can be driven on and costs nothing. Cells
    below the threshold are closed to the robot's paths anyway, as walls are: this keeps it from
    driving along their edge.

    Args:
        barrier: cost of being at the threshold.
        margin: traversability above the threshold from which the barrier counts.

    Raises:
        ValueError: a negative barrier, a margin that is not positive.
    """

    barrier: Scalar
    margin: Scalar

    def __init__(self, barrier: ArrayLike = 10.0, margin: ArrayLike = 0.1) -> None:
        self.barrier = _checks.scalar("barrier", barrier, at_least=0.0)
        self.margin = _checks.scalar("margin", margin, above=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return the cost of driving here."""
        if belief.ground is None:
            return jnp.zeros(())
        left = belief.ground.traversability_field(state.position)
        lost = 1.0 - left
        short = jnp.maximum(belief.ground.threshold + self.margin - left, 0.0) / self.margin
        return lost * lost + self.barrier * short * short
