"""Build paths from lines, arcs, clothoids and splines through waypoints."""

import itertools
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss

from jaxplore import _checks, _kinds
from jaxplore._types import Rows, Vector
from jaxplore.geometry.path import MOST_NODES, Path, count_nodes

METHODS = ("cubic", "monotone", "akima")
CUSP_SPACING = 0.05
"""Greatest distance between the nodes of a path with cusps [m]."""
BOUNDARIES = ("not-a-knot", "natural", "clamped")

Function = Callable[[np.ndarray], np.ndarray]
Piece = tuple[float, float, float]
"""Length [m], curvature at the start [1/m], curvature at the end [1/m]."""


def line_path(start: Vector, end: Vector, *, half_widths: Rows | None = None) -> Path:
    """Return the straight path between two points.

    Args:
        start: first point (x, y) [m].
        end: last point (x, y) [m].
        half_widths: free width to the left and right of the path; see `Path`.

    Raises:
        ValueError: equal points, or a point that is not two finite numbers.
    """
    first, last = (
        np.asarray(_checks.vector(name, value, 2), np.float64)
        for name, value in (("start", start), ("end", end))
    )
    length = float(np.hypot(*(last - first)))
    if length == 0.0:
        raise ValueError(f"end is {end!r}, which is start; accepted: another point")
    along = (last - first) / length
    return Path(
        lambda phi: first + phi[:, None] * along,
        lambda phi: np.broadcast_to(along, (phi.size, 2)),
        length,
        num_nodes=count_nodes(length, np.zeros(1)),
        half_widths=half_widths,
    )


def arc_path(
    start: Vector, radius: float, angle: float, *, half_widths: Rows | None = None
) -> Path:
    """Return an arc of a circle; a full turn gives a closed path.

    Args:
        start: pose (x, y, heading) at which the arc begins [m, m, rad].
        radius: radius of the circle [m].
        angle: change of the heading along the arc, positive to the left [rad].
        half_widths: free width to the left and right of the path; see `Path`.

    Raises:
        ValueError: a radius that is not positive, an angle of 0 or of more than a full turn.
    """
    size = _checks.number("radius", radius, above=0.0)
    turn = _checks.number("angle", angle, at_least=-math.tau, at_most=math.tau)
    if turn == 0.0:
        raise ValueError("angle is 0.0; accepted: another number [rad], or `line_path`")
    bend = math.copysign(1.0 / size, turn)
    return clothoid_path(
        start,
        [(abs(turn) * size, bend, bend)],
        is_closed=abs(turn) == math.tau,
        half_widths=half_widths,
    )


def clothoid_path(
    start: Vector,
    pieces: Sequence[Piece],
    *,
    is_closed: bool = False,
    half_widths: Rows | None = None,
) -> Path:
    """Return a path of pieces with linearly changing curvature: lines, arcs and clothoids.

    For a piece of length l whose curvature goes from k_0 to k_1, with s the arc length from its
    start,

        theta(s) = theta_0 + k_0 s + (k_1 - k_0) s^2 / (2 l)
        p(s) = p_0 + integral from 0 to s of (cos theta, sin theta)

    The integral is a Fresnel integral without closed form; it is evaluated by Gauss-Legendre
    quadrature. If the curvature is continuous between pieces, a car can follow the path without
    stopping to steer.

    Args:
        start: pose (x, y, heading) at which the path begins [m, m, rad].
        pieces: length [m], curvature at the start and curvature at the end [1/m] of each piece;
            positive curvature turns left.
        is_closed: whether the path ends at its start, with the same heading.
        half_widths: free width to the left and right of the path; see `Path`.

    Raises:
        ValueError: no pieces, a piece that is not a positive length and two finite curvatures, a
            closed path that does not end at its start.
    """
    _kinds.flag("is_closed", is_closed)
    x, y, heading = np.asarray(_checks.vector("start", start, 3), np.float64).tolist()
    accepted = "rows of a length and two curvatures"
    if not isinstance(pieces, (list, tuple, np.ndarray)):
        raise ValueError(f"pieces is {_kinds.describe(pieces)}; accepted: {accepted}")
    for piece in pieces:
        if not isinstance(piece, (list, tuple, np.ndarray)) or len(piece) != 3:
            raise ValueError(f"pieces has {_kinds.describe(piece)}; accepted: {accepted}")
    rows = [
        (
            _checks.number(f"pieces[{index}] length", piece[0], above=0.0),
            _checks.number(f"pieces[{index}] curvature", piece[1]),
            _checks.number(f"pieces[{index}] curvature", piece[2]),
        )
        for index, piece in enumerate(pieces)
    ]
    if not rows:
        raise ValueError("pieces is empty; accepted: at least one")
    lengths, bends, ends = np.array(rows).T
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    turns = 0.5 * lengths * (bends + ends)
    headings = heading + np.concatenate([[0.0], np.cumsum(turns)])
    total = float(starts[-1])
    count = count_nodes(total, np.concatenate([bends, ends]))

    def theta(phi: np.ndarray) -> np.ndarray:
        piece = np.clip(np.searchsorted(starts, phi, side="right") - 1, 0, len(rows) - 1)
        s = phi - starts[piece]
        rate = (ends - bends)[piece] / lengths[piece]
        turned: np.ndarray = s * (bends[piece] + 0.5 * rate * s)
        return np.asarray(headings[piece] + turned)

    def direction(phi: np.ndarray) -> np.ndarray:
        return np.stack([np.cos(theta(phi)), np.sin(theta(phi))], -1)

    def position(phi: np.ndarray) -> np.ndarray:
        # The quadrature is exact only for smooth integrands, and curvature may jump between
        # pieces: no interval may span two of them.
        knots = np.union1d(starts, phi)
        places = np.array([x, y]) + _integrals(direction, knots)
        return np.asarray(places[np.searchsorted(knots, phi)])

    # `Path` checks that the end points meet; only here is it known that the headings do as well.
    if is_closed:
        turned = headings[-1] - heading
        if not math.isclose(turned, math.tau * round(turned / math.tau), abs_tol=1e-6):
            raise ValueError(f"pieces turn by {turned:.6g} rad; accepted: whole turns, when closed")
    return Path(
        position, direction, total, is_closed=is_closed, num_nodes=count, half_widths=half_widths
    )


def path_through(
    points: Rows,
    *,
    method: str = "cubic",
    boundary: str = "natural",
    is_closed: bool = False,
    half_widths: Rows | None = None,
) -> Path:
    """Return a smooth path through waypoints, parameterised by its true arc length.

    x and y are splines over the accumulated chord length (SciPy). The arc length is integrated and
    inverted numerically. Where an open path turns by more than 135 degrees at a waypoint, it has a
    cusp: two splines meet there, and the waypoint is one of `Path.stops`.

    | method | between waypoints |
    | --- | --- |
    | "cubic" | twice differentiable: continuous curvature; may overshoot between waypoints |
    | "monotone" | once differentiable (PCHIP): x and y stay between those of the waypoints |
    | "akima" | once differentiable: less overshoot than "cubic", smoother turns than "monotone" |

    Args:
        points: waypoints (M, 2) in order [m]. M >= 2; for a closed path M >= 3, and the first point
            is not repeated at the end.
        method: name of the spline, from the table.
        boundary: end condition of an open cubic spline: "natural" (zero curvature at the ends, so a
            robot at the start need not turn at once), "not-a-knot" or "clamped" (zero derivative at
            the ends). A closed cubic spline is periodic.
        is_closed: whether the path returns to the first point.
        half_widths: free width to the left and right of the path [m]: two numbers, or (M, 2) with
            one row for each waypoint.

    Raises:
        ValueError: too few points, points that are not finite, the same point twice in a row, an
            unknown method or boundary, half widths that are not positive.
    """
    _kinds.flag("is_closed", is_closed)
    knots = _waypoints(points, is_closed)
    if method not in METHODS:
        raise ValueError(f"method is {method!r}; accepted: {', '.join(METHODS)}")
    if boundary not in BOUNDARIES:
        raise ValueError(f"boundary is {boundary!r}; accepted: {', '.join(BOUNDARIES)}")
    ends = np.concatenate([[0], [] if is_closed else cusps(knots), [len(knots) - 1]]).astype(int)
    curves = [
        _curve(knots[first : last + 1], method, boundary, is_closed)
        for first, last in itertools.pairwise(ends.tolist())
    ]
    curve = _join(curves) if len(curves) > 1 else curves[0]
    count = count_nodes(curve.length, curve.curvature)
    stops = np.cumsum([each.length for each in curves])[:-1]
    if stops.size:
        # Between the nodes beside a cusp the table is rounded off.
        count = min(max(count, 1 + math.ceil(curve.length / CUSP_SPACING)), MOST_NODES)
    return Path(
        curve.position,
        curve.direction,
        curve.length,
        is_closed=is_closed,
        num_nodes=count,
        half_widths=_widths_along(half_widths, knots, is_closed, curve, count),
        stops=stops,
    )


def cusps(points: np.ndarray) -> np.ndarray:
    """Return the indices of the points (M, 2) at which a line turns back: by more than 135 degrees.

    No two points in a row may be equal.
    """
    steps = np.diff(points, axis=0)
    steps = steps / np.hypot(*steps.T)[:, None]
    return np.flatnonzero((steps[1:] * steps[:-1]).sum(axis=1) < -math.sqrt(0.5)) + 1


class _Curve(NamedTuple):
    """A curve by its arc length, its length, the curvature at many points, the chord length at an
    arc length, and that at the waypoints."""

    position: Function
    direction: Function
    length: float
    curvature: np.ndarray
    parameter: Function
    at: np.ndarray


def _curve(knots: np.ndarray, method: str, boundary: str, is_closed: bool) -> _Curve:
    chords = np.hypot(*np.diff(knots, axis=0).T)
    at = np.concatenate([[0.0], np.cumsum(chords)])
    spline, slope, second = _spline(at, knots, method, boundary, is_closed)

    def speed(values: np.ndarray) -> np.ndarray:
        return np.asarray(np.hypot(*slope(values).T))

    # Tabulate the arc length at many parameters of every piece. `parameter` inverts it by Newton's
    # method, from a linear guess between two entries.
    fine = np.unique(np.concatenate([np.linspace(a, b, 33) for a, b in itertools.pairwise(at)]))
    arc = _integrals(lambda values: speed(values)[:, None], fine)[:, 0]
    total = float(arc[-1])

    def parameter(phi: np.ndarray) -> np.ndarray:
        values = np.interp(phi, arc, fine)
        for _ in range(4):
            index = np.clip(np.searchsorted(fine, values, side="right") - 1, 0, fine.size - 2)
            passed = arc[index] + _integrate_between(speed, fine[index], values)
            rate = speed(values)
            # At a clamped end the speed is 0, and a Newton step would be infinite.
            step = np.where(rate > 0.0, (phi - passed) / np.where(rate > 0.0, rate, 1.0), 0.0)
            values = np.clip(values + step, at[0], at[-1])
        return np.asarray(values)

    def direction(phi: np.ndarray) -> np.ndarray:
        values = parameter(phi)
        tangent = slope(values)
        size = np.hypot(*tangent.T)
        # The derivative of a clamped end is zero: take the direction from the second derivative.
        still = size < 1e-9
        tangent = np.where(still[:, None], second(values) * _sign_at(values, at), tangent)
        return np.asarray(tangent / np.hypot(*tangent.T)[:, None])

    # The table must resolve the sharpest bend, so its size follows from the curvature. The bound on
    # the speed keeps the curvature finite at a clamped end.
    first, bend = slope(fine), second(fine)
    size = np.maximum(np.hypot(*first.T), 1e-3)
    curvature = (first[:, 0] * bend[:, 1] - first[:, 1] * bend[:, 0]) / size**3
    return _Curve(lambda phi: spline(parameter(phi)), direction, total, curvature, parameter, at)


def _join(curves: list[_Curve]) -> _Curve:
    starts = np.concatenate([[0.0], np.cumsum([each.length for each in curves])])
    chords = np.concatenate([[0.0], np.cumsum([each.at[-1] for each in curves])])

    def pieces(phi: np.ndarray, values: Callable[[_Curve, np.ndarray, int], np.ndarray]) -> Any:
        index = np.clip(np.searchsorted(starts, phi, side="right") - 1, 0, len(curves) - 1)
        parts = [
            values(each, np.clip(phi - starts[i], 0.0, each.length), i)
            for i, each in enumerate(curves)
        ]
        shape = (-1,) + (1,) * (parts[0].ndim - 1)
        return np.choose(index.reshape(shape), parts)

    return _Curve(
        lambda phi: pieces(phi, lambda each, own, _: each.position(own)),
        lambda phi: pieces(phi, lambda each, own, _: each.direction(own)),
        float(starts[-1]),
        np.concatenate([each.curvature for each in curves]),
        lambda phi: pieces(phi, lambda each, own, i: each.parameter(own) + chords[i]),
        np.concatenate(
            [curves[0].at, *(e.at[1:] + c for e, c in zip(curves[1:], chords[1:-1], strict=True))]
        ),
    )


def _sign_at(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    # At the end of the path the second derivative points backwards.
    return np.where(values > 0.5 * (at[0] + at[-1]), -1.0, 1.0)[:, None]


def _spline(
    at: np.ndarray, knots: np.ndarray, method: str, boundary: str, is_closed: bool
) -> tuple[Function, Function, Function]:
    """Return a spline (N,) -> (N, 2) through the knots, and its first two derivatives."""
    # Slow to import, and few need it.
    from scipy.interpolate import Akima1DInterpolator, CubicSpline, PchipInterpolator

    if method == "cubic":
        kind: Any = "periodic" if is_closed else boundary
        spline: Any = CubicSpline(at, knots, bc_type=kind)
    else:
        build = PchipInterpolator if method == "monotone" else Akima1DInterpolator
        if is_closed:
            # Neither spline has a periodic form in SciPy. Go round three times and use the middle
            # lap, whose ends then join smoothly.
            at = np.concatenate([at[:-1] - at[-1], at[:-1], at + at[-1]])
            knots = np.concatenate([knots[:-1], knots[:-1], knots])
        spline = build(at, knots)
    return spline, spline.derivative(), spline.derivative(2)


def _waypoints(points: Rows, is_closed: bool) -> np.ndarray:
    least = 3 if is_closed else 2
    _checks.floats("points", points, f"(M, 2) with M >= {least}")
    given = np.asarray(points, np.float64)
    if given.ndim != 2 or given.shape[1] != 2 or len(given) < least:
        raise ValueError(f"points has shape {given.shape}; accepted: (M, 2) with M >= {least}")
    if not np.isfinite(given).all():
        value = float(given[~np.isfinite(given)][0])
        raise ValueError(f"points has a value {value}; accepted: finite numbers [m]")
    knots = np.concatenate([given, given[:1]]) if is_closed else given
    same = np.flatnonzero((np.diff(knots, axis=0) == 0.0).all(axis=1))
    if same.size:
        index = int(same[0])
        raise ValueError(
            f"points[{(index + 1) % len(given)}] is {given[index].tolist()}, which is the point "
            "before it; accepted: no point twice in a row"
        )
    return knots


def _widths_along(
    half_widths: Rows | None,
    knots: np.ndarray,
    is_closed: bool,
    curve: _Curve,
    count: int,
) -> Rows | None:
    """Interpolate the half widths of the waypoints at `count` equally spaced arc lengths."""
    if half_widths is None:
        return None
    _checks.floats("half_widths", half_widths, "(2,) or a row for each waypoint")
    given = np.asarray(half_widths, np.float64)
    if given.shape == (2,):
        return given
    number = len(knots) - is_closed
    if given.shape != (number, 2):
        raise ValueError(
            f"half_widths has shape {given.shape}; accepted: (2,) or ({number}, 2), a row for each "
            "waypoint"
        )
    if not (given > 0.0).all():
        value = float(given[~(given > 0.0)][0])
        raise ValueError(f"half_widths has a value {value}; accepted: positive numbers [m]")
    rows = np.concatenate([given, given[:1]]) if is_closed else given
    values = curve.parameter(np.linspace(0.0, curve.length, count))
    return np.stack([np.interp(values, curve.at, side) for side in rows.T], -1)


NODES, WEIGHTS = leggauss(8)
"""Points and weights of Gauss-Legendre quadrature, exact for polynomials up to degree 15."""


def _integrate_between(rate: Function, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Integrate a function (N,) between pairs of bounds, by Gauss-Legendre quadrature."""
    half, middle = 0.5 * (high - low), 0.5 * (high + low)
    values = rate((middle[:, None] + half[:, None] * NODES).ravel()).reshape(-1, NODES.size)
    return np.asarray(half * (values @ WEIGHTS))


def _integrals(rate: Function, at: np.ndarray) -> np.ndarray:
    """Return the integrals (N, D) of a function from the first of increasing values to each."""
    half, middle = 0.5 * np.diff(at), 0.5 * (at[1:] + at[:-1])
    values = rate((middle[:, None] + half[:, None] * NODES).ravel())
    values = values.reshape(len(half), NODES.size, -1)
    pieces = half[:, None] * np.einsum("ngd,g->nd", values, WEIGHTS)
    return np.concatenate([np.zeros((1, pieces.shape[1])), np.cumsum(pieces, axis=0)])
