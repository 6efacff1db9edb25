"""Represent reference paths by arc length, and measure contouring and lag errors from them."""

import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxplore import _checks, _kinds
from jaxplore._types import Position, Rows, Scalar, Vector

NODES_PER_RADIUS = 10.0
"""Nodes per smallest radius of curvature, which keeps the interpolation error below 1e-6 radii."""
LEAST_NODES, MOST_NODES = 65, 16385
NEWTON_STEPS = 4
"""Newton steps from the nearest node, at most half a spacing away; each step squares the error."""


class PathPoint(NamedTuple):
    """One point of a path.

    Args:
        x: x coordinate [m].
        y: y coordinate [m].
        cos: cosine of the heading of the path.
        sin: sine of the heading of the path.
        curvature: curvature of the path, positive to the left [1/m].
    """

    x: Scalar
    y: Scalar
    cos: Scalar
    sin: Scalar
    curvature: Scalar

    @property
    def position(self) -> Position:
        """Position (x, y) [m]."""
        return jnp.stack([self.x, self.y])

    @property
    def heading(self) -> Scalar:
        """Heading of the path [rad], counter-clockwise from the x axis."""
        return jnp.arctan2(self.sin, self.cos)

    @property
    def normal(self) -> Position:
        """Unit vector (2,) to the left of the path."""
        return jnp.stack([-self.sin, self.cos])


class PathErrors(NamedTuple):
    """Errors of a position relative to a point of a path.

    Args:
        contouring: error across the path, positive to its right [m].
        lag: error along the path, positive behind the point [m].
    """

    contouring: Scalar
    lag: Scalar


class Path(eqx.Module):
    """Planar curve, parameterised by its true arc length phi in metres from its start.

    The curve is stored as a table of points and unit tangents at equal arc lengths. Between two
    nodes, h apart, the position is a cubic Hermite polynomial in phi with the tangents as
    derivatives, so a look-up costs the same for any curve and length. Its error is below h^4 / 384
    times the fourth derivative, about (h / R)^4 R / 384 on an arc of radius R.

    An open path is extended by straight lines before its start and after its end. A closed path
    repeats: after two laps phi is twice the length, so that progress never jumps.

    Where a path turns back on itself, in a cusp, a robot must stop before it drives on in the other
    direction: `stops` are the arc lengths of these points.

    Build it with `path_through`, `line_path`, `arc_path`, `clothoid_path` or `read_path`; this
    constructor takes any function of the arc length.

    Args:
        position: NumPy function from arc lengths (N,) to points (N, 2) [m].
        direction: NumPy function from arc lengths (N,) to unit tangents (N, 2).
        length: arc length of the whole curve [m].
        is_closed: whether the end is the start; static.
        num_nodes: number of nodes in the table; static.
        half_widths: free width to the left and to the right of the path [m]: two numbers, or (M, 2)
            at equal distances from start to end. The path is unbounded by default.
        stops: arc lengths of the cusps of an open path, in order [m].

    Raises:
        ValueError: a length that is not positive, points that are not finite or beyond 32 km (see
            `jaxplore.maps.Datum`), a closed path whose ends differ or with stops, stops that do not
            rise, half widths that are not positive.
    """

    points: Float[Array, "N 2"]
    """Positions of the nodes [m]."""
    tangents: Float[Array, "N 2"]
    """Unit tangents of the path at the nodes."""
    half_widths: Float[Array, "N 2"]
    """Free width to the left and to the right at the nodes [m]; infinite where it is unbounded."""
    stops: Float[Array, " S"]
    """Arc lengths of the cusps [m]."""
    length: Scalar
    is_closed: bool = eqx.field(static=True)

    def __init__(
        self,
        position: Callable[[np.ndarray], np.ndarray],
        direction: Callable[[np.ndarray], np.ndarray],
        length: float,
        *,
        is_closed: bool = False,
        num_nodes: int = 257,
        half_widths: Rows | None = None,
        stops: Vector = (),
    ) -> None:
        accepted = "a function of arc lengths (N,) that returns (N, 2)"
        _kinds.function("position", position, accepted)
        _kinds.function("direction", direction, accepted)
        _kinds.flag("is_closed", is_closed)
        total = _checks.number("length", length, above=0.0)
        count = _checks.whole_number("num_nodes", num_nodes, at_least=2)
        along = np.linspace(0.0, total, count)
        points = np.asarray(position(along), np.float64)
        tangents = np.asarray(direction(along), np.float64)
        for name, rows in (("position", points), ("direction", tangents)):
            if rows.shape != (count, 2) or not np.isfinite(rows).all():
                raise ValueError(
                    f"{name} of {count} arc lengths is {rows!r}; accepted: finite numbers (N, 2)"
                )
        _checks.near("position", points, _checks.PATH_STEP)
        # Tangents that are off by rounding are normalised below; others are a user's mistake.
        size = np.hypot(*tangents.T)
        if not np.allclose(size, 1.0, atol=1e-3):
            worst = float(size[np.argmax(np.abs(size - 1.0))])
            raise ValueError(f"direction has length {worst:.3g}; accepted: unit vectors")
        gap = float(np.hypot(*(points[-1] - points[0])))
        if is_closed and gap > 1e-3 * total:
            raise ValueError(
                f"position(length) is {gap:.3g} m from position(0); accepted: the same point, of "
                "a closed path"
            )
        self.points = jnp.asarray(points, jnp.float32)
        self.tangents = jnp.asarray(tangents / size[:, None], jnp.float32)
        self.half_widths = _widths(half_widths, count)
        self.stops = jnp.asarray(_check_stops(stops, total, is_closed=is_closed), jnp.float32)
        self.length = jnp.asarray(total, jnp.float32)
        self.is_closed = is_closed

    @property
    def has_room(self) -> bool:
        """Whether the free width is bounded anywhere; true if the half widths are traced."""
        if _kinds.is_traced(self.half_widths):
            return True
        return bool(np.isfinite(np.asarray(self.half_widths)).any())

    def with_room(self, half_widths: Rows) -> "Path":
        """Return the same path with another free width to its left and right.

        Args:
            half_widths: free width as two numbers, or as (M, 2) at equal distances from start to
                end [m].

        Raises:
            ValueError: half widths that are not positive, or of another shape.
        """
        same: Path = eqx.tree_at(
            lambda path: path.half_widths, self, _widths(half_widths, self.points.shape[0])
        )
        return same

    @property
    def spacing(self) -> Scalar:
        """Arc length between nodes [m]."""
        return self.length / (self.points.shape[0] - 1)

    def at(self, phi: Scalar) -> PathPoint:
        """Return the point, heading and curvature of the path at an arc length [m]."""
        row, share, beyond = self._locate(_checks.of_shape("phi", phi, ()))
        h = self.spacing
        (x0, y0), (x1, y1) = self._rows(self.points, row)
        (c0, s0), (c1, s1) = self._rows(self.tangents, row)
        x, dx, ddx = _hermite(x0, h * c0, x1, h * c1, share)
        y, dy, ddy = _hermite(y0, h * s0, y1, h * s1, share)
        # The derivative of the cubic has length h only up to the interpolation error: normalise it.
        square = dx * dx + dy * dy
        inverse = 1.0 / jnp.sqrt(jnp.where(square > 0.0, square, 1.0))
        cos, sin = dx * inverse, dy * inverse
        curvature = (dx * ddy - dy * ddx) * (inverse * inverse * inverse)
        # Extend an open path by straight lines, whose curvature is zero.
        if not self.is_closed:
            x, y = x + beyond * cos, y + beyond * sin
            curvature = jnp.where(beyond == 0.0, curvature, 0.0)
        return PathPoint(x, y, cos, sin, curvature)

    def room(self, phi: Scalar) -> tuple[Scalar, Scalar]:
        """Return the free width to the left and to the right [m], linear between nodes."""
        row, share, _ = self._locate(_checks.of_shape("phi", phi, ()))
        before, after = self._rows(self.half_widths, row)
        # The difference of two infinite widths would be NaN.
        left, right = (
            jnp.where(a == b, a, a + share * (jnp.where(a == b, 0.0, b - a)))
            for a, b in zip(before, after, strict=True)
        )
        return left, right

    def errors(self, position: Position, phi: Scalar) -> PathErrors:
        """Return the contouring and lag errors of a position at an arc length.

            contouring = sin(theta) (x - x_phi) - cos(theta) (y - y_phi)
            lag = -cos(theta) (x - x_phi) - sin(theta) (y - y_phi)

        with theta the heading of the path at phi. These are the errors of model predictive
        contouring control (Lam, Manzie and Good, CDC 2010, eq. 8; Liniger et al.,
        "Optimization-based autonomous racing of 1:43 scale RC cars", 2015, eq. 9).

        Args:
            position: position of the robot (x, y) [m].
            phi: arc length of the point on the path [m].
        """
        return errors_at(self.at(phi), _checks.position("position", position))

    def offset(self, phi: Scalar, lateral: Scalar) -> Position:
        """Return the position (x, y) at an arc length, shifted to the left by `lateral` [m]."""
        _checks.of_shape("lateral", lateral, ())
        point = self.at(phi)
        return point.position + lateral * point.normal

    def nearest(
        self,
        position: Position,
        near: Scalar | None = None,
        within: tuple[Scalar, Scalar] | None = None,
    ) -> Scalar:
        """Return the arc length of the point of the path that is nearest to a position [m].

        The search takes the nearest node and refines it by Newton steps on the cubic between the
        neighbouring nodes. Of equally near points it returns the one with the smallest arc length.

        The result is in [0, length] for an open path and in [0, length) for a closed one. With
        `near`, only points within a quarter of the length from there are considered, and on a
        closed path the result is in the lap nearest to `near`.

        Args:
            position: position of the robot (x, y) [m].
            near: arc length around which the path is searched [m]; the whole path by default.
            within: arc lengths between which an open path is searched [m]; all of it by default.
        """
        position = _checks.position("position", position)
        if near is not None:
            _checks.of_shape("near", near, ())
        count = self.points.shape[0]
        h = self.spacing
        away = self.points - position
        square = away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1]
        # Exclude far nodes, so that a robot where the path crosses itself stays on its branch.
        if near is not None:
            nodes = h * jnp.arange(count, dtype=jnp.float32)
            off = nodes - near
            if self.is_closed:
                off = off - self.length * jnp.round(off / self.length)
            square = jnp.where(jnp.abs(off) <= 0.25 * self.length, square, jnp.inf)
        if within is not None:
            nodes = h * jnp.arange(count, dtype=jnp.float32)
            is_within = (nodes >= within[0] - h) & (nodes <= within[1] + h)
            square = jnp.where(is_within, square, jnp.inf)
        start = h * jnp.argmin(square).astype(jnp.float32)
        phi = start
        for _ in range(NEWTON_STEPS):
            point = self.at(phi)
            dx, dy = position[0] - point.x, position[1] - point.y
            along = dx * point.cos + dy * point.sin
            across = dy * point.cos - dx * point.sin
            # Half the squared distance has derivative -along and second derivative
            # 1 - curvature * across, which is bounded below to keep the step finite at the centre
            # of a bend.
            slope = jnp.maximum(1.0 - point.curvature * across, 0.25)
            phi = jnp.clip(phi + along / slope, start - h, start + h)
        if not self.is_closed:
            return jnp.clip(phi, *((0.0, self.length) if within is None else within))
        if near is None:
            return jnp.mod(phi, self.length)
        return phi + self.length * jnp.round((near - phi) / self.length)

    def _locate(self, phi: Scalar) -> tuple[Array, Scalar, Scalar]:
        """Return the node before an arc length, the fraction of the way to the next node, and the
        distance by which the arc length is beyond the ends of an open path [m]."""
        last = self.points.shape[0] - 2
        if self.is_closed:
            inside, beyond = phi - self.length * jnp.floor(phi / self.length), jnp.zeros(())
        else:
            inside = jnp.clip(phi, 0.0, self.length)
            beyond = phi - inside
        steps = inside / self.spacing
        row = jnp.clip(jnp.floor(steps), 0.0, last)
        # A NaN arc length reads an arbitrary row, but its fraction is NaN, and so is the result.
        return jnp.nan_to_num(row).astype(jnp.int32), steps - row, beyond

    @staticmethod
    def _rows(
        table: Float[Array, "N 2"], row: Array
    ) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
        # Return components, not vectors: mapped over K samples, each component is one vector of K.
        # `_locate` returns rows within the table, so the bounds need no check in each look-up.
        def value(index: Array, column: int) -> Scalar:
            return table.at[index, column].get(
                mode="promise_in_bounds", wrap_negative_indices=False
            )

        after = row + 1
        return (value(row, 0), value(row, 1)), (value(after, 0), value(after, 1))


def errors_at(point: PathPoint, position: Position) -> PathErrors:
    """Return the contouring and lag errors of a position (x, y) [m]: see `Path.errors`."""
    dx, dy = position[0] - point.x, position[1] - point.y
    return PathErrors(
        contouring=point.sin * dx - point.cos * dy, lag=-point.cos * dx - point.sin * dy
    )


def count_nodes(length: float, curvature: np.ndarray) -> int:
    """Return the number of table nodes for a path of a length [m] and given curvatures [1/m]."""
    sharpest = float(np.max(np.abs(curvature), initial=0.0))
    wanted = 1 + math.ceil(min(NODES_PER_RADIUS * sharpest * length, MOST_NODES))
    return min(max(wanted, LEAST_NODES), MOST_NODES)


def _hermite(
    start: Scalar, start_slope: Scalar, end: Scalar, end_slope: Scalar, share: Scalar
) -> tuple[Scalar, Scalar, Scalar]:
    """Return a cubic on [0, 1] and its first two derivatives, given its end values and slopes."""
    rise = end - start
    second = 3.0 * rise - 2.0 * start_slope - end_slope
    third = start_slope + end_slope - 2.0 * rise
    value = start + share * (start_slope + share * (second + share * third))
    first = start_slope + share * (2.0 * second + 3.0 * share * third)
    return value, first, 2.0 * second + 6.0 * share * third


def _check_stops(stops: Vector, length: float, *, is_closed: bool) -> np.ndarray:
    kind = "none, for a closed path" if is_closed else f"rising numbers in (0, {length:g}) [m]"
    given = np.asarray(_checks.floats("stops", stops, kind), np.float64).reshape(-1)
    ends = np.concatenate([[0.0], given, [length]])
    if given.size and (is_closed or not (np.diff(ends) > 0.0).all()):
        raise ValueError(f"stops is {stops!r}; accepted: {kind}")
    return given


def _widths(half_widths: Rows | None, count: int) -> Float[Array, "N 2"]:
    if half_widths is None:
        return jnp.full((count, 2), jnp.inf)
    _checks.floats("half_widths", half_widths, "(2,) or (M, 2)")
    given = np.asarray(half_widths, np.float64)
    if given.shape == (2,):
        given = given[None]
    if given.ndim != 2 or given.shape[1] != 2 or not len(given):
        raise ValueError(f"half_widths has shape {given.shape}; accepted: (2,) or (M, 2)")
    if not (given > 0.0).all():
        value = float(given[~(given > 0.0)][0])
        raise ValueError(f"half_widths has a value {value}; accepted: positive numbers [m]")
    rows = np.linspace(0.0, 1.0, len(given))
    at = np.linspace(0.0, 1.0, count)
    return jnp.asarray(np.stack([np.interp(at, rows, side) for side in given.T], -1), jnp.float32)
