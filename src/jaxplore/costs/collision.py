"""The cost of colliding, and nothing else: what no objective is worth."""

import functools

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxplore import _checks
from jaxplore._types import ControlVector, Scalar
from jaxplore.belief.belief import Belief, part
from jaxplore.costs._contact import Lever, contact, depth, levers, shifted
from jaxplore.costs._many import add_up
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.outlines import nearest


class CollisionCost(Cost):
    """How deep the robot is in what it must not touch; 0 for one that keeps clear.

    With d the least clearance on the belief of the discs that cover the robot, r their radius, v
    its speed and, for each moving obstacle, g_n the least distance of a disc's centre from where
    its surface is expected,

        ((c - d)_+ / 0.05 m)^2 + sum_n ((c + caution s_n(t) - g_n)_+ / 0.05 m)^2,
        c = r + margin + reaction_time |v|,   s_n(t) = standard deviation of its position

    the collision terms of `ObstacleCost` and `MovingObstacleCost` alone. For a `Portfolio`, whose
    members weigh how far to keep from obstacles, but not whether to hit them. Moving obstacles are
    those of `belief.obstacles`; where it is absent there are none.

    What moves may turn at any time. With v_n an obstacle's speed and h_n the distance of a disc's
    centre from where its surface is now, a rollout pays beside that, far less,

        reach sum_n (c + v_n t - h_n)_+^2

    for being where the obstacle could be by then, whichever way it went. (The reachable set of a
    point with bounded speed, as in Fraichard and Asama, "Inevitable collision states - a step
    towards safer robots?", Advanced Robotics 2004. As a price, not a bound: near what cannot be
    avoided, to pass may be better.)

    Args:
        margin: kept beyond the radius [m].
        reaction_time: [s].
        caution: standard deviations of where an obstacle will be that are kept free.
        reach: cost of each step that is a metre deep in where an obstacle could be [1/m^2].

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
        """Return the squared depth, in 5 cm."""
        too_close = contact(state, self.margin, self.reaction_time)
        field, parts = part(belief, "clearance"), levers(state)

        def clearance(lever: Lever) -> Scalar:
            centre = state.position
            return field(jnp.stack(shifted(tuple(centre), lever)) if lever else centre)

        deep = depth(functools.reduce(jnp.minimum, map(clearance, parts)), too_close)
        total = deep * deep
        obstacles = belief.obstacles
        if obstacles is None:
            return total
        points = [shifted(tuple(state.position), lever) for lever in parts]

        def gap(corners: Array, radius: Scalar) -> Scalar:
            distances = [nearest(corners, radius, x, y).distance for x, y in points]
            return functools.reduce(jnp.minimum, distances)

        def price(obstacle: tuple[Array, Array, Scalar, Scalar, Scalar]) -> Scalar:
            expected, now, radius, spread, speed = obstacle
            inside = depth(gap(expected, radius), too_close + spread)
            within = jnp.maximum(too_close + speed * t - gap(now, radius), 0.0)
            return inside * inside + self.reach * within * within

        expected, now = obstacles.predicted(t), obstacles.predicted(jnp.zeros(()))
        spreads = self.caution * obstacles.deviation(t)
        things = (expected.corners, now.corners, expected.radii, spreads, obstacles.speeds)
        return total + add_up(price, things)
