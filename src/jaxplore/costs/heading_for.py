"""Costs of not going somewhere: to a goal along its field, or into one of several regions."""

from jax.typing import ArrayLike

from jaxplore import _checks
from jaxplore._types import ControlVector, Scalar
from jaxplore.belief.belief import Belief, part
from jaxplore.belief.guidance import GuidanceField
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.vectors import length


class ToGoalCost(Cost):
    """Cost to go to the goal around what is known to be in the way, and of not facing it [m].

        U(x) + turning * (|g(x)| - h . g(x))

    with h the heading, and the cost to go U and the way to go g of the goal's field,
    `Belief.to_goal`, which a `Perception` with `is_goal_apart` keeps. g is of length 1, and 0 at
    the goal. `GuidanceCost` has 1 instead of |g|: a robot would pay for being where it is to
    stop, and stop before.

    Args:
        turning: what facing sideways costs [m].

    Raises:
        ValueError: a negative value. When traced, a belief without that field.
    """

    turning: Scalar

    def __init__(self, turning: ArrayLike = 0.3) -> None:
        self.turning = _checks.scalar("turning", turning, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return the cost to go and of the heading."""
        to_goal: GuidanceField = part(belief, "to_goal")
        position, heading = state.position, state.heading
        way = to_goal.direction(position)
        sin, cos = sin_cos(heading)
        facing = cos * way[0] + sin * way[1]
        return to_goal(position) + self.turning * (length(way[0], way[1]) - facing)


class RegionCost(Cost):
    """How far the robot has gone without going in a direction, `|d| - d . n` [m].

    d is its way from where it is now and n a unit vector, `direction` from its heading now: 0 for
    one that goes that way, twice the distance for one that goes the other way. With one direction
    for each member of a `Portfolio`, ahead, left and right, members search different regions.

    Source: the design notes for ground vehicles, "regional decomposition".

    Args:
        direction: from the heading, counter-clockwise [rad].

    Raises:
        ValueError: a direction that is not a finite number.
    """

    direction: Scalar

    def __init__(self, direction: ArrayLike = 0.0) -> None:
        self.direction = _checks.scalar("direction", direction)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return the distance gone elsewhere."""
        position, pose = state.position, part(belief, "pose")
        x, y = position[0] - pose[0], position[1] - pose[1]
        angle = pose[2] + self.direction
        sin, cos = sin_cos(angle)
        return length(x, y) - (x * cos + y * sin)
