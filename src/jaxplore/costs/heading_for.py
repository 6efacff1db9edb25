"""Costs of direction: the cost to go to a goal, and a preferred direction of motion."""

from jaxplore import _checks
from jaxplore._types import ArrayLike, ControlVector, Pose, Scalar
from jaxplore.belief.belief import Belief, part
from jaxplore.belief.guidance import GuidanceField
from jaxplore.costs._arrival import homing_cost
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.vectors import length


class ToGoalCost(Cost):
    """Cost to go to the goal around known obstacles, plus a cost of not facing the way there [m].

        U(x) + turning * (|g(x)| - h . g(x))

    with h the heading, U the cost to go to the goal and g its direction of descent, of length 1,
    and 0 at the goal. Both are read from `Belief.to_goal`, which a `Perception` with
    `is_goal_apart` provides. In `GuidanceCost` the term |g| is 1. At the goal that would cost
    `turning` for any heading, and the robot would stop before the goal.

    Where the belief has the position of the goal, the robot shall come to rest there: the distance
    by which it would overrun the goal counts twice, and the last 0.75 m are a straight line, 0.3 m
    for a car; to a heading, a car drives the manoeuvre that is cheapest in free space.

    Args:
        turning: cost of facing sideways [m].

    Raises:
        ValueError: a negative value. When traced, a belief without the field of the goal.
    """

    turning: Scalar

    def __init__(self, turning: ArrayLike = 0.3) -> None:
        self.turning = _checks.scalar("turning", turning, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Compute the cost to go plus the cost of the heading."""
        to_goal: GuidanceField = part(belief, "to_goal")
        cost, facing, most = to_goal.at_pose(state.position, state.heading, state.speed)
        if belief.goal is None:
            return cost + self.turning * (most - facing)
        return homing_cost(state, to_goal, cost, belief.goal, belief.goal_heading, self.turning)


class RegionCost(Cost):
    """Distance travelled in other directions than a preferred one, `|d| - d . n` [m].

    d is the displacement from the robot's position at the last update of the fields, `Belief.pose`,
    and n the unit vector at the angle `direction` from the heading there. The cost is 0 for motion
    along n and twice the distance for motion against it. With a different direction for each member
    of a `Portfolio`, such as ahead, left and right, the members search different regions.

    Source: the design notes for ground vehicles, "regional decomposition".

    Args:
        direction: angle from the heading of that pose, counter-clockwise [rad].

    Raises:
        ValueError: a direction that is not a finite number.
    """

    direction: Scalar

    def __init__(self, direction: ArrayLike = 0.0) -> None:
        self.direction = _checks.scalar("direction", direction)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Compute the distance travelled in other directions."""
        position = state.position
        pose: Pose = part(belief, "pose")
        x, y = position[0] - pose[0], position[1] - pose[1]
        # Relative to one pose for the whole rollout, so that the direction is fixed.
        angle = pose[2] + self.direction
        sin, cos = sin_cos(angle)
        return length(x, y) - (x * cos + y * sin)
