"""Costs of tracking errors: to points, references, paths and target states.

| cost | the robot should | growth with the error |
| --- | --- | --- |
| `GoalCost` | reach a goal from far away | linear, or up to a bound |
| `WaypointCost` | settle at a pose | quadratic |
| `ReferenceCost` | be at a position at a given time | quadratic |
| `PathCost` | be on a polyline, at any time | quadratic |
| `StateCost` | have given values of state components | quadratic |
"""

import abc
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax import Array
from jaxtyping import Float

from jaxplore import _checks, _kinds
from jaxplore._checks import array, by_name, names_within
from jaxplore._types import ArrayLike, ControlVector, Rows, Scalar, Vector
from jaxplore.costs._arrival import overrun, with_overrun
from jaxplore.costs._contact import least, offset
from jaxplore.costs.base import Cost
from jaxplore.dynamics.base import State
from jaxplore.geometry.angles import sin_cos
from jaxplore.geometry.vectors import length, squared_length

OVERRUN_PRICE = 4.0
"""Cost of each metre by which a robot would overrun a waypoint, per metre of distance [1/m]."""


class ErrorCost(Cost):
    """Cost of an error of the state, counted once more at the last state; abstract."""

    terminal_weight: eqx.AbstractVar[Scalar]

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the cost of the error."""
        return self._error(state)

    def terminal(self, state: State, belief: Any) -> Scalar:
        """Compute the cost of the last error, times `terminal_weight`."""
        return self.terminal_weight * self._error(state)

    @abc.abstractmethod
    def _error(self, state: State) -> Scalar:
        """Compute the cost of the error of a state."""


class GoalCost(ErrorCost):
    """Straight-line distance d to a goal [m], or with a saturation s, `s d / (s + d)`.

    The gradient does not grow with the distance, so a goal far away does not dominate the other
    costs, as a squared distance would. With a saturation the gradient falls but never vanishes:
    the cost is d near the goal and tends to s far from it. To settle at a pose, use `WaypointCost`.

    d is the distance plus twice that by which the robot would overrun the goal if it braked with
    half of its deceleration (`Dynamics.deceleration`): a robot too fast to stop is not near.

    Args:
        goal: (2,) or (3,) goal position [m]; the third component is compared with `state["z"]`.
        saturation: upper bound of the cost, s [m]; none when absent.
        terminal_weight: factor on the additional cost of the last state.

    Raises:
        ValueError: a goal of the wrong shape, a saturation that is not positive, a negative weight.
            When traced, a third component for a model without `z`.
    """

    goal: Float[Array, " D"]
    saturation: Scalar | None
    terminal_weight: Scalar

    def __init__(
        self,
        goal: Vector,
        saturation: ArrayLike | None = None,
        terminal_weight: ArrayLike = 0.0,
    ) -> None:
        self.goal = array("goal", goal, (2,), (3,))
        self.saturation = (
            None if saturation is None else _checks.scalar("saturation", saturation, above=0.0)
        )
        self.terminal_weight = _checks.scalar("terminal_weight", terminal_weight, at_least=0.0)

    def _error(self, state: State) -> Scalar:
        """Compute the distance, with the saturation if there is one [m]."""
        distance = with_overrun(state, length(*offset(state, self.goal)))
        if self.saturation is None:
            return distance
        return distance * (self.saturation / (self.saturation + distance))


class WaypointCost(ErrorCost):
    """Squared distance from a waypoint, plus a heading error that counts near it:

        d^2 + heading_weight * exp(-(d / decay)^2) * (1 - cos(yaw - heading))

    The heading counts only near the waypoint, so a robot far away may face where it drives. The
    cost is smooth everywhere and its gradient vanishes at the waypoint, so the robot settles there.
    Far away the squared distance dominates other costs: to approach from afar, use `GoalCost`.
    A robot that is too fast to stop also pays `4 e max(d, 1 m)`, with e the distance by which it
    would overrun the waypoint if it braked with half of its deceleration.

    Args:
        waypoint: (2,) or (3,) position of the waypoint [m]; the third component is compared with
            `state["z"]`.
        heading: heading at the waypoint [rad]; any heading when absent.
        heading_weight: half the cost of facing the opposite way at the waypoint [m^2].
        decay: distance at which the heading counts 1/e as much as at the waypoint [m].
        terminal_weight: factor on the additional cost of the last state.
        is_symmetric: whether the opposite heading is as good, for a robot with two fronts; static.
            The heading error is then `(1 - cos(2 (yaw - heading))) / 4`, which grows alike near
            either heading.

    Raises:
        ValueError: a waypoint of the wrong shape, a decay that is not positive, a negative weight.
            When traced, a third component for a model without `z`.
    """

    waypoint: Float[Array, " D"]
    heading: Scalar | None
    heading_weight: Scalar
    decay: Scalar
    terminal_weight: Scalar
    is_symmetric: bool = eqx.field(static=True)

    def __init__(
        self,
        waypoint: Vector,
        heading: ArrayLike | None = None,
        heading_weight: ArrayLike = 1.0,
        decay: ArrayLike = 1.0,
        terminal_weight: ArrayLike = 0.0,
        is_symmetric: bool = False,
    ) -> None:
        self.is_symmetric = _kinds.flag("is_symmetric", is_symmetric)
        self.waypoint = array("waypoint", waypoint, (2,), (3,))
        self.heading = None if heading is None else _checks.scalar("heading", heading)
        self.heading_weight = _checks.scalar("heading_weight", heading_weight, at_least=0.0)
        self.decay = _checks.scalar("decay", decay, above=0.0)
        self.terminal_weight = _checks.scalar("terminal_weight", terminal_weight, at_least=0.0)

    def _error(self, state: State) -> Scalar:
        away = length(*offset(state, self.waypoint))
        square = away * away
        braking = OVERRUN_PRICE * overrun(state, away) * jnp.maximum(away, 1.0)
        if self.heading is None:
            return square + braking
        nearness = jnp.exp(square * (-1.0 / (self.decay * self.decay)))
        # 1 - cos is smooth and does not jump where angles wrap.
        error = state.heading - self.heading
        if self.is_symmetric:
            turned = 0.25 * (1.0 - sin_cos(2.0 * error)[1])
        else:
            turned = 1.0 - sin_cos(error)[1]
        return square + braking + self.heading_weight * nearness * turned


class ReferenceCost(Cost):
    """Squared distance from a reference position at each time, `|p - r(t)|^2` [m^2].

    `r(t)` is linear between rows, and the last row holds after its time.

    Args:
        reference: (T, 2) or (T, 3) reference positions, row i at `i * period` from now [m]; the
            third column is compared with `state["z"]`. It is a leaf: another reference of T rows
            does not recompile.
        period: time between rows [s].

    Raises:
        ValueError: a reference of the wrong shape, a period that is not positive. When traced, a
            third column for a model without `z`.
    """

    reference: Float[Array, "T D"]
    period: Scalar

    def __init__(self, reference: Rows, period: ArrayLike) -> None:
        self.reference = array("reference", reference, ("T", 2), ("T", 3))
        self.period = _checks.scalar("period", period, above=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the squared distance at the time when the state is reached."""
        # Clipped before interpolating, so that the last row holds after its time.
        last = self.reference.shape[0] - 1
        row = jnp.clip(t / self.period, 0.0, last)
        before = jnp.floor(row)
        index = before.astype(jnp.int32)
        start, end = self.reference[index], self.reference[jnp.minimum(index + 1, last)]
        return squared_length(*offset(state, start + (row - before) * (end - start)))


class PathCost(Cost):
    """Squared distance from a polyline, with optional errors of heading and speed along it:

        |p - q|^2 + heading_weight * (1 - cos(yaw - psi))
                  + speed_weight * (v cos(yaw - psi) - speed)^2

    with q the nearest point on the polyline and psi the direction of its segment; of segments that
    are equally near, the first counts. Without `speed` nothing makes the robot move. The speed is
    also wanted at the end of the path: to stop there, use `ReferenceCost`, or the last point as a
    goal.

    Args:
        points: (N, 2) corners in the order in which to pass them, N >= 2 [m]. Repeated corners do
            not change the cost, so a short path can be padded to N with its last corner.
        heading_weight: half the cost of facing backwards [m^2]; any heading when absent.
        speed: wanted speed along the path [m/s]; any speed when absent.
        speed_weight: cost of a speed error of 1 m/s [m^2].

    Raises:
        ValueError: fewer than two points or a wrong shape, a negative weight.
    """

    points: Float[Array, "N 2"]
    heading_weight: Scalar | None
    speed: Scalar | None
    speed_weight: Scalar

    def __init__(
        self,
        points: Rows,
        heading_weight: ArrayLike | None = None,
        speed: ArrayLike | None = None,
        speed_weight: ArrayLike = 1.0,
    ) -> None:
        self.points = array("points", points, ("N", 2))
        if self.points.shape[0] < 2:
            raise ValueError(f"points has shape {self.points.shape}; accepted: (N, 2) with N >= 2")
        self.heading_weight = (
            None
            if heading_weight is None
            else _checks.scalar("heading_weight", heading_weight, at_least=0.0)
        )
        self.speed = None if speed is None else _checks.scalar("speed", speed)
        self.speed_weight = _checks.scalar("speed_weight", speed_weight, at_least=0.0)

    def stage(self, state: State, control: ControlVector, t: Scalar, belief: Any) -> Scalar:
        """Compute the cost of the errors of position, heading and speed."""
        segments = self.points[1:] - self.points[:-1]
        squares = jnp.sum(segments * segments, axis=1)
        is_line = squares > 0.0
        # Repeated corners make segments of length 0, whose inverse must not become infinite.
        inverse = jnp.where(is_line, 1.0 / jnp.where(is_line, squares, 1.0), 0.0)

        def squared_distance(segment: tuple[Array, Array, Array]) -> Scalar:
            start, along, scale = segment
            x, y = offset(state, start)
            share = jnp.clip((x * along[0] + y * along[1]) * scale, 0.0, 1.0)
            return squared_length(x - share * along[0], y - share * along[1])

        total, nearest = least(squared_distance, (self.points[:-1], segments, inverse))
        if self.heading_weight is None and self.speed is None:
            return total
        # A repeated corner makes a segment of length 0, which has no direction. It takes that of
        # the last segment before it that has one.
        lines = jnp.where(is_line, jnp.arange(is_line.size), jnp.argmax(is_line))
        source = jax.lax.cummax(lines)
        direction = (segments * jnp.sqrt(inverse)[:, None])[source][nearest]
        yaw = state.heading
        sin, cos = sin_cos(yaw)
        facing = cos * direction[0] + sin * direction[1]
        if self.heading_weight is not None:
            total = total + self.heading_weight * (1.0 - facing)
        if self.speed is not None:
            excess = state.speed * facing - self.speed
            total = total + self.speed_weight * excess * excess
        return total


class StateCost(ErrorCost):
    """Squared error of named state components: the diagonal Q of a linear-quadratic regulator.

        sum_i w_i e_i,   e_i = (x_i - target_i)^2,  or 2 (1 - cos(x_i - target_i)) for an angle

    For an angle, full turns do not count; small errors cost the same in both forms.

    Args:
        weights: weights w_i by name of the component [1 / unit of the component squared]; the names
            are static.
        target: target values by name; 0 where absent.
        angles: names of the components that are angles; static.
        terminal_weight: factor on the additional cost of the last state.

    Raises:
        ValueError: no weight at all or a negative one, a target or angle without a weight. When
            traced, a name that the model does not have.
    """

    weights: dict[str, Scalar]
    target: dict[str, Scalar]
    terminal_weight: Scalar
    angles: tuple[str, ...] = eqx.field(static=True)

    def __init__(
        self,
        weights: Mapping[str, ArrayLike],
        target: Mapping[str, ArrayLike] | None = None,
        angles: Sequence[str] = (),
        terminal_weight: ArrayLike = 0.0,
    ) -> None:
        self.weights = by_name("weights", weights, at_least=0.0)
        if not self.weights:
            raise ValueError(f"weights is {weights!r}; accepted: one weight or more")
        wanted = by_name("target", target)
        names_within("target", list(wanted), self.weights)
        if not isinstance(angles, (list, tuple)):
            given = _kinds.describe(angles)
            raise ValueError(f"angles is {given}; accepted: names of angles, such as ('yaw',)")
        names_within("angles", angles, self.weights)
        self.target = {name: wanted.get(name, jnp.zeros(())) for name in self.weights}
        # The names are static: sorted, so that another order does not recompile.
        self.angles = tuple(sorted(set(angles)))
        self.terminal_weight = _checks.scalar("terminal_weight", terminal_weight, at_least=0.0)

    def _error(self, state: State) -> Scalar:
        total = jnp.zeros(())
        for name, weight in self.weights.items():
            error = state[name] - self.target[name]
            square = 2.0 * (1.0 - sin_cos(error)[1]) if name in self.angles else error * error
            total = total + weight * square
        return total
