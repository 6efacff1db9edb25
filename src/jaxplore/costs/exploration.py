"""Costs of an exploring robot: go where there is something to learn, and face the way there."""

import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import ControlVector, Scalar
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.information.belief import Belief


class InformationCost(Cost):
    """Reward for what a scan taken here would tell, `-I(x, y, yaw) / num_beams` [nat per beam].

    The field of view is that of the sensor that the belief was made for.
    """

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return minus the information of a scan per beam."""
        field = belief.information
        return -field(state.position, state.heading) / field.num_beams


class GuidanceCost(Cost):
    """Cost to go to the remaining information, and of not facing the way there [m].

        U(x) + turning * (1 - h . g(x))

    with h the heading and g the direction in which U falls, both unit vectors. Where a robot cannot
    move sideways, position alone does not reward turning. The second term rises all the way from
    facing the way to facing away from it, so there is no heading to be stuck in; a look-up ahead of
    the robot would have one in an alcove, where turning leads past walls, and could see the far
    side of a thin wall.

    Args:
        turning: what facing sideways costs [m].

    Raises:
        ValueError: a negative value.
    """

    turning: Scalar

    def __init__(self, turning: ArrayLike = 0.3) -> None:
        self.turning = _checks.scalar("turning", turning, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return the cost to go and of the heading."""
        position, heading = state.position, state.heading
        way = belief.guidance.direction(position)
        facing = jnp.cos(heading) * way[0] + jnp.sin(heading) * way[1]
        return belief.guidance(position) + self.turning * (1.0 - facing)
