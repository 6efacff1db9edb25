"""Costs of not knowing the position, for rollouts of an `UncertainRobot`."""

import jax.numpy as jnp

from jaxplore import _checks
from jaxplore._types import ArrayLike, ControlVector, Scalar
from jaxplore.belief.belief import Belief, part
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.dynamics.uncertain import VARIANCE
from jaxplore.information.field import InformationField


class UncertaintyCost(Cost):
    """Expected standard deviation of the position along a rollout, `sqrt(v)` [m]."""

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Compute the standard deviation."""
        return jnp.sqrt(jnp.maximum(state[VARIANCE], 1e-12))


class CertainInformationCost(Cost):
    """Reward for the information of a scan, less where the robot will not know its position:

        -I(x, y, yaw) / num_beams / (1 + v / scale^2)                                [nat/beam]

    What a scan tells is put in the wrong place by as much as the position is wrong. With a standard
    deviation of `scale` it counts half.

    Args:
        scale: standard deviation of the position at which information counts half [m].

    Raises:
        ValueError: a scale that is not positive.
    """

    scale: Scalar

    def __init__(self, scale: ArrayLike = 0.1) -> None:
        self.scale = _checks.scalar("scale", scale, above=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Compute the negative information of a scan per beam, discounted."""
        field: InformationField = part(belief, "information")
        reward = field(state.position, state.heading) / field.num_beams
        return -reward / (1.0 + state[VARIANCE] / self.scale**2)
