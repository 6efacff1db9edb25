"""Paths by arc length, against brute force, closed forms and finite differences."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.geometry.curves import arc_path, line_path, path_through
from jaxplore.geometry.path import Path, errors_at

S_CURVE = [(0, 0), (10, 0), (20, 5), (30, 0), (40, -5), (50, 0)]
LOOP = [(0, 0), (8, -1), (12, 4), (6, 6), (2, 5)]
OPEN, CLOSED = path_through(S_CURVE), path_through(LOOP, is_closed=True)

points_at = eqx.filter_jit(lambda path, phi: jax.vmap(path.at)(phi))
nearest_to = eqx.filter_jit(lambda path, where: jax.vmap(path.nearest)(where))
nearest_around = eqx.filter_jit(lambda path, where, near: path.nearest(where, near))
errors_of = eqx.filter_jit(lambda path, where, phi: path.errors(where, phi))

positions = st.tuples(st.floats(-20, 60, width=32), st.floats(-20, 20, width=32))


def dense(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return many arc lengths and their points."""
    phi = np.linspace(0.0, float(path.length), 20001, dtype=np.float32)
    at = points_at(path, phi)
    return phi, np.stack([at.x, at.y], -1).astype(np.float64)


@pytest.mark.parametrize("path", [OPEN, CLOSED])
def test_a_metre_of_phi_is_a_metre_of_the_path(path: Path) -> None:
    _, places = dense(path)
    steps = np.hypot(*np.diff(places, axis=0).T)
    # In single precision a point is off by 4e-6 m, a step by 1e-3 of itself.
    np.testing.assert_allclose(
        steps[:-200].reshape(-1, 200).sum(axis=1) * 100.0, float(path.length), rtol=2e-4
    )
    np.testing.assert_allclose(steps.sum(), path.length, rtol=1e-5)


@pytest.mark.parametrize("path", [OPEN, CLOSED])
def test_heading_and_curvature_are_the_derivatives(path: Path) -> None:
    phi, h = np.linspace(0.5, float(path.length) - 0.5, 300, dtype=np.float32), 0.05
    here, after, before = (points_at(path, phi + shift) for shift in (0.0, h, -h))
    np.testing.assert_allclose((after.x - before.x) / (2 * h), here.cos, atol=2e-3)
    np.testing.assert_allclose((after.y - before.y) / (2 * h), here.sin, atol=2e-3)
    turned = np.unwrap(np.arctan2(after.sin, after.cos) - np.arctan2(before.sin, before.cos))
    turned = turned - 2 * np.pi * np.round(turned / (2 * np.pi))
    np.testing.assert_allclose(turned / (2 * h), here.curvature, atol=6e-3)
    np.testing.assert_allclose(np.hypot(here.cos, here.sin), 1.0, atol=1e-6)


@given(positions)
@pytest.mark.parametrize("path", [OPEN, CLOSED])
def test_the_nearest_point_is_that_of_brute_force(path: Path, where: tuple[float, float]) -> None:
    _, places = dense(path)
    least = np.hypot(*(places - where).T).min()
    phi = nearest_to(path, jnp.asarray([where], jnp.float32))
    assert 0.0 <= phi[0] <= path.length
    found = points_at(path, phi)
    away = np.hypot(found.x[0] - where[0], found.y[0] - where[1])
    np.testing.assert_allclose(away, least, atol=2e-3)
    # There the whole distance is across the path.
    if 0.1 < phi[0] < path.length - 0.1:
        errors = errors_of(path, jnp.asarray(where), phi[0])
        np.testing.assert_allclose(abs(errors.contouring), least, atol=2e-3)


@given(positions, st.floats(-5, 60, width=32), st.floats(-3, 3), positions)
def test_errors_do_not_know_where_the_world_begins(where, phi, turn, shift) -> None:
    errors = errors_of(OPEN, jnp.asarray(where), jnp.asarray(phi))
    cos, sin = np.cos(turn), np.sin(turn)
    matrix = np.array([[cos, -sin], [sin, cos]])
    moved = path_through(np.asarray(S_CURVE) @ matrix.T + shift)
    again = errors_of(moved, jnp.asarray(matrix @ where + shift, jnp.float32), jnp.asarray(phi))
    np.testing.assert_allclose(again, errors, atol=2e-3)


def test_signs_of_the_errors_by_hand() -> None:
    path = line_path([0, 0], [10, 0])
    # Two metres along and one to the left: ahead of phi = 1, left of the path.
    errors = path.errors(jnp.array([2.0, 1.0]), jnp.asarray(1.0))
    np.testing.assert_allclose(errors, (-1.0, -1.0))
    assert errors == errors_at(path.at(jnp.asarray(1.0)), jnp.array([2.0, 1.0]))


def test_an_offset_is_to_the_left_and_found_again() -> None:
    path = arc_path([0, 0, 0], 5.0, np.pi)
    phi = jnp.asarray(4.0)
    outer, inner = path.offset(phi, jnp.asarray(-1.0)), path.offset(phi, jnp.asarray(1.0))
    np.testing.assert_allclose(np.hypot(*(outer - jnp.array([0.0, 5.0]))), 6.0, rtol=1e-5)
    np.testing.assert_allclose(np.hypot(*(inner - jnp.array([0.0, 5.0]))), 4.0, rtol=1e-5)
    np.testing.assert_allclose(path.nearest(outer), 4.0, rtol=1e-5)
    np.testing.assert_allclose(path.errors(outer, phi), (1.0, 0.0), atol=1e-5)


def test_an_open_path_goes_on_straight() -> None:
    start, end = OPEN.at(jnp.asarray(-2.0)), OPEN.at(OPEN.length + 3.0)
    np.testing.assert_allclose(start.position, -2.0 * OPEN.tangents[0], atol=1e-5)
    np.testing.assert_allclose(end.position, OPEN.points[-1] + 3.0 * OPEN.tangents[-1], atol=1e-4)
    assert start.curvature == 0.0 == end.curvature


@given(st.integers(-3, 3), st.floats(0.0, 1.0, width=32))
def test_laps_are_the_same_path(lap: int, share: float) -> None:
    phi = jnp.asarray(share) * CLOSED.length
    later = phi + jnp.asarray(lap, jnp.float32) * CLOSED.length
    at = points_at(CLOSED, jnp.stack([phi, later]))
    np.testing.assert_allclose((at.x[1], at.y[1]), (at.x[0], at.y[0]), atol=1e-3)
    near = nearest_around(CLOSED, jnp.stack([at.x[0], at.y[0]]), later)
    np.testing.assert_allclose(near, later, atol=2e-3)


def test_near_keeps_to_the_branch_that_is_driven() -> None:
    # A path that comes back beside itself, 1 m away.
    turns = [(0, 0), (10, 0), (20, 0), (20.5, 0.5), (20, 1), (10, 1), (0, 1)]
    hairpin = path_through(turns, method="monotone")
    where = jnp.array([5.0, 0.6])
    assert hairpin.nearest(where) > 30.0
    np.testing.assert_allclose(hairpin.nearest(where, jnp.asarray(4.0)), 5.0, atol=0.2)


def test_a_path_that_turns_back_is_searched_between_its_stops() -> None:
    """On the way there and on the way back the nearest place is the same."""
    there = path_through([(0, 0), (1, 0), (2, 0), (1, 0), (0, 0)])
    stop, place = there.stops[0], jnp.asarray([1.2, 0.1])
    before = there.nearest(place, within=(jnp.zeros(()), stop))
    after = there.nearest(place, within=(stop, there.length))
    assert float(before) == pytest.approx(1.2, abs=0.01)
    assert float(after) == pytest.approx(2.8, abs=0.01)


@pytest.mark.parametrize("stops", [[0.0], [3.0], [1.0, 1.0], [2.0, 1.0]])
def test_stops_that_do_not_rise_within_the_path_are_refused(stops: list[float]) -> None:
    with pytest.raises(ValueError, match=r"stops is .*; accepted: rising numbers in \(0, 3\)"):
        Path(
            lambda phi: np.stack([phi, 0.0 * phi], -1),
            lambda phi: np.broadcast_to([1.0, 0.0], (phi.size, 2)),
            3.0,
            stops=stops,
        )


def test_room_is_given_to_a_path_that_came_without() -> None:
    bare = line_path([0, 0], [4, 0])
    track = bare.with_room([[1.0, 2.0], [3.0, 2.0]])
    assert track.has_room
    assert not bare.has_room
    left, right = track.room(jnp.asarray(1.0))
    assert (float(left), float(right)) == pytest.approx((1.5, 2.0))
    np.testing.assert_array_equal(track.points, bare.points)


def test_room_is_linear_between_what_is_given() -> None:
    path = line_path([0, 0], [10, 0], half_widths=[[1.0, 2.0], [3.0, 2.0]])
    np.testing.assert_allclose(path.room(jnp.asarray(2.5)), (1.5, 2.0), rtol=1e-5)
    np.testing.assert_array_equal(OPEN.room(jnp.asarray(2.5)), np.inf)


def test_derivatives_are_finite_and_those_of_the_errors() -> None:
    where, phi = jnp.array([21.0, 3.0]), jnp.asarray(20.0)
    slope = jax.jacfwd(OPEN.errors, argnums=1)(where, phi)
    h = 1e-2
    up, down = (OPEN.errors(where, phi + step) for step in (h, -h))
    numbers = [(a - b) / (2 * h) for a, b in zip(up, down, strict=True)]
    np.testing.assert_allclose(slope, numbers, atol=5e-3)


def test_what_is_no_number_stays_none() -> None:
    for bad in (jnp.nan, jnp.inf):
        assert not np.isfinite(OPEN.at(jnp.asarray(bad)).x)
        assert np.isnan(CLOSED.at(jnp.asarray(bad)).x)


def test_another_path_does_not_recompile() -> None:
    traces = 0

    @eqx.filter_jit
    def look(path: Path, phi):
        nonlocal traces
        traces += 1
        return path.at(phi)

    for end in (3.0, 5.0):
        look(line_path([0, 0], [end, 1]), jnp.asarray(1.0))
    assert traces == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"position": lambda s: s}, "position of 257 arc lengths"),
        ({"position": lambda s: np.full((s.size, 2), np.nan)}, "accepted: finite numbers"),
        ({"direction": lambda s: np.full((s.size, 2), 2.0)}, "direction has length 2.83"),
        ({"is_closed": True}, "of a closed path"),
        ({"half_widths": [1.0]}, r"half_widths has shape \(1,\); accepted: \(2,\) or \(M, 2\)"),
        ({"half_widths": [1.0, 0.0]}, "half_widths has a value 0.0; accepted: positive"),
        ({"half_widths": [1.0, np.nan]}, "half_widths has a value nan; accepted: positive"),
    ],
)
def test_bad_paths(changes, message: str) -> None:
    whole = {
        "position": lambda s: np.stack([s, 0 * s], -1),
        "direction": lambda s: np.stack([0 * s + 1.0, 0 * s], -1),
        "length": 2.0,
    }
    with pytest.raises(ValueError, match=message):
        Path(**{**whole, **changes})
