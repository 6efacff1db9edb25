"""Costs of an exploring robot: go where there is something to learn, and face the way there."""

import equinox as eqx
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._checks import array
from jaxplore._types import ControlVector, Scalar, Vector
from jaxplore.belief.belief import Belief, StrategicBelief, part
from jaxplore.belief.dwell import dwell_discount
from jaxplore.belief.guidance import GuidanceField
from jaxplore.costs._distance import offset
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.vectors import length
from jaxplore.information.field import InformationField
from jaxplore.information.heading_field import HeadingField
from jaxplore.maps.field import ScalarField


class InformationCost(Cost):
    """Reward for what a scan taken here would tell, `-I(x, y, yaw) / num_beams` [nat per beam].

    The field of view is that of the sensor that the belief was made for.

    Fading, it is worth `exp(-dwell(x, y) / patience)` of that, as places are to guidance: what
    cannot be seen after all, such as the far side of a hill, is not looked at for ever.

    Args:
        is_fading: static.
    """

    is_fading: bool = eqx.field(static=True, default=False)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return minus the information of a scan per beam."""
        field: InformationField = part(belief, "information")
        reward = field(state.position, state.heading) / field.num_beams
        if not self.is_fading:
            return -reward
        dwell = ScalarField(part(belief, "dwell"), field.frame, jnp.zeros(()))
        return -reward * dwell_discount(dwell(state.position), belief.patience)


class GuidanceCost(Cost):
    """Cost to go to the remaining information, and of not facing the way there [m].

        max(U(x), U(x_0) - reach) + turning * (1 - h . g(x))

    with x_0 the place where the field was made (`Belief.pose`), h the heading and g the direction
    in which U falls, both unit vectors. Where a robot cannot move sideways, position alone does not
    reward turning. The second term rises all the way from facing the way to facing away from it, so
    there is no heading to be stuck in; a look-up ahead of the robot would have one in an alcove,
    where turning leads past walls, and could see the far side of a thin wall.

    No way that the robot can take within its horizon leads farther down than `reach`: what does is
    behind a wall, or across a gap into a room where there is something to see while here there is
    not. Without a bound such a cliff, of up to a kilometre, outweighs a collision.

    Args:
        turning: what facing sideways costs [m].
        reach: of the cost to go that counts [m]; more than twice the way within the horizon, since
            tight places count double.

    Raises:
        ValueError: a negative value, no reach.
    """

    turning: Scalar
    reach: Scalar

    def __init__(self, turning: ArrayLike = 0.3, reach: ArrayLike = 20.0) -> None:
        self.turning = _checks.scalar("turning", turning, at_least=0.0)
        self.reach = _checks.scalar("reach", reach, above=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return the cost to go and of the heading."""
        position, heading = state.position, state.heading
        guidance: GuidanceField = part(belief, "guidance")
        way = guidance.direction(position)
        sin, cos = sin_cos(heading)
        facing = cos * way[0] + sin * way[1]
        here = guidance(belief.pose[:2])
        # Off the lattice there is nothing to compare with.
        least = jnp.where(here < guidance.outside, here - self.reach, -jnp.inf)
        return jnp.maximum(guidance(position), least) + self.turning * (1.0 - facing)


class PotentialCost(Cost):
    """Reward for being where a scan is worth much, `-I(x, y)` or `-I(x, y, yaw)` [nat].

    Reads the field around the robot that the strategic layer of `InformativeMPPI` keeps: its
    greatest value over headings, or that of the robot's own heading.

    Source: the parallel architecture of the quadrotor design notes, `J_field`.

    Args:
        by_heading: read the field at the robot's heading; static.
    """

    by_heading: bool = eqx.field(static=True, default=False)

    def stage(
        self, state: State, control: ControlVector, t: Scalar, belief: StrategicBelief
    ) -> Scalar:
        """Return minus the information."""
        if self.by_heading:
            by_heading: HeadingField = part(belief, "potential")
            return -by_heading(state.position, state.heading)
        best: ScalarField = part(belief, "best")
        return -best(state.position)


class LocalInformationCost(Cost):
    """Reward for what a short look from this pose tells, `-I(x, y, yaw)` [nat].

    Source: the quadrotor design notes, `J_local`: Uniform-FSMI of 6 beams up to 2.5 m, here read
    from a field of the map as it is now instead of cast for every sample.
    """

    def stage(
        self, state: State, control: ControlVector, t: Scalar, belief: StrategicBelief
    ) -> Scalar:
        """Return minus the information."""
        local: HeadingField = part(belief, "local")
        return -local(state.position, state.heading)


class StrategyReferenceCost(Cost):
    """Squared distance from the reference of the strategic layer, `|p - r(t)|^2` [m^2], over
    ground."""

    def stage(
        self, state: State, control: ControlVector, t: Scalar, belief: StrategicBelief
    ) -> Scalar:
        """Return the squared distance at the time when the state is reached."""
        part(belief, "reference")
        position, wanted = state.position, belief.reference_at(t)
        x, y = position[0] - wanted[0], position[1] - wanted[1]
        return x * x + y * y


class HomingCost(Cost):
    """Distance to the goal once nothing worthwhile is left to see, 0 before [m].

    Source: the quadrotor design notes, where the goal attracts only when the field is spent.

    Args:
        goal: (x, y) or (x, y, z) [m].

    Raises:
        ValueError: a goal of another shape or not finite.
    """

    goal: Float[Array, " n"]

    def __init__(self, goal: Vector) -> None:
        self.goal = array("goal", goal, (2,), (3,))

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return the distance, or 0."""
        return jnp.where(belief.is_explored, length(*offset(state, self.goal)), 0.0)
