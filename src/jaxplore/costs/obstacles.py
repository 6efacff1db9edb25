"""Costs of being near obstacles: those of the map, discs, and moving ones."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from jaxplore import _checks
from jaxplore._types import ControlVector, Rows, Scalar, Vector
from jaxplore.costs._arguments import array
from jaxplore.costs._distance import length, offset
from jaxplore.costs._many import add_up, least
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.information.belief import Belief


class ObstacleCost(Cost):
    """Distance kept from whatever is not known to be free.

    With d the clearance of the robot's centre on the belief, r its radius and v its speed,

        ((clearance - d)_+ / clearance)^2 + collision * ((c - d)_+ / 0.05 m)^2,
        c = r + margin + reaction_time * |v|

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
        distance = belief.clearance(state.position)
        contact = _contact(state, self.margin, self.reaction_time)
        return _penalty(distance, self.clearance, contact, self.collision)


class DiscObstacleCost(Cost):
    """Distance kept from discs, or spheres: the cost of obstacles where there is no map.

    With d the distance of the robot's centre from the nearest surface, negative inside,

        d = min_n |p - c_n| - r_n

    it costs what `ObstacleCost` does; `belief` is not read.

    Args:
        centres: (N, 2) or (N, 3) [m]; the third column is compared with `state["z"]`.
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
        self.centres = array("centres", centres, ("N", 2), ("N", 3))
        self.radii = _one_each("radii", radii, self.centres, at_least=0.0)
        self.clearance = _checks.scalar("clearance", clearance, above=0.0)
        self.collision = _checks.scalar("collision", collision, at_least=0.0)
        self.margin = _checks.scalar("margin", margin, at_least=0.0)
        self.reaction_time = _checks.scalar("reaction_time", reaction_time, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return the cost of being this close."""

        def outside(disc: tuple[Array, Array]) -> Scalar:
            centre, radius = disc
            return length(offset(state, centre)) - radius

        distance, _ = least(outside, (self.centres, self.radii))
        contact = _contact(state, self.margin, self.reaction_time)
        return _penalty(distance, self.clearance, contact, self.collision)


class MovingObstacleCost(Cost):
    """Nearness to where moving obstacles are expected, a Gaussian around each:

        sum_n exp(-1/2 d_n^T S_n(t)^-1 d_n),   d_n = p - (p_n + v_n t)
        S_n(t) = C_n + ((growth t)^2 + (r + r_n)^2) I

    They go on straight, and where they are becomes less certain with time: `growth` is the standard
    deviation of their velocity. The robot's radius r and theirs widen the Gaussian, so at contact
    with an obstacle that is known exactly it is exp(-1/2), about 0.6, and still rises further in.

    The peak is 1 at any time, not normalised: uncertainty spreads the cost and makes it no smaller.

    Args:
        positions: p_n, (N, 2) where they are now [m].
        velocities: v_n, (N, 2) [m/s].
        radii: r_n, (N,) or one number [m].
        std: of the position now along either axis, (N,) or one number [m]: `C_n = std_n^2 I`; 0.2
            when absent.
        covariance: C_n, (N, 2, 2), or (2, 2) for all [m^2]; instead of `std`.
        growth: (N,) or one number [m/s].

    Raises:
        ValueError: shapes that do not fit, a `std` that is not positive, a covariance that is not
            symmetric and positive definite, both of them, a negative radius or growth.
    """

    positions: Float[Array, "N 2"]
    velocities: Float[Array, "N 2"]
    radii: Float[Array, " N"]
    covariance: Float[Array, "N 2 2"]
    growth: Float[Array, " N"]

    def __init__(
        self,
        positions: Rows,
        velocities: Rows,
        radii: Vector = 0.0,
        std: Vector | None = None,
        covariance: Rows | None = None,
        growth: Vector = 0.2,
    ) -> None:
        self.positions = array("positions", positions, ("N", 2))
        number = self.positions.shape[0]
        self.velocities = array("velocities", velocities, (number, 2))
        self.radii = _one_each("radii", radii, self.positions, at_least=0.0)
        if std is not None and covariance is not None:
            raise ValueError(f"std is {std!r} beside a covariance; accepted: one of them")
        if covariance is None:
            spread = _one_each("std", 0.2 if std is None else std, self.positions, above=0.0)
            self.covariance = (spread * spread)[:, None, None] * jnp.eye(2)
        else:
            given = array("covariance", covariance, (2, 2), (number, 2, 2))
            _check_covariance(given)
            self.covariance = jnp.broadcast_to(given, (number, 2, 2))
        self.growth = _one_each("growth", growth, self.positions, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return the sum over the obstacles at the time when the state is reached."""
        extent = state.dynamics.radius + self.radii
        spread = self.growth * t
        wider = spread * spread + extent * extent
        a, b = self.covariance[:, 0, 0] + wider, self.covariance[:, 0, 1]
        c = self.covariance[:, 1, 1] + wider
        # -1/2 of the inverse of [[a, b], [b, c]], with the factor 2 of the mixed term.
        scale = -0.5 / (a * c - b * b)
        forms = jnp.stack([scale * c, -2.0 * scale * b, scale * a], axis=-1)
        centres = self.positions + t * self.velocities

        def nearness(obstacle: tuple[Array, Array]) -> Scalar:
            centre, form = obstacle
            x, y = offset(state, centre)
            return jnp.exp(form[0] * x * x + form[1] * x * y + form[2] * y * y)

        return add_up(nearness, (centres, forms))


def _contact(state: State, margin: Scalar, reaction_time: Scalar) -> Scalar:
    """Return the distance of the centre at which the robot is too close [m]."""
    return state.dynamics.radius + margin + reaction_time * jnp.abs(state.speed)


def _penalty(distance: Scalar, clearance: Scalar, contact: Scalar, collision: Scalar) -> Scalar:
    near = jnp.maximum(clearance - distance, 0.0) / clearance
    depth = jnp.maximum(contact - distance, 0.0) / 0.05
    return near * near + collision * depth * depth


def _one_each(
    name: str,
    value: Vector,
    rows: Array,
    *,
    above: float | None = None,
    at_least: float | None = None,
) -> Float[Array, " N"]:
    """Return one number for each row (N,); a single one is for all."""
    number = rows.shape[0]
    given = array(name, value, (), (number,), above=above, at_least=at_least)
    return jnp.broadcast_to(given, (number,))


def _check_covariance(covariance: Array) -> None:
    if _checks.is_traced(covariance):
        return
    given = np.asarray(covariance, np.float64)
    skew = np.abs(given - np.swapaxes(given, -1, -2))
    is_symmetric = (skew <= 1e-5 * np.abs(given).max(axis=(-2, -1), keepdims=True)).all()
    if not is_symmetric or (np.linalg.eigvalsh(given) <= 0.0).any():
        raise ValueError(
            f"covariance is {given.tolist()}; accepted: symmetric and positive definite"
        )
