"""Costs of being near obstacles that stay: those of the map, and discs."""

import functools
from typing import Any

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._checks import array
from jaxplore._types import ControlVector, Rows, Scalar, Vector
from jaxplore.belief.belief import Belief, part
from jaxplore.costs._contact import Lever, contact, levers, penalty, shifted
from jaxplore.costs._distance import offset
from jaxplore.costs._many import least
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.vectors import length


class ObstacleCost(Cost):
    """Distance kept from whatever is not known to be free.

    With d the clearance of the robot's centre on the belief, r its radius and v its speed,

        ((clearance - d)_+ / clearance)^2 + collision * ((c - d)_+ / 0.05 m)^2,
        c = r + margin + reaction_time * |v|

    Of a robot that several discs cover (`Footprint`), d is the least clearance of their centres and
    r their radius.

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
        field = part(belief, "clearance")

        def clearance(lever: Lever) -> Scalar:
            centre = state.position
            if lever:
                centre = jnp.stack(shifted(tuple(centre), lever))
            cleared: Scalar = field(centre)
            return cleared

        distance = functools.reduce(jnp.minimum, map(clearance, levers(state)))
        too_close = contact(state, self.margin, self.reaction_time)
        return penalty(distance, self.clearance, too_close, self.collision)


class DiscObstacleCost(Cost):
    """Distance kept from discs, or spheres: the cost of obstacles where there is no map.

    With d the distance of the robot's centre from the nearest surface, negative inside,

        d = min_n |p - c_n| - r_n

    it costs what `ObstacleCost` does; `belief` is not read. Of a robot that several discs cover, d
    is the least over their centres, whose height is the robot's.

    Args:
        centres: (N, 2) or (N, 3) [m]; the third column is compared with `state["z"]`. None of them,
            N = 0, costs nothing.
        radii: (N,) or one number [m].
        clearance: distance from the robot's centre below which it costs [m].
        collision: cost of each step that is 5 cm too close.
        margin: kept beyond the robot's radius [m].
        reaction_time: [s].

    Raises:
        ValueError: a clearance that is not positive, another value that is negative, shapes that do
            not fit.
    """

    centres: Float[Array, "N D"]
    radii: Float[Array, " N"]
    clearance: Scalar
    collision: Scalar
    margin: Scalar
    reaction_time: Scalar

    def __init__(
        self,
        centres: Rows,
        radii: Vector,
        clearance: ArrayLike = 0.4,
        collision: ArrayLike = 100.0,
        margin: ArrayLike = 0.02,
        reaction_time: ArrayLike = 0.05,
    ) -> None:
        self.centres = array("centres", centres, ("N", 2), ("N", 3), may_be_empty=True)
        number = self.centres.shape[0]
        self.radii = jnp.broadcast_to(array("radii", radii, (), (number,), at_least=0.0), (number,))
        self.clearance = _checks.scalar("clearance", clearance, above=0.0)
        self.collision = _checks.scalar("collision", collision, at_least=0.0)
        self.margin = _checks.scalar("margin", margin, at_least=0.0)
        self.reaction_time = _checks.scalar("reaction_time", reaction_time, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return the cost of being this close."""

        parts = levers(state)

        def outside(disc: tuple[Array, Array]) -> Scalar:
            centre, radius = disc
            away = offset(state, centre)
            nearest = [length(*shifted(away, lever)) for lever in parts]
            return functools.reduce(jnp.minimum, nearest) - radius

        distance, _ = least(outside, (self.centres, self.radii))
        too_close = contact(state, self.margin, self.reaction_time)
        return penalty(distance, self.clearance, too_close, self.collision)
