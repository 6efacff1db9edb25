"""Costs of being near static obstacles: those of the map, and discs."""

import functools
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._checks import array
from jaxplore._types import ArrayLike, ControlVector, Rows, Scalar, Vector
from jaxplore.belief.belief import Belief, part
from jaxplore.belief.volume_belief import VolumeBelief
from jaxplore.costs._contact import Lever, add_lever, contact, least, levers, offset, penalty
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.vectors import length


class ObstacleCost(Cost):
    """Cost of being near whatever is not known to be free.

    With d the clearance of the robot's centre in the belief, r its radius and v its speed,

        ((clearance - d)_+ / clearance)^2 + collision * ((c - d)_+ / 0.05 m)^2,
        c = r + margin + reaction_time * |v|

    For a robot covered by several discs (`Footprint`), d is the least clearance of their centres
    and r their radius.

    A faster robot needs more distance, so it slows down in narrow places. The second term grows
    with the depth and has no step. A robot that is suddenly too close, because the map changed,
    then still sees which way leads out.

    Args:
        clearance: distance of the centre below which the first term counts [m].
        collision: cost of each step that is 5 cm too close.
        margin: distance to keep beyond the radius [m].
        reaction_time: time by which the speed enlarges the distance [s].

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

    def stage(
        self, state: State, control: ControlVector, t: Scalar, belief: Belief | VolumeBelief
    ) -> Scalar:
        """Compute the cost of the distance to the nearest obstacle."""
        field = part(belief, "clearance")

        def clearance(lever: Lever) -> Scalar:
            centre = state.place(field.dimensions)
            if lever:
                centre = jnp.stack(add_lever(tuple(centre), lever))
            cleared: Scalar = field(centre)
            return cleared

        # Reduced pairwise and not as an array, which XLA would reduce sample by sample.
        distance = functools.reduce(jnp.minimum, map(clearance, levers(state)))
        too_close = contact(state, self.margin, self.reaction_time)
        return penalty(distance, self.clearance, too_close, self.collision)


class DiscObstacleCost(Cost):
    """Cost of being near discs or spheres, for obstacles that are given without a map.

    The cost is that of `ObstacleCost`, with d the distance of the robot's centre from the nearest
    surface, negative inside:

        d = min_n |p - c_n| - r_n

    `belief` is not read. For a robot covered by several discs, d is the least over their centres,
    which have the height of the robot.

    Args:
        centres: (N, 2) or (N, 3) centres of the obstacles [m]; the third column is compared with
            `state["z"]`. With N = 0 the cost is 0.
        radii: (N,) radii of the obstacles, or one number [m].
        clearance: distance of the robot's centre below which the first term counts [m].
        collision: cost of each step that is 5 cm too close.
        margin: distance to keep beyond the robot's radius [m].
        reaction_time: time by which the speed enlarges the distance [s].

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
        """Compute the cost of the distance to the nearest obstacle."""

        parts = levers(state)

        def outside(disc: tuple[Array, Array]) -> Scalar:
            centre, radius = disc
            away = offset(state, centre)
            nearest = [length(*add_lever(away, lever)) for lever in parts]
            return functools.reduce(jnp.minimum, nearest) - radius

        distance, _ = least(outside, (self.centres, self.radii))
        too_close = contact(state, self.margin, self.reaction_time)
        return penalty(distance, self.clearance, too_close, self.collision)
