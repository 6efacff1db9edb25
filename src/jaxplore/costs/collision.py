"""The cost of collisions alone, which no objective of a portfolio is traded against."""

import functools

import jax.numpy as jnp
from jaxtyping import Array

from jaxplore import _checks
from jaxplore._types import ArrayLike, ControlVector, Scalar
from jaxplore.belief.belief import Belief, part
from jaxplore.costs._contact import Lever, add_lever, add_up, contact, depth, levers
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.outlines import nearest


class CollisionCost(Cost):
    """Squared penetration depth of the robot into obstacles; 0 without a collision.

    With d the least clearance of the discs that cover the robot, r their radius, v the speed of the
    robot and, for each moving obstacle, g_n the least distance of a disc's centre from the expected
    surface of the obstacle,

        ((c - d)_+ / 0.05 m)^2 + sum_n ((c + caution s_n(t) - g_n)_+ / 0.05 m)^2,
        c = r + margin + reaction_time |v|,   s_n(t) = standard deviation of its position

    the collision terms of `ObstacleCost` and `MovingObstacleCost` alone. For a `Portfolio`, whose
    members weigh how far to keep from obstacles, but not whether to hit them. Moving obstacles are
    those of `belief.obstacles`; where it is absent there are none.

    A moving obstacle may turn at any time. With v_n its speed and h_n the distance of a disc's
    centre from its current surface, a much smaller second cost

        reach sum_n (c + v_n t - h_n)_+^2

    is added for being where the obstacle could be by then in any direction. This is the reachable
    set of a point with bounded speed, as in Fraichard and Asama, "Inevitable collision states - a
    step towards safer robots?", Advanced Robotics 2004. It is a cost and not a constraint, since
    near an obstacle that cannot be avoided it may be better to pass.

    Args:
        margin: distance to keep beyond the radius [m].
        reaction_time: time by which the speed enlarges the distance [s].
        caution: number of standard deviations of an obstacle's position to keep free.
        reach: cost of each step that is 1 m deep in the reachable set of an obstacle [1/m^2].

    Raises:
        ValueError: a negative value. When traced, a belief without a clearance.
    """

    margin: Scalar
    reaction_time: Scalar
    caution: Scalar
    reach: Scalar

    def __init__(
        self,
        margin: ArrayLike = 0.02,
        reaction_time: ArrayLike = 0.05,
        caution: ArrayLike = 1.0,
        reach: ArrayLike = 0.1,
    ) -> None:
        self.margin = _checks.scalar("margin", margin, at_least=0.0)
        self.reaction_time = _checks.scalar("reaction_time", reaction_time, at_least=0.0)
        self.caution = _checks.scalar("caution", caution, at_least=0.0)
        self.reach = _checks.scalar("reach", reach, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Compute the squared depth, in units of 5 cm, plus the cost of the reachable sets."""
        too_close = contact(state, self.margin, self.reaction_time)
        field, parts = part(belief, "clearance"), levers(state)

        def clearance(lever: Lever) -> Scalar:
            centre = state.position
            if lever:
                centre = jnp.stack(add_lever(tuple(centre), lever))
            distance: Scalar = field(centre)
            return distance

        # Reduced pairwise and not as an array, which XLA would reduce sample by sample.
        deep = depth(functools.reduce(jnp.minimum, map(clearance, parts)), too_close)
        total = deep * deep
        obstacles = belief.obstacles
        if obstacles is None:
            return total
        points = [add_lever(tuple(state.position), lever) for lever in parts]

        def gap(corners: Array, radius: Scalar) -> Scalar:
            distances = [nearest(corners, radius, x, y).distance for x, y in points]
            return functools.reduce(jnp.minimum, distances)

        def penalty(obstacle: tuple[Array, Array, Scalar, Scalar, Scalar]) -> Scalar:
            expected, now, radius, spread, speed = obstacle
            inside = depth(gap(expected, radius), too_close + spread)
            within = jnp.maximum(too_close + speed * t - gap(now, radius), 0.0)
            return inside * inside + self.reach * within * within

        # The reachable set grows from the present outline: the obstacle may turn at once.
        expected, now = obstacles.predict(t), obstacles.predict(jnp.zeros(()))
        spreads = self.caution * obstacles.deviation(t)
        things = (expected.corners, now.corners, expected.radii, spreads, obstacles.speeds)
        return total + add_up(penalty, things)
