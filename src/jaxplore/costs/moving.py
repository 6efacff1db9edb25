"""Cost of the distance to moving obstacles."""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import ArrayLike, ControlVector, Scalar
from jaxplore.belief.belief import part
from jaxplore.belief.obstacles import Obstacles
from jaxplore.costs._contact import add_lever, add_up, contact, depth, least, levers
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.outlines import nearest
from jaxplore.geometry.vectors import root

SMALLEST = 1e-3
"""Least width of a Gaussian [m]: a point robot and an exact point obstacle would have width 0."""


class _Obstacle(NamedTuple):
    """Predicted quantities of one obstacle, or of N on the first axis; unused ones are None.

    `form` are the coefficients of x^2, x y and y^2 in the exponent of its Gaussian, `variances`
    those in the variance of its distance.
    """

    centre: Any
    form: Any
    corners: Any
    radius: Any
    variances: Any


class MovingObstacleCost(Cost):
    """Cost of nearness to the predicted moving obstacles at the time of the state:

        sum_n [ nearness exp(-1/2 e_n^T S_n(t)^-1 e_n)
                + ((clearance - d_n)_+ / clearance)^2 + collision ((c - d_n)_+ / 0.05 m)^2 ]

        e_n = p - p_n(t),   S_n(t) = C_n(t) + (r + r_n)^2 I
        d_n = g_n - caution s_n,   s_n^2 = u^T C_n(t) u,   c = r + margin + reaction_time |v|

    with p the robot's centre, r its radius and v its speed; p_n(t) the centre of obstacle n, C_n(t)
    its covariance (`Obstacles`) and r_n the radius of the circle about its centre that holds it;
    g_n the distance of p from its outline, negative inside, and u the direction from p to the
    nearest point of the outline.

    - The Gaussian penalises positions where an obstacle may be. Its peak is always 1: uncertainty
        widens it and does not lower it. At contact with a disc that is known exactly it is
        exp(-1/2), about 0.6, and it rises further inside.
    - The ramp and the collision term are those of `ObstacleCost`. They keep a distance from the
        outline, which grows by `caution` standard deviations. `UncertainObstacles` samples outcomes
        and applies a risk measure instead: more accurate and slower.

    With `nearest_only` the ramp and the collision term use the least d_n instead of the sum.

    For a robot that several discs cover (`Footprint`), r is their radius, and each obstacle enters
    with the greatest Gaussian and the least d_n over their centres p. An unknown obstacle costs
    nothing.

    A term whose factor is None is not compiled.

    Args:
        obstacles: obstacles that are known in advance; `belief.obstacles` when absent.
        nearness: weight of the Gaussian.
        clearance: distance from the robot's centre below which the ramp costs [m].
        collision: cost of each step that is 5 cm too close.
        margin: distance kept beyond the robot's radius [m].
        reaction_time: time that the robot takes to react [s].
        caution: number of standard deviations to keep clear of.
        nearest_only: whether the ramp and the collision term use the nearest obstacle only;
            static.

    Raises:
        ValueError: a clearance that is not positive, another value that is negative. When traced, a
            belief without obstacles.
    """

    obstacles: Obstacles | None
    nearness: Scalar | None
    clearance: Scalar | None
    collision: Scalar | None
    margin: Scalar
    reaction_time: Scalar
    caution: Scalar | None
    nearest_only: bool = eqx.field(static=True)

    @_kinds.check_arguments
    def __init__(
        self,
        obstacles: Obstacles | None = None,
        *,
        nearness: ArrayLike | None = 1.0,
        clearance: ArrayLike | None = None,
        collision: ArrayLike | None = 100.0,
        margin: ArrayLike = 0.1,
        reaction_time: ArrayLike = 0.05,
        caution: ArrayLike | None = None,
        nearest_only: bool = False,
    ) -> None:
        self.obstacles = obstacles
        self.nearness = _factor("nearness", nearness)
        self.clearance = (
            None if clearance is None else _checks.scalar("clearance", clearance, above=0.0)
        )
        self.collision = _factor("collision", collision)
        self.margin = _checks.scalar("margin", margin, at_least=0.0)
        self.reaction_time = _checks.scalar("reaction_time", reaction_time, at_least=0.0)
        self.caution = _factor("caution", caution)
        self.nearest_only = _kinds.flag("nearest_only", nearest_only)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Return the cost of a state that is reached `t` seconds from now."""
        obstacles: Obstacles = (
            part(belief, "obstacles") if self.obstacles is None else self.obstacles
        )
        radius, points = state.dynamics.footprint.radius, _points(state)
        too_close = contact(state, self.margin, self.reaction_time)
        if obstacles.is_known is None:
            return self._evaluate(radius, points, too_close, t, obstacles)
        # All samples share the obstacles, so under `jax.vmap` this stays a branch: while none is
        # known, as of robots that are far apart, nothing is computed. It is given what it reads of
        # the states, because XLA would copy whole states into it.
        paid: Scalar = jax.lax.cond(
            jnp.any(obstacles.is_known),
            lambda points, too_close: self._evaluate(radius, points, too_close, t, obstacles),
            lambda _, too_close: jnp.zeros_like(too_close),
            *(points, too_close),
        )
        return paid

    def _evaluate(
        self,
        radius: Scalar,
        points: list[tuple[Scalar, ...]],
        too_close: Scalar,
        t: Scalar,
        obstacles: Obstacles,
    ) -> Scalar:
        """Return the cost of a state; obstacles that are not known cost nothing.

        `radius` and `points` are those of the robot's discs [m]. A centre nearer than `too_close`
        [m] is too close. `t` is the time from now [s], `obstacles` those at the present time.
        """
        has_distance = self.clearance is not None or self.collision is not None
        sums_distances = has_distance and not self.nearest_only
        things = self._predict(radius, t, obstacles, has_distance)

        def price(obstacle: _Obstacle) -> Scalar:
            paid = jnp.zeros(())
            if self.nearness is not None:
                paid = paid + self.nearness * _gaussian(obstacle, points)
            if sums_distances:
                paid = paid + self._penalty(_gap(obstacle, points), too_close)
            return paid

        total = jnp.zeros(())
        if self.nearness is not None or sums_distances:
            total = add_up(price, things)
        if has_distance and self.nearest_only:
            room, _ = least(lambda obstacle: _gap(obstacle, points), things)
            total = total + self._penalty(room, too_close)
        return total

    def distance(self, state: State, t: Scalar, obstacles: Obstacles) -> Scalar:
        """Return the least d_n: the distance of the nearest obstacle from the robot's centres [m].

        Args:
            state: state of the robot at that time.
            t: time from now [s].
            obstacles: the obstacles at the present time.
        """
        radius, points = state.dynamics.footprint.radius, _points(state)
        things = self._predict(radius, t, obstacles, True)
        return least(lambda obstacle: _gap(obstacle, points), things)[0]

    def room(self, state: State, obstacles: Obstacles) -> Scalar:
        """Return the distance from the robot's edge to the nearest obstacle at the present time
        [m]."""
        return self.distance(state, jnp.zeros(()), obstacles) - state.dynamics.footprint.radius

    def _predict(
        self, radius: Scalar, t: Scalar, obstacles: Obstacles, has_distance: bool
    ) -> _Obstacle:
        """Predict the quantities of each obstacle that the terms read.

        They do not depend on the sample, so under `jax.vmap` they are computed once for all.
        """
        covariance = obstacles.predict_covariance(t)
        centre = form = corners = radii = variances = None
        if self.nearness is not None:
            centre = obstacles.predict_centres(t)
            form = _forms(covariance, radius + obstacles.extents)
        if has_distance:
            outlines = obstacles.predict(t)
            corners, radii = outlines.corners, outlines.radii
            if self.caution is not None:
                entries = covariance[:, 0, 0], 2.0 * covariance[:, 0, 1], covariance[:, 1, 1]
                # The factor of the deviation is squared here, once for all samples.
                variances = self.caution**2 * jnp.stack(entries, axis=-1)
        return _Obstacle(centre, form, corners, radii, variances)

    def _penalty(self, distance: Scalar, too_close: Scalar) -> Scalar:
        """Return the sum of the ramp and the collision term for a distance."""
        paid = jnp.zeros(())
        if self.clearance is not None:
            near = jnp.maximum(self.clearance - distance, 0.0) / self.clearance
            paid = near * near
        if self.collision is not None:
            deep = depth(distance, too_close)
            paid = paid + self.collision * deep * deep
        return paid


def _factor(name: str, value: ArrayLike | None) -> Scalar | None:
    return None if value is None else _checks.scalar(name, value, at_least=0.0)


def _points(state: State) -> list[tuple[Scalar, ...]]:
    """Return the centres (x, y) of the discs that cover the robot [m]."""
    return [add_lever(tuple(state.position), lever) for lever in levers(state)]


def _forms(covariance: Float[Array, "N 2 2"], extent: Float[Array, " N"]) -> Float[Array, "N 3"]:
    """Return the coefficients of x^2, x y and y^2 in -1/2 e^T S^-1 e.

    S is the covariance of a centre [m^2], plus the square of `extent` on its diagonal: the sum of
    the robot's and the obstacle's radius [m].
    """
    wider = jnp.maximum(extent, SMALLEST) ** 2
    a, b = covariance[:, 0, 0] + wider, covariance[:, 0, 1]
    c = covariance[:, 1, 1] + wider
    # -1/2 of the inverse of [[a, b], [b, c]], with the factor 2 of the mixed term.
    scale = -0.5 / (a * c - b * b)
    return jnp.stack([scale * c, -2.0 * scale * b, scale * a], axis=-1)


def _gaussian(obstacle: _Obstacle, points: list[tuple[Scalar, ...]]) -> Scalar:
    """Return an obstacle's Gaussian at the point where it is greatest."""
    (p, q, r), (middle_x, middle_y) = obstacle.form, obstacle.centre
    exponents = []
    for here in points:
        x, y = here[0] - middle_x, here[1] - middle_y
        exponents.append(p * x * x + q * x * y + r * y * y)
    # The greatest exponent is that of the greatest Gaussian, so one exponential suffices.
    return jnp.exp(functools.reduce(jnp.maximum, exponents))


def _gap(obstacle: _Obstacle, points: list[tuple[Scalar, ...]]) -> Scalar:
    """Return d_n, the least over points of the distance from an obstacle, less its caution [m]."""
    room = jnp.full((), jnp.inf)
    for x, y in points:
        found = nearest(obstacle.corners, obstacle.radius, x, y)
        distance = found.distance
        if obstacle.variances is not None:
            xx, xy, yy = obstacle.variances
            square = found.x * found.x + found.y * found.y
            is_zero = square <= 0.0
            variance = xx * found.x * found.x + xy * found.x * found.y + yy * found.y * found.y
            # At the centre of a disc the direction is undefined: the sum over both axes is an
            # upper bound of the variance.
            spread = jnp.where(is_zero, xx + yy, variance / jnp.where(is_zero, 1.0, square))
            distance = distance - root(spread)
        room = jnp.minimum(room, distance)
    return room
