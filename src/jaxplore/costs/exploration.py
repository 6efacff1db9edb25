"""Costs of an exploring robot: keep clear, go where there is something to learn, spare effort."""

import jax.numpy as jnp
from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import ControlVector, Scalar
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.information.belief import Belief


class ObstacleCost(Cost):
    """Distance kept from whatever is not known to be free.

    With d the clearance of the robot's centre on the belief, r its radius and v its speed,

        ((clearance - d)_+ / clearance)^2 + collision * ((c - d)_+ / 0.05 m)^2,
        c = r + margin + reaction_time * |v|

    The faster, the more room it needs, so it slows down where it is narrow. The second term has no
    step: what matters is how deep. A robot that finds itself too close, because the map changed
    under it, does not take all ways for equally bad and push on.

    Args:
        clearance: distance from the centre below which it costs [m].
        collision: cost of each step that is 5 cm too close.
        margin: kept beyond the radius [m].
        reaction_time: [s].

    Raises:
        ValueError: a clearance that is not positive, another value that is negative.
    """

    clearance: Scalar
    collision: Scalar
    margin: Scalar
    reaction_time: Scalar

    def __init__(
        self,
        clearance: ArrayLike = 0.4,
        collision: ArrayLike = 100.0,
        margin: ArrayLike = 0.02,
        reaction_time: ArrayLike = 0.05,
    ) -> None:
        self.clearance = _checks.scalar("clearance", clearance, above=0.0)
        self.collision = _checks.scalar("collision", collision, at_least=0.0)
        self.margin = _checks.scalar("margin", margin, at_least=0.0)
        self.reaction_time = _checks.scalar("reaction_time", reaction_time, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return the cost of being this close."""
        distance = belief.clearance(state.position)
        near = jnp.maximum(self.clearance - distance, 0.0) / self.clearance
        contact = state.dynamics.radius + self.margin + self.reaction_time * jnp.abs(state.speed)
        depth = jnp.maximum(contact - distance, 0.0) / 0.05
        return near * near + self.collision * depth * depth


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


class ControlCost(Cost):
    """Control effort, `sum_i (u_i / u_max,i)^2`: 1 per control at its bound."""

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return the effort."""
        share = control / state.dynamics.control_max
        return jnp.sum(share * share)
