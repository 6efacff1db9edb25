"""Cost of driving fast past places that can hide somebody who walks."""

import functools
from typing import Any

import jax
import jax.numpy as jnp

from jaxplore import _checks
from jaxplore._types import ArrayLike, ControlVector, Scalar
from jaxplore.belief.belief import part
from jaxplore.costs._contact import add_lever, least, levers, offset
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.vectors import length
from jaxplore.sensing.clusters import Edges

FAR = 1e3
"""Distance beyond which edges do not matter [m]."""


class OcclusionCost(Cost):
    """Cost of a speed at which the robot could not stop for somebody who comes out of hiding:

        ((|v| - max(u(d), slowest))_+ / 1 m/s)^2,
        u(d) = -w + sqrt(w^2 + 2 b (d - w reaction_time)_+)

    with d the distance from the robot's edge to the nearest edge of a wall or thing behind which
    the last scan did not see (`belief.tracks.edges`), w the speed of whoever may be behind it, and
    b the deceleration of the robot. From the speed u the robot drives u^2 / 2 b while
    it brakes, and the other one walks w (reaction_time + u / b): both together need d.

    The robot passes every edge at `slowest`, because otherwise it would never pass a door.

    Source: the speed at which a robot may pass occlusions, as in Chung, Kim, Park and Kim, "Safe
    navigation of a mobile robot considering visibility of environment", IEEE Transactions on
    Industrial Electronics 56(10), 2009.

    Args:
        walker_speed: speed of whoever may come, w [m/s].
        deceleration: deceleration of the robot, b [m/s^2].
        reaction_time: time from the first sight until the robot brakes [s].
        slowest: speed that costs nothing anywhere [m/s].

    Raises:
        ValueError: a value that is not positive, or a negative time. When traced, a belief without
            tracks.
    """

    walker_speed: Scalar
    deceleration: Scalar
    reaction_time: Scalar
    slowest: Scalar

    def __init__(
        self,
        walker_speed: ArrayLike = 1.6,
        deceleration: ArrayLike = 1.0,
        reaction_time: ArrayLike = 0.2,
        slowest: ArrayLike = 0.3,
    ) -> None:
        self.walker_speed = _checks.scalar("walker_speed", walker_speed, above=0.0)
        self.deceleration = _checks.scalar("deceleration", deceleration, above=0.0)
        self.reaction_time = _checks.scalar("reaction_time", reaction_time, at_least=0.0)
        self.slowest = _checks.scalar("slowest", slowest, above=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the cost of the speed of a state."""
        allowed = self.allowed_speed(state, part(belief, "tracks").edges)
        excess = jnp.maximum(jnp.abs(state.speed) - allowed, 0.0)
        return excess * excess

    def allowed_speed(self, state: State, edges: Edges) -> Scalar:
        """Return the speed that costs nothing in a state, max(u(d), slowest) [m/s].

        Args:
            state: state of the robot.
            edges: edges behind which something can be hidden.
        """
        parts, radius = levers(state), state.dynamics.footprint.radius

        def away(edge: tuple[jax.Array, jax.Array]) -> Scalar:
            place, is_there = edge
            gap = offset(state, place)
            lengths = [length(*add_lever(gap, lever)) for lever in parts]
            return jnp.where(is_there, functools.reduce(jnp.minimum, lengths), jnp.inf)

        nearest, _ = least(away, (edges.position, edges.is_there))
        w = self.walker_speed
        room = jnp.maximum(nearest - radius - w * self.reaction_time, 0.0)
        # Without an edge the root would be infinite, and its product with 0 NaN.
        room = jnp.minimum(room, FAR)
        allowed = jnp.sqrt(w * w + 2.0 * self.deceleration * room) - w
        return jnp.maximum(allowed, self.slowest)
