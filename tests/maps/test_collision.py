import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore.geometry.footprint import Disc, Footprint, Rectangle
from jaxplore.maps.collision import (
    clearance_reach,
    disc_clearance,
    discs_clearance,
    footprint_clearance,
    rectangle_clearance,
)
from jaxplore.maps.frame import GridFrame

CAR = Rectangle(front=0.625, rear=0.125, width=0.4)
RESOLUTION, SIZE = 0.1, 30
REACH = clearance_reach(CAR, RESOLUTION)
POSES = 200


def in_frame(points: np.ndarray, pose) -> np.ndarray:
    """Points (..., 2) in the axes of a robot at (x, y, yaw), double precision."""
    x, y, yaw = pose
    dx, dy = points[..., 0] - x, points[..., 1] - y
    return np.stack(
        [math.cos(yaw) * dx + math.sin(yaw) * dy, math.cos(yaw) * dy - math.sin(yaw) * dx], axis=-1
    )


def to_world(points: np.ndarray, pose) -> np.ndarray:
    """Points (..., 2) in the axes of a robot at (x, y, yaw), in the world."""
    x, y, yaw = pose
    a, b = points[..., 0], points[..., 1]
    return np.stack(
        [x + math.cos(yaw) * a - math.sin(yaw) * b, y + math.sin(yaw) * a + math.cos(yaw) * b],
        axis=-1,
    )


def outline(low, high, count: int) -> np.ndarray:
    """Points (4 count, 2) along the edges of a box, its corners among them."""
    share = np.linspace(0.0, 1.0, count)
    x, y = (a + (b - a) * share for a, b in zip(low, high, strict=True))
    ends = [np.stack([x, np.full(count, edge)], axis=-1) for edge in (low[1], high[1])]
    sides = [np.stack([np.full(count, edge), y], axis=-1) for edge in (low[0], high[0])]
    return np.concatenate(ends + sides)


def from_box(points: np.ndarray, low, high) -> np.ndarray:
    """How far points (..., 2) are outside a box, 0 within."""
    gap = np.maximum(np.maximum(np.asarray(low) - points, points - np.asarray(high)), 0.0)
    return np.hypot(gap[..., 0], gap[..., 1])


CAR_LOW, CAR_HIGH = (-0.125, -0.2), (0.625, 0.2)
CAR_OUTLINE = outline(CAR_LOW, CAR_HIGH, 60)
CAR_CORNERS = np.array([[x, y] for x in (-0.125, 0.625) for y in (-0.2, 0.2)])
SQUARE = outline((0.0, 0.0), (1.0, 1.0), 15) * RESOLUTION
CORNERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]]) * RESOLUTION
DIRECTIONS = np.linspace(0.0, 2 * math.pi, 7200, endpoint=False)
NORMALS = np.stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)])


def brute_force(solid: np.ndarray, pose) -> float:
    """Distance of the car's outline from each solid square, point by point; where a point of one is
    within the other, minus the shortest of the pushes in many directions that part them."""
    car, car_corners = to_world(CAR_OUTLINE, pose), to_world(CAR_CORNERS, pose)
    nearest = math.inf
    row, column = math.floor(pose[1] / RESOLUTION), math.floor(pose[0] / RESOLUTION)
    for i in range(row - REACH, row + REACH + 1):
        for j in range(column - REACH, column + REACH + 1):
            if 0 <= i < SIZE and 0 <= j < SIZE and not solid[i, j]:
                continue
            low = np.array([j, i]) * RESOLUTION
            to_square = from_box(car, low, low + RESOLUTION).min()
            to_car = from_box(in_frame(SQUARE + low, pose), CAR_LOW, CAR_HIGH).min()
            distance = min(to_square, to_car)
            if distance == 0.0:
                distance = -np.min(
                    (car_corners @ NORMALS).max(axis=0) - ((CORNERS + low) @ NORMALS).min(axis=0)
                )
            nearest = min(nearest, float(distance))
    return nearest


@jax.jit
def clearances(solid, poses):
    def clearance(pose):
        grid = GridFrame(RESOLUTION).to_grid(pose[:2])
        return rectangle_clearance(solid, grid, pose[2], CAR, RESOLUTION, REACH)

    return jax.vmap(clearance)(poses)


def test_a_rectangle_s_clearance_is_what_brute_force_finds() -> None:
    rng = np.random.default_rng(0)
    solid = rng.random((SIZE, SIZE)) < 0.004
    low, high = (-0.1, -0.1, -7.0), (0.1 * SIZE + 0.1, 0.1 * SIZE + 0.1, 7.0)
    poses = rng.uniform(low, high, (POSES, 3))
    # Along the axes, where corners face edges.
    poses[:20, 2] = 0.5 * math.pi * rng.integers(-4, 5, 20)
    found = np.asarray(clearances(jnp.asarray(solid), jnp.asarray(poses, jnp.float32)))
    beyond = REACH * RESOLUTION - math.hypot(0.625, 0.2)
    expected = np.minimum([brute_force(solid, pose) for pose in poses], beyond)
    assert (expected < -0.01).sum() > 50
    assert (expected > 0.01).sum() > 50
    # The closest points of two that are apart are among those tried; of pushes some are missing.
    np.testing.assert_allclose(found, expected, atol=1e-3)
    apart = expected > 0.0
    np.testing.assert_allclose(found[apart], expected[apart], atol=5e-6)


def test_crossing_without_a_corner_inside() -> None:
    # A long thin rectangle over a cell: neither holds a corner of the other.
    solid = np.zeros((SIZE, SIZE), bool)
    solid[15, 15] = True
    needle = Rectangle(1.0, 1.0, 0.02)
    reach = clearance_reach(needle, RESOLUTION)
    middle = jnp.asarray([15.5, 15.5])
    across = jax.jit(lambda *at: rectangle_clearance(*at, needle, RESOLUTION, reach))(
        jnp.asarray(solid), middle, jnp.zeros(())
    )
    assert float(across) == pytest.approx(-0.06, abs=1e-6)


def test_where_nothing_is_solid_it_is_what_one_beyond_the_reach_could_be_at() -> None:
    poses = np.full((POSES, 3), [1.53, 1.48, 0.4], np.float32)
    found = clearances(jnp.zeros((SIZE, SIZE), bool), jnp.asarray(poses))[0]
    assert float(found) == pytest.approx(REACH * 0.1 - math.hypot(0.625, 0.2), abs=1e-6)
    assert float(found) >= 0.5


def test_the_edge_of_the_map_is_a_wall() -> None:
    poses = [
        (0.425, 1.5, 0.0),  # its rear edge 0.3 m from the left one
        (0.325, 1.5, math.pi),  # its front edge 0.3 m beyond it
        (1.5, 2.6, 0.0),  # its left edge 0.2 m from the upper one
        (1.5, 2.275, 0.5 * math.pi),  # its front edge 0.1 m from it
    ]
    padded = jnp.asarray(poses + [(1.5, 1.5, 0.0)] * (POSES - len(poses)), jnp.float32)
    found = clearances(jnp.zeros((SIZE, SIZE), bool), padded)
    np.testing.assert_allclose(np.asarray(found)[[0, 2, 3]], [0.3, 0.2, 0.1], atol=1e-6)
    assert float(found[1]) < -0.05


def test_a_tiny_rectangle_is_a_point() -> None:
    rng = np.random.default_rng(1)
    solid = jnp.asarray(rng.random((SIZE, SIZE)) < 0.02)
    speck = Rectangle(1e-4, 1e-4, 2e-4)

    def both(grid, heading):
        rectangle = rectangle_clearance(solid, grid, heading, speck, RESOLUTION, 7)
        return rectangle, disc_clearance(solid, grid, jnp.zeros(()), RESOLUTION, 7)

    grid = jnp.asarray(rng.uniform(0, SIZE, (POSES, 2)), jnp.float32)
    found, expected = jax.jit(jax.vmap(both))(
        grid, jnp.asarray(rng.uniform(-4, 4, POSES), jnp.float32)
    )
    found, expected = np.asarray(found), np.asarray(expected)
    is_outside = expected > 0.0
    assert 150 < is_outside.sum() < 200
    np.testing.assert_allclose(found[is_outside], expected[is_outside], atol=2e-4)
    assert (found[~is_outside] < 2e-4).all()


class Pair(Footprint):
    """Two discs of 0.2 m, 0.3 m before and behind the position."""

    offsets: jax.Array
    radius: jax.Array


PAIR = Pair(jnp.asarray([-0.3, 0.3]), jnp.asarray(0.2))
FRAME = GridFrame(RESOLUTION, (2.0, -1.0, 0.8))


@jax.jit
def footprint_clearances(solid, position, heading):
    return [
        footprint_clearance(solid, FRAME, position, heading, footprint, REACH)
        for footprint in (CAR, Disc(0.2), PAIR)
    ]


of_a_disc = jax.jit(
    lambda solid, grid: disc_clearance(solid, grid, jnp.asarray(0.2), RESOLUTION, REACH)
)


@pytest.mark.parametrize("seed", range(4))
def test_a_robot_is_found_on_a_turned_map(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = jnp.asarray(rng.random((SIZE, SIZE)) < 0.01)
    in_map = np.array([*rng.uniform(0.8, 2.2, 2), rng.uniform(-3, 3)])
    x, y = to_world(in_map[:2], (2.0, -1.0, 0.8))
    yaw = in_map[2] + 0.8
    car, disc, pair = footprint_clearances(
        solid, jnp.asarray([x, y], jnp.float32), jnp.asarray(yaw, jnp.float32)
    )
    alone = clearances(solid, jnp.asarray([in_map] * POSES, jnp.float32))
    assert float(car) == pytest.approx(float(alone[0]), abs=1e-5)

    def around(point) -> float:
        return float(of_a_disc(solid, jnp.asarray(point[::-1] / RESOLUTION, jnp.float32)))

    assert float(disc) == pytest.approx(around(in_map[:2]), abs=1e-5)
    ends = to_world(np.array([[-0.3, 0.0], [0.3, 0.0]]), in_map)
    assert float(pair) == pytest.approx(min(around(end) for end in ends), abs=1e-5)


def test_a_disc_s_heading_is_not_read() -> None:
    solid = np.zeros((SIZE, SIZE), bool)
    solid[3, 4] = True
    _, found, _ = footprint_clearances(
        jnp.asarray(solid), jnp.asarray([2.0, -0.5]), jnp.asarray(jnp.nan)
    )
    assert np.isfinite(found)


@pytest.mark.parametrize("margin", [0.5, 1.3])
def test_reach_covers_the_footprint_and_the_margin(margin: float) -> None:
    assert clearance_reach(0.25, 0.1, margin) == clearance_reach(Disc(0.25), 0.1, margin)
    assert clearance_reach(PAIR, 0.1, margin) == clearance_reach(Disc(0.2), 0.1, margin)
    # As far as the farthest corner gets, whichever end that is.
    for footprint in (CAR, Rectangle(0.125, 0.625, 0.4)):
        reach = clearance_reach(footprint, 0.1, margin)
        assert reach * 0.1 - math.hypot(0.625, 0.2) >= margin - 1e-9
        assert reach <= (margin + math.hypot(0.625, 0.2)) / 0.1 + 2


# Discs that move


@jax.jit
def discs_clearances(centres, radii, pose):
    return [
        discs_clearance(centres, radii, pose[:2], pose[2], footprint)
        for footprint in (CAR, Disc(0.2), PAIR)
    ]


PLACE = st.floats(-1.5, 1.5, width=32)


@given(
    st.lists(st.tuples(PLACE, PLACE, st.floats(0, 0.5, width=32)), min_size=3, max_size=3),
    st.tuples(PLACE, PLACE, st.floats(-4, 4, width=32)),
)
def test_clearance_of_discs(discs, pose) -> None:
    centres, radii = np.array(discs)[:, :2], np.array(discs)[:, 2]
    car, disc, pair = discs_clearances(
        *(jnp.asarray(given, jnp.float32) for given in (centres, radii, pose))
    )
    seen = in_frame(centres, pose)
    expected = math.inf
    for centre, radius in zip(seen, radii, strict=True):
        away = float(from_box(centre, CAR_LOW, CAR_HIGH))
        if away == 0.0:  # inside: as deep as the nearest edge is far, found point by point
            away = -float(np.hypot(*(CAR_OUTLINE - centre).T).min())
        expected = min(expected, away - float(radius))
    # The outline's points are 1.3 cm apart: inside, the nearest edge is up to so much nearer.
    assert float(car) == pytest.approx(expected, abs=1e-5 if expected > 0.0 else 0.013)
    assert float(disc) == pytest.approx(float((np.hypot(*seen.T) - radii).min()) - 0.2, abs=1e-5)
    ends = [np.hypot(seen[:, 0] - end, seen[:, 1]) - radii for end in (-0.3, 0.3)]
    assert float(pair) == pytest.approx(float(np.min(ends)) - 0.2, abs=1e-5)


def test_inside_it_is_as_deep_as_the_nearest_edge_is_far() -> None:
    # On the car's axis, 0.1 m behind the front edge; then 0.05 m from its left edge.
    pose = jnp.asarray([1.0, 2.0, 0.5 * math.pi])
    for place, depth in (((1.0, 2.525), 0.1), ((0.85, 2.25), 0.05)):
        centres = jnp.asarray([place, (9.0, 9.0), (9.0, 9.0)])
        car, _, _ = discs_clearances(centres, jnp.full(3, 0.3), pose)
        assert float(car) == pytest.approx(-depth - 0.3, abs=1e-6)


def test_from_nothing_it_is_infinitely_far() -> None:
    nothing = jnp.zeros((0, 2)), jnp.zeros(0)
    for found in discs_clearances(*nothing, jnp.zeros(3)):
        assert float(found) == math.inf
