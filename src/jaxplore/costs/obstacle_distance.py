"""The cost of being near obstacles with an outline, standing or moving."""

from typing import Any

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxplore import _checks
from jaxplore._types import ControlVector, Scalar
from jaxplore.belief.obstacles import Obstacles
from jaxplore.costs._contact import contact, levers, penalty, shifted
from jaxplore.costs._many import least
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.outlines import nearest


class ObstacleDistanceCost(Cost):
    """Distance kept from discs and polygons where they will be.

    With g_n the distance of the robot's centre from obstacle n when the state is reached, negative
    inside, and s_n the standard deviation of where that is along the way to it,

        d = min_n g_n - caution s_n,   s_n^2 = u^T C_n(t) u,   u = the direction of the way

    it costs what `ObstacleCost` does:

        ((clearance - d)_+ / clearance)^2 + collision * ((c - d)_+ / 0.05 m)^2,
        c = r + margin + reaction_time * |v|

    Of a robot that several discs cover (`Footprint`), d is the least over their centres.

    `caution` keeps free where an obstacle may be. What several outcomes come to, weighed by a
    measure of risk, says more and takes longer: `UncertainObstacles`.

    Args:
        obstacles: `Obstacles`; read from the belief when absent: the belief itself, or its
            `obstacles`. None of them, N = 0, cost nothing.
        clearance: distance from the robot's centre below which it costs [m].
        collision: cost of each step that is 5 cm too close.
        margin: kept beyond the robot's radius [m].
        reaction_time: [s].
        caution: standard deviations that are kept free.

    Raises:
        ValueError: a clearance that is not positive, another value that is negative.
    """

    obstacles: Obstacles | None
    clearance: Scalar
    collision: Scalar
    margin: Scalar
    reaction_time: Scalar
    caution: Scalar

    def __init__(
        self,
        obstacles: Obstacles | None = None,
        clearance: ArrayLike = 0.4,
        collision: ArrayLike = 100.0,
        margin: ArrayLike = 0.02,
        reaction_time: ArrayLike = 0.05,
        caution: ArrayLike = 1.0,
    ) -> None:
        self.obstacles = obstacles
        self.clearance = _checks.scalar("clearance", clearance, above=0.0)
        self.collision = _checks.scalar("collision", collision, at_least=0.0)
        self.margin = _checks.scalar("margin", margin, at_least=0.0)
        self.reaction_time = _checks.scalar("reaction_time", reaction_time, at_least=0.0)
        self.caution = _checks.scalar("caution", caution, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return the cost of being this close when the state is reached."""
        distance = self.distance(state, t, self._known(belief))
        too_close = contact(state, self.margin, self.reaction_time)
        return penalty(distance, self.clearance, too_close, self.collision)

    def distance(self, state: State, t: Scalar, obstacles: Obstacles) -> Scalar:
        """Return d, the distance of the nearest obstacle from the robot's centres [m].

        Args:
            state: of the robot at that time.
            t: time from now [s].
            obstacles: as they are now.
        """
        outlines, covariance = obstacles.predicted(t), obstacles.predicted_covariance(t)
        variances = self.caution**2 * jnp.stack(
            [covariance[:, 0, 0], 2.0 * covariance[:, 0, 1], covariance[:, 1, 1]], axis=-1
        )
        centres = [shifted(tuple(state.position), lever) for lever in levers(state)]

        def gap(obstacle: tuple[Array, Scalar, Array]) -> Scalar:
            corners, radius, (xx, xy, yy) = obstacle
            room = jnp.full((), jnp.inf)
            for x, y in centres:
                found = nearest(corners, radius, x, y)
                square = found.x * found.x + found.y * found.y
                is_zero = square <= 0.0
                variance = xx * found.x * found.x + xy * found.x * found.y + yy * found.y * found.y
                spread = jnp.where(is_zero, xx + yy, variance / jnp.where(is_zero, 1.0, square))
                is_exact = spread <= 0.0
                spread = jnp.where(is_exact, 0.0, jnp.sqrt(jnp.where(is_exact, 1.0, spread)))
                room = jnp.minimum(room, found.distance - spread)
            return room

        return least(gap, (outlines.corners, outlines.radii, variances))[0]

    def room(self, state: State, obstacles: Obstacles) -> Scalar:
        """Return the distance of the robot's edge from obstacles as they are now [m]."""
        return self.distance(state, jnp.zeros(()), obstacles) - state.dynamics.footprint.radius

    def _known(self, belief: Any) -> Obstacles:
        if self.obstacles is not None:
            return self.obstacles
        known: Obstacles = belief if isinstance(belief, Obstacles) else belief.obstacles
        return known
