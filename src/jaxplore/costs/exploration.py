"""Costs of exploration: information of scans, guidance to the remaining information, goals."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._checks import array
from jaxplore._types import ArrayLike, ControlVector, Scalar, Vector
from jaxplore.belief.belief import Belief, StrategicBelief, part
from jaxplore.belief.dwell import dwell_discount
from jaxplore.belief.exploration_field import GOAL_DETOUR
from jaxplore.belief.guidance import GuidanceField
from jaxplore.belief.volume_strategic import VolumeStrategicBelief
from jaxplore.costs._arrival import homing_cost, with_overrun
from jaxplore.costs._contact import offset
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.dynamics.uncertain import VARIANCE
from jaxplore.geometry.vectors import length, squared_length
from jaxplore.information.field import InformationField
from jaxplore.information.heading_field import HeadingField
from jaxplore.maps.field import ScalarField
from jaxplore.maps.volume_field import VolumeField


class InformationCost(Cost):
    """Reward for the information of a scan from this pose, `-I(x, y, yaw) / num_beams` [nat/beam].

    The field of view is that of the sensor that the belief was made for.

    With `is_fading` the reward is multiplied by `exp(-dwell(x, y) / patience)`, as it is for
    guidance. A robot then stops looking at what it cannot see after all, such as the far side of a
    hill.

    Args:
        is_fading: whether the reward is discounted by the time spent nearby; static.
    """

    is_fading: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        _kinds.flag("is_fading", self.is_fading)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Compute the negative information of a scan per beam."""
        field: InformationField = part(belief, "information")
        reward = field(state.position, state.heading) / field.num_beams
        if not self.is_fading:
            return -reward
        dwell = ScalarField(part(belief, "dwell"), field.frame, jnp.zeros(()))
        return -reward * dwell_discount(dwell(state.position), belief.patience)


class GuidanceCost(Cost):
    """Cost to go to the remaining information, plus a cost of not facing the way there [m].

        max(U(x), U(x_0) - reach) + turning * (1 - h . g(x))

    with U the cost to go, x_0 the position for which the belief was made (`Belief.pose`), h the
    heading and g the direction of descent of U, both unit vectors.

    The second term makes a robot that cannot move sideways turn, which U alone does not reward. It
    grows from facing the way to facing away from it, so there is no local minimum in the heading.
    Evaluating U ahead of the robot instead would have one in an alcove, where turning leads past
    walls, and could read the far side of a thin wall.

    U cannot fall by more than `reach` along a path within the horizon. Where it does, the lower
    value lies behind a wall, or across a gap in a room with information. Without the bound such a
    cliff, of up to a kilometre, would outweigh a collision.

    Where the belief has a goal that is next (`is_explored`), the robot shall come to rest there:
    the distance by which it would overrun the goal counts twice, and the last 0.75 m are a straight
    line, 0.3 m for a car; to a heading, a car drives the manoeuvre that is cheapest in free space.

    Args:
        turning: cost of facing sideways [m].
        reach: largest decrease of the cost to go that counts [m]. It must exceed twice the path
            within the horizon, since narrow places count double.

    Raises:
        ValueError: a negative value, a reach of 0.
    """

    turning: Scalar
    reach: Scalar

    def __init__(self, turning: ArrayLike = 0.3, reach: ArrayLike = 20.0) -> None:
        self.turning = _checks.scalar("turning", turning, at_least=0.0)
        self.reach = _checks.scalar("reach", reach, above=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Compute the bounded cost to go plus the cost of the heading."""
        position, heading = state.position, state.heading
        guidance: GuidanceField = part(belief, "guidance")
        cost, facing, _ = guidance.at_pose(position, heading, state.speed)
        here = guidance(belief.pose[:2])
        # Outside the field there is no cost to go at the robot that could bound it.
        least = jnp.where(here < guidance.outside, here - self.reach, -jnp.inf)
        bounded = jnp.maximum(cost, least)
        exploring = bounded + self.turning * (1.0 - facing)
        if belief.goal is None or belief.to_goal is not None:
            return exploring
        to_go = jnp.maximum(bounded - GOAL_DETOUR, 0.0)
        homing = homing_cost(state, guidance, to_go, belief.goal, belief.goal_heading, self.turning)
        return jnp.where(belief.is_explored, homing, exploring)


class PotentialCost(Cost):
    """Reward for the information in the strategic field, `-I(x, y)` or `-I(x, y, yaw)` [nat].

    The field is that of the strategic layer of `InformativeMPPI`. `I(x, y)` is its greatest value
    over headings, `I(x, y, yaw)` its value at the heading of the robot. In a volume it is
    `-I(x, y, z)` [nat m^3], of `VolumeInformativeMPPI`.

    Source: the parallel architecture of the quadrotor design notes, `J_field`.

    Args:
        by_heading: whether to read the field at the heading of the robot; static. Not in a volume.
    """

    by_heading: bool = eqx.field(static=True, default=False)

    def __check_init__(self) -> None:
        _kinds.flag("by_heading", self.by_heading)

    def stage(
        self,
        state: State,
        control: ControlVector,
        t: Scalar,
        belief: StrategicBelief | VolumeStrategicBelief,
    ) -> Scalar:
        """Compute the negative information."""
        if self.by_heading:
            by_heading: HeadingField = part(belief, "potential")
            return -by_heading(state.position, state.heading)
        best: ScalarField | VolumeField = part(belief, "best")
        return -best(state.place(best.dimensions))


class LocalInformationCost(Cost):
    """Reward for the information of a short-range scan from this pose, `-I(x, y, yaw)` [nat].

    Source: the quadrotor design notes, `J_local`: Uniform-FSMI of 6 beams up to 2.5 m. The notes
    cast the beams for every sample; here the samples read a field, see `ShortRangeField`.
    """

    def stage(
        self, state: State, control: ControlVector, t: Scalar, belief: StrategicBelief
    ) -> Scalar:
        """Compute the negative information."""
        local: HeadingField = part(belief, "local")
        return -local(state.position, state.heading)


class StrategyReferenceCost(Cost):
    """Squared distance from the reference of the strategic layer, `|p - r(t)|^2` [m^2]; horizontal,
    but in a volume."""

    def stage(
        self,
        state: State,
        control: ControlVector,
        t: Scalar,
        belief: StrategicBelief | VolumeStrategicBelief,
    ) -> Scalar:
        """Compute the squared distance at the time when the state is reached."""
        # Only for its error, which names a reference that is missing.
        part(belief, "reference")
        wanted = belief.reference_at(t)[: belief.dimensions]
        return squared_length(*jnp.unstack(state.place(belief.dimensions) - wanted))


class HomingCost(Cost):
    """Distance to the goal once the belief counts as explored (`is_explored`), and 0 before [m].

    The distance by which the robot would overrun the goal counts twice, as of `GoalCost`.

    Source: the quadrotor design notes, where the goal attracts only after exploration.

    Args:
        goal: goal position (x, y) or (x, y, z) [m].

    Raises:
        ValueError: a goal of the wrong shape or one that is not finite.
    """

    goal: Float[Array, " n"]

    def __init__(self, goal: Vector) -> None:
        self.goal = array("goal", goal, (2,), (3,))

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Compute the distance to the goal, or 0 before everything is explored."""
        distance = with_overrun(state, length(*offset(state, self.goal)))
        return jnp.where(belief.is_explored, distance, 0.0)


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
