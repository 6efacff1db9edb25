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
    """Cost to go to the remaining information, read ahead of the robot [m].

    The point ahead turns with the robot, so turning towards where to go pays at once, also when
    the robot cannot move sideways: the control point of feedback linearisation of a unicycle
    (d'Andrea-Novel, Campion and Bastin 1995). It is `min(lookahead, clearance)` ahead, within the
    disc around the robot that is known to be free: farther on it could lie behind a wall, in a room
    to which the way is long, and the robot would stand facing that wall.

    Args:
        lookahead: greatest distance of the point ahead of the centre [m].

    Raises:
        ValueError: a negative lookahead.
    """

    lookahead: Scalar

    def __init__(self, lookahead: ArrayLike = 0.3) -> None:
        self.lookahead = _checks.scalar("lookahead", lookahead, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return the guidance at the point ahead."""
        position, heading = state.position, state.heading
        ahead = jnp.minimum(self.lookahead, belief.clearance(position))
        direction = jnp.stack([jnp.cos(heading), jnp.sin(heading)])
        return belief.guidance(position + ahead * direction)


class ControlCost(Cost):
    """Control effort, `sum_i (u_i / u_max,i)^2`: 1 per control at its bound."""

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return the effort."""
        share = control / state.dynamics.control_max
        return jnp.sum(share * share)
