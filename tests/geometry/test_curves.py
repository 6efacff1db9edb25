"""Curves against closed forms, SciPy and fine numerical integration."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.interpolate import Akima1DInterpolator, CubicSpline, PchipInterpolator
from scipy.special import ellipe, fresnel

from jaxplore.geometry.curves import (
    BOUNDARIES,
    METHODS,
    arc_path,
    clothoid_path,
    line_path,
    path_through,
)

WAYPOINTS = np.array([(0, 0), (10, 0), (20, 5), (30, 0), (40, -5), (50, 0)], float)
LOOP = np.array([(0, 0), (8, -1), (12, 4), (6, 6), (2, 5)], float)
CHORDS = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(WAYPOINTS, axis=0).T))])


def places(path, phi) -> np.ndarray:
    return np.asarray(
        jax.jit(jax.vmap(lambda s: path.at(s).position))(jnp.asarray(phi, jnp.float32))
    )


def test_a_line() -> None:
    path = line_path([1, 2], [4, 6])
    assert float(path.length) == pytest.approx(5.0)
    np.testing.assert_allclose(places(path, [2.5]), [[2.5, 4.0]], rtol=1e-6)


@pytest.mark.parametrize("angle", [2.0, -2 * np.pi, 2 * np.pi])
def test_an_arc_is_on_its_circle(angle: float) -> None:
    path = arc_path([1.0, -2.0, 0.7], 3.0, angle)
    assert float(path.length) == pytest.approx(3.0 * abs(angle))
    assert path.is_closed == (abs(angle) == 2 * np.pi)
    side = np.sign(angle)
    centre = np.array([1.0, -2.0]) + 3.0 * side * np.array([-np.sin(0.7), np.cos(0.7)])
    phi = np.linspace(0.0, float(path.length), 50)
    spokes = places(path, phi) - centre
    np.testing.assert_allclose(np.hypot(*spokes.T), 3.0, rtol=1e-5)
    angles = 0.7 + side * (phi / 3.0 - 0.5 * np.pi)
    np.testing.assert_allclose(
        spokes, 3.0 * np.stack([np.cos(angles), np.sin(angles)], -1), atol=2e-5
    )
    np.testing.assert_allclose(path.at(jnp.asarray(1.0)).curvature, side / 3.0, rtol=1e-3)


def test_a_clothoid_is_that_of_the_fresnel_integrals() -> None:
    path = clothoid_path([0, 0, 0], [(2.0, 0.0, 1.5)])
    scale = np.sqrt(np.pi * 2.0 / 1.5)
    phi = np.linspace(0.0, 2.0, 21)
    sines, cosines = fresnel(phi / scale)
    np.testing.assert_allclose(places(path, phi), scale * np.stack([cosines, sines], -1), atol=3e-6)
    np.testing.assert_allclose(path.at(jnp.asarray(1.0)).curvature, 0.75, rtol=2e-3)


def test_pieces_join_without_a_corner() -> None:
    turn = [(1.0, 0.0, 1.0), (0.5 * np.pi - 1.0, 1.0, 1.0), (1.0, 1.0, 0.0)]
    path = clothoid_path(
        [0, 0, 0], [piece for _ in range(4) for piece in ((2.0, 0.0, 0.0), *turn)], is_closed=True
    )
    assert path.is_closed
    headings = jax.vmap(lambda s: path.at(s).heading)(jnp.linspace(0.0, path.length, 2000))
    steps = np.diff(np.unwrap(np.asarray(headings)))
    assert np.abs(steps).max() <= 1.1 * float(path.length) / 1999
    np.testing.assert_allclose(np.sum(steps), 2 * np.pi, rtol=1e-4)


def test_an_ellipse_has_its_circumference() -> None:
    t = np.linspace(0.0, 2 * np.pi, 60, endpoint=False)
    path = path_through(np.stack([3 * np.cos(t), 2 * np.sin(t)], -1), is_closed=True)
    np.testing.assert_allclose(path.length, 12.0 * ellipe(1.0 - 4.0 / 9.0), rtol=2e-6)
    x, y = places(path, np.linspace(-5.0, 40.0, 500)).T
    np.testing.assert_allclose((x / 3) ** 2 + (y / 2) ** 2, 1.0, atol=1e-5)


def spline_of(method: str, boundary: str):
    if method == "cubic":
        return CubicSpline(CHORDS, WAYPOINTS, bc_type=boundary)
    return {"monotone": PchipInterpolator, "akima": Akima1DInterpolator}[method](CHORDS, WAYPOINTS)


@pytest.mark.parametrize(
    ("method", "boundary"),
    [
        *(("cubic", boundary) for boundary in BOUNDARIES),
        ("monotone", "natural"),
        ("akima", "natural"),
    ],
)
def test_splines_are_scipy_s_by_their_arc_length(method: str, boundary: str) -> None:
    path, spline = (
        path_through(WAYPOINTS, method=method, boundary=boundary),
        spline_of(method, boundary),
    )

    def speed(value: float) -> float:
        return float(np.hypot(*spline(value, 1)))

    for value in (0.0, 4.0, 17.0, 31.0, 52.0):
        bounds = [*CHORDS[value > CHORDS], value]
        arc = sum(quad(speed, low, high)[0] for low, high in itertools.pairwise(bounds))
        np.testing.assert_allclose(places(path, [arc])[0], spline(value), atol=2e-4)


def test_a_closed_cubic_has_no_corner_where_it_closes() -> None:
    path = path_through(WAYPOINTS[:4], is_closed=True)
    ends = [path.at(path.length * share) for share in (1e-5, 1.0 - 1e-5)]
    np.testing.assert_allclose(ends[0].heading, ends[1].heading, atol=2e-2)
    np.testing.assert_allclose(ends[0].curvature, ends[1].curvature, rtol=5e-2)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("is_closed", [False, True])
def test_a_path_passes_its_waypoints_in_order(method: str, is_closed: bool) -> None:
    points = LOOP if is_closed else WAYPOINTS
    path = path_through(points, method=method, is_closed=is_closed)
    phi = np.array([path.nearest(jnp.asarray(point, jnp.float32)) for point in points])
    np.testing.assert_allclose(places(path, phi), points, atol=2e-3)
    assert (np.diff(phi[1:]) > 0.0).all()


def test_monotone_stays_between_waypoints() -> None:
    steps = [(0, 0), (1, 0), (2, 3), (3, 3)]
    ys = {
        method: places(path_through(steps, method=method), np.linspace(0, 5, 300))[:, 1]
        for method in METHODS
    }
    assert ys["monotone"].max() <= 3.0 + 1e-4
    assert ys["monotone"].min() >= -1e-4
    assert ys["cubic"].max() > 3.01


def test_two_waypoints_are_a_line() -> None:
    for method in METHODS:
        path = path_through([(0, 0), (3, 4)], method=method)
        np.testing.assert_allclose(places(path, [2.5]), [[1.5, 2.0]], atol=1e-5)


@pytest.mark.parametrize("method", METHODS)
def test_a_path_turns_back_in_its_cusps(method: str) -> None:
    """There and back, then there again: the waypoints at both ends are stops."""
    there, back = np.array([(0, 0), (1, 0.2), (2, 0)]), np.array([(1, 0.5), (0, 0.6)])
    points = np.concatenate([there, back, [(1, 1), (2, 1)]])
    path = path_through(points, method=method)
    legs = [there, np.concatenate([there[-1:], back]), points[4:]]
    lengths = [float(path_through(each, method=method).length) for each in legs]
    np.testing.assert_allclose(path.stops, np.cumsum(lengths)[:2], rtol=1e-5)
    assert float(path.length) == pytest.approx(sum(lengths), rel=1e-5)
    # The table is rounded off between the nodes beside a cusp only.
    np.testing.assert_allclose(places(path, path.stops), points[[2, 4]], atol=0.02)
    fine = places(path, np.linspace(0.0, float(path.length), 2000))
    away = np.hypot(*(fine[:, None] - points).transpose(2, 0, 1)).min(axis=0)
    assert away.max() < 0.02
    before, after = (path.at(path.stops[0] + sign * 0.2).heading for sign in (-1.0, 1.0))
    assert np.cos(float(before) - float(after)) < -0.5


def test_a_tight_turn_and_a_closed_path_have_no_cusps() -> None:
    turn = np.linspace(-np.pi / 2, np.pi / 2, 9)
    bend = np.concatenate(
        [[(-2, -0.3)], 0.3 * np.stack([np.cos(turn), np.sin(turn)], -1), [(-2, 0.3)]]
    )
    assert path_through(bend).stops.shape == (0,)
    assert path_through(LOOP, is_closed=True).stops.shape == (0,)


def test_widths_are_those_at_the_waypoints() -> None:
    widths = np.stack([np.linspace(1, 2, 6), np.linspace(3, 2, 6)], -1)
    path = path_through(WAYPOINTS, half_widths=widths)
    for index in (0, 2, 5):
        phi = path.nearest(jnp.asarray(WAYPOINTS[index], jnp.float32))
        np.testing.assert_allclose(path.room(phi), widths[index], atol=1e-2)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (
            lambda: path_through([(0, 0)]),
            r"points has shape \(1, 2\); accepted: \(M, 2\) with M >= 2",
        ),
        (lambda: path_through([(0, 0), (1, 1)], is_closed=True), "with M >= 3"),
        (lambda: path_through([(0, 0), (1, 1), (1, 1)]), r"points\[2\] is \[1.0, 1.0\]"),
        (lambda: path_through([(0, 0), (1, 1), (2, 0), (0, 0)], is_closed=True), r"points\[0\] is"),
        (
            lambda: path_through(WAYPOINTS, half_widths=[[1, 1]] * 3),
            r"half_widths has shape \(3, 2\)",
        ),
        (lambda: line_path([1, 1], [1, 1]), "end is"),
        (lambda: arc_path([0, 0, 0], 1.0, 0.0), "angle is 0.0"),
        (lambda: clothoid_path([0, 0, 0], []), "pieces is empty"),
        (lambda: clothoid_path([0, 0, 0], [(1.0, np.nan, 1.0)]), r"pieces\[0\] curvature is nan"),
        (
            lambda: clothoid_path([0, 0, 0], [(1.0, 1.0, 1.0)], is_closed=True),
            "pieces turn by 1 rad",
        ),
    ],
)
def test_bad_curves(build, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        build()
