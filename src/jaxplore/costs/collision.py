"""The cost of colliding, and nothing else: what no objective is worth."""

import functools

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array

from jaxplore import _checks
from jaxplore._types import ControlVector, Flag, Scalar
from jaxplore.costs._contact import Lever, contact, depth, levers, shifted
from jaxplore.costs._distance import length, offset
from jaxplore.costs._many import add_up
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.information.belief import Belief
from jaxplore.information.tracks import Tracks


class CollisionCost(Cost):
    """How deep the robot is in what it must not touch; 0 for one that keeps clear.

    With d the least clearance on the belief of the discs that cover the robot, r their radius, v
    its speed and, for each moving obstacle, g_n the least distance of a disc's centre from where
    its surface is expected,

        ((c - d)_+ / 0.05 m)^2 + sum_n ((c + caution s_n(t) - g_n)_+ / 0.05 m)^2,
        c = r + margin + reaction_time |v|,   s_n(t) = deviation of its place

    the hard part of `ObstacleCost` and `TrackedObstacleCost` alone. For a `Portfolio`, whose
    members weigh how far to keep from obstacles, but not whether to hit them. Moving obstacles are
    those of `belief.tracks`; where it is absent there are none.

    What moves may turn at any time. With a `braking` b, a robot that comes nearer to an obstacle of
    speed v_n, at a rate w, pays beside that

        headway sum_n (c + w^2 / (2 b) + w v_n / b - g_n)_+^2  where w > 0

    for the room that it lacks to stop, were the obstacle to turn towards it now: w / b is the time
    to stop, w^2 / (2 b) the way. To stand, or to go away, costs nothing. (The longitudinal rule of
    Shalev-Shwartz, Shammah and Shashua, "On a formal model of safe and scalable self-driving cars",
    2017, definition 1, as a price: near what cannot be avoided, to swerve may be better.)

    Args:
        margin: kept beyond the radius [m].
        reaction_time: [s].
        caution: standard deviations of where an obstacle will be that are kept free.
        braking: deceleration that the robot is capable of [m/s^2]; one that stops at once when
            absent.
        headway: cost of each step that lacks a metre to stop [1/m^2].

    Raises:
        ValueError: a negative value, a braking of 0.
    """

    margin: Scalar
    reaction_time: Scalar
    caution: Scalar
    braking: Scalar | None
    headway: Scalar

    def __init__(
        self,
        margin: ArrayLike = 0.02,
        reaction_time: ArrayLike = 0.05,
        caution: ArrayLike = 1.0,
        braking: ArrayLike | None = None,
        headway: ArrayLike = 0.03,
    ) -> None:
        self.margin = _checks.scalar("margin", margin, at_least=0.0)
        self.reaction_time = _checks.scalar("reaction_time", reaction_time, at_least=0.0)
        self.caution = _checks.scalar("caution", caution, at_least=0.0)
        self.braking = None if braking is None else _checks.scalar("braking", braking, above=0.0)
        self.headway = _checks.scalar("headway", headway, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Belief) -> Scalar:
        """Return the squared depth, in 5 cm."""
        too_close = contact(state, self.margin, self.reaction_time)
        parts = levers(state)

        def clearance(lever: Lever) -> Scalar:
            centre = state.position
            return belief.clearance(jnp.stack(shifted(tuple(centre), lever)) if lever else centre)

        deep = depth(functools.reduce(jnp.minimum, map(clearance, parts)), too_close)
        total = deep * deep
        if belief.tracks is None:
            return total
        tracks: Tracks = belief.tracks

        def price(obstacle: tuple[Array, Scalar, Scalar, Scalar, Flag]) -> Scalar:
            centre, radius, spread, speed, counts = obstacle
            away = offset(state, centre)
            distances = [length(shifted(away, lever)) for lever in parts]
            gap = functools.reduce(jnp.minimum, distances) - radius
            inside = depth(gap, too_close + spread)
            paid = inside * inside
            if self.braking is not None:
                closing = _closing(state, away)
                to_stop = closing * (0.5 * closing + speed) / self.braking
                lacking = jnp.where(closing > 0.0, too_close + to_stop - gap, 0.0)
                paid = paid + self.headway * jnp.maximum(lacking, 0.0) ** 2
            return jnp.where(counts, paid, 0.0)

        is_known = tracks.is_known
        places = jnp.where(is_known[:, None], tracks.predicted(t), 0.0)
        spreads = self.caution * jnp.where(is_known, tracks.deviation(t), 0.0)
        speeds = jnp.where(is_known, jnp.hypot(*tracks.velocities.T), 0.0)
        return total + add_up(price, (places, tracks.radii, spreads, speeds, is_known))


def _closing(state: State, away: tuple[Scalar, ...]) -> Scalar:
    """Return the speed at which the robot's own motion brings it nearer to a point [m/s].

    Args:
        state: of the robot.
        away: from the point to the robot (x, y) [m].
    """
    ahead = -(away[0] * jnp.cos(state.heading) + away[1] * jnp.sin(state.heading))
    distance = jnp.maximum(length(away), 1e-3)
    return jnp.maximum(state.speed * ahead / distance, 0.0)
