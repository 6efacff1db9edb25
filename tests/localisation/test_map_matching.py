"""Where a map lies on another one: drawn rooms seen from two frames, and what must be refused."""

import math

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from jaxplore.localisation import map_matching, match_maps
from jaxplore.localisation.correlation import BLUR
from jaxplore.localisation.map_matching import CELL, CONTRADICTED, _Correlation, _Side
from jaxplore.maps import OccupancyGrid

FINE = 0.05
"""Side of a cell of the drawn worlds [m]."""


def rooms(rng: np.random.Generator, width: float = 14.0, height: float = 11.0) -> np.ndarray:
    """Draw a floor with two walls that have doors, and boxes; the first axis is y."""
    rows, columns = round(height / FINE), round(width / FINE)
    world = np.zeros((rows, columns), bool)
    world[[0, 1, -2, -1]] = world[:, [0, 1, -2, -1]] = True
    across, up = round(rng.uniform(0.35, 0.6) * columns), round(rng.uniform(0.35, 0.6) * rows)
    world[:, across : across + 3] = True
    world[up : up + 3, :across] = True
    for door in (0.2, 0.8):
        at = round((door + rng.uniform(-0.1, 0.1)) * rows)
        world[at : at + 24, across : across + 3] = False
    at = round(rng.uniform(0.2, 0.7) * across)
    world[up : up + 3, at : at + 24] = False
    for _ in range(9):
        row, column = rng.integers(10, rows - 40), rng.integers(10, columns - 40)
        high, wide = rng.integers(6, 30, 2)
        world[row : row + high, column : column + wide] = True
    return world


def seen(
    world: np.ndarray,
    pose: tuple[float, float, float],
    part: tuple[float, float] = (0.0, 1.0),
    cell: float = 0.07,
    rng: np.random.Generator | None = None,
) -> OccupancyGrid:
    """Return the map of a robot whose frame is at a pose in a world, drawn cell by cell.

    It knows a part of the world along x, as shares, without the inside of walls.
    """
    from scipy.ndimage import distance_transform_edt

    rows, columns = world.shape
    deep = distance_transform_edt(np.pad(world, 1, constant_values=True))[1:-1, 1:-1] > 2.9
    value = np.where(world, 0.95, 0.03)
    value[deep] = 0.5
    x = (np.arange(columns) + 0.5) / columns
    value[:, (x < part[0]) | (x > part[1])] = 0.5
    corners = np.array([(a, b) for a in (0, columns * FINE) for b in (0, rows * FINE)])
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    inside = (corners - pose[:2]) @ np.array([[cos, -sin], [sin, cos]])
    low, high = inside.min(axis=0) - 0.3, inside.max(axis=0) + 0.3
    number = np.ceil((high - low) / cell).astype(int)
    jj, ii = np.meshgrid(np.arange(number[0]), np.arange(number[1]))
    points = low + (np.stack([jj, ii], axis=-1) + 0.5) * cell
    there = points @ np.array([[cos, sin], [-sin, cos]]) + np.array(pose[:2])
    at = np.floor(there / FINE).astype(int)
    is_in = ((at >= 0) & (at < [columns, rows])).all(axis=-1)
    drawn = np.where(
        is_in, value[np.where(is_in, at[..., 1], 0), np.where(is_in, at[..., 0], 0)], 0.5
    )
    if rng is not None:
        # A twentieth of the cells of walls is missing, and there are specks.
        chance = rng.random(drawn.shape)
        drawn = np.where((drawn > 0.5) & (chance < 0.05), 0.03, drawn)
        drawn = np.where((drawn < 0.5) & (chance < 2e-4), 0.95, drawn)
    return OccupancyGrid(drawn, cell, (*low.tolist(), 0.0))


def between(one: tuple[float, float, float], other: tuple[float, float, float]) -> np.ndarray:
    away = (other[0] - one[0] + 1j * (other[1] - one[1])) * np.exp(-1j * one[2])
    return np.array([away.real, away.imag, math.remainder(other[2] - one[2], math.tau)])


poses = st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0), st.floats(-math.pi, math.pi))


@settings(max_examples=8, phases=[Phase.explicit, Phase.generate])
@given(st.integers(0, 10**6), poses, poses, st.sampled_from([0.05, 0.07, 0.1]))
def test_the_pose_of_a_frame_is_found(seed, one, other, cell) -> None:
    rng = np.random.default_rng(seed)
    world = rooms(rng)
    first = seen(world, one, (0.0, 0.8), rng=rng)
    second = seen(world, other, (0.15, 1.0), cell, rng=rng)
    found = match_maps(first, second)
    assert found.is_certain, found.doubt
    # Compared in the middle of what the second has seen: the frame may be far from it.
    middle = np.array([8.0, 5.5])
    true, said = between(one, other), found.pose
    local = between(other, (*middle.tolist(), 0.0))
    errors = [
        (each[0] + 1j * each[1]) + (local[0] + 1j * local[1]) * np.exp(1j * each[2])
        for each in (said, true)
    ]
    assert abs(errors[0] - errors[1]) < 0.07
    assert abs(math.remainder(said[2] - true[2], math.tau)) < 0.012
    error = said - true
    error[2] = math.remainder(error[2], math.tau)
    assert error @ np.linalg.solve(found.covariance, error) < 25.0


def test_the_maps_may_be_exchanged() -> None:
    world = rooms(np.random.default_rng(5))
    one = seen(world, (3.0, 2.0, 0.4), (0.0, 0.8))
    other = seen(world, (-4.0, 1.0, -2.0), (0.15, 1.0))
    there, back = match_maps(one, other), match_maps(other, one)
    np.testing.assert_allclose(between(tuple(there.pose), (0.0, 0.0, 0.0)), back.pose, atol=0.06)
    assert there.agreeing == pytest.approx(back.agreeing, rel=0.1)


def test_a_frame_that_is_turned_is_that_of_the_same_map() -> None:
    world = rooms(np.random.default_rng(6))
    one, other = seen(world, (0.0, 0.0, 0.0)), seen(world, (2.0, 1.0, 0.5), (0.1, 0.9))
    expected = match_maps(one, other)
    turned = OccupancyGrid(
        np.asarray(other.probability), other.resolution, np.array([5.0, -2.0, 0.7])
    )
    # The cells are at the same places of the world, so the frame has moved the other way.
    origin = np.asarray(other.frame.origin, float)
    frame = between((5.0, -2.0, 0.7), (0.0, 0.0, 0.0))
    corner = expected.pose[:2] @ np.eye(2) + np.array(
        [
            math.cos(expected.pose[2]) * origin[0] - math.sin(expected.pose[2]) * origin[1],
            math.sin(expected.pose[2]) * origin[0] + math.cos(expected.pose[2]) * origin[1],
        ]
    )
    yaw = expected.pose[2]
    there = np.array(
        [
            corner[0] + math.cos(yaw) * frame[0] - math.sin(yaw) * frame[1],
            corner[1] + math.sin(yaw) * frame[0] + math.cos(yaw) * frame[1],
            math.remainder(yaw + frame[2], math.tau),
        ]
    )
    np.testing.assert_allclose(match_maps(one, turned).pose, there, atol=1e-5)


def test_scores_are_those_of_every_shift_by_itself() -> None:
    """Sums over cells, in place of Fourier transforms."""
    world = rooms(np.random.default_rng(1), 5.0, 4.0)
    one, other = (
        _Side.of("map", seen(world, pose, part))
        for pose, part in (((0.3, 0.1, 0.2), (0.0, 0.7)), ((1.0, 2.0, -0.9), (0.3, 1.0)))
    )
    correlation = _Correlation.of(one, other)
    yaw = 1.08
    scores = correlation.scores(yaw)

    def cells(points: np.ndarray) -> list[tuple[int, int]]:
        return [(int(x), int(y)) for x, y in np.floor(points / CELL)]

    def mean_of(points: np.ndarray, rows: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
        found: dict[tuple[int, int], list[np.ndarray]] = {}
        for cell, row in zip(cells(points), rows, strict=True):
            found.setdefault(cell, []).append(row)
        return {cell: np.mean(each, axis=0) for cell, each in found.items()}

    facing = mean_of(one.points - one.centre, one.facing)
    thin = mean_of(one.points - one.centre, 1.0 * ~one.facing.any(axis=1)[:, None])
    free = set(cells(one.deep - one.centre))
    steps = np.arange(-3, 4)
    kernel = np.exp(-0.5 * (steps / BLUR) ** 2)

    def blurred(field: dict[tuple[int, int], np.ndarray], cell: tuple[int, int]) -> np.ndarray:
        return sum(
            kernel[a + 3] * kernel[b + 3] * field.get((cell[0] + a, cell[1] + b), np.zeros(1))
            for a in steps
            for b in steps
        )

    cos, sin = math.cos(yaw), math.sin(yaw)
    turn = np.array([[cos, sin], [-sin, cos]])
    own = mean_of((other.points - other.centre) @ turn, other.facing @ turn)
    own_free = set(cells((other.deep - other.centre) @ turn))
    for shift in [(0, 0), (3, -2), (-5, 4), (8, 1), (1, -9), (-2, 0)]:
        total = 0.0
        for (x, y), direction in own.items():
            there = x + shift[0], y + shift[1]
            side = blurred(facing, there)
            total += float((direction * side).sum() / max(np.hypot(*np.broadcast_to(side, 2)), 1.0))
            total += min(float(blurred(thin, there)[0]), 1.0) - CONTRADICTED * (there in free)
        total -= CONTRADICTED * sum((x + shift[0], y + shift[1]) in facing for x, y in own_free)
        assert scores[shift] == pytest.approx(CELL * total, abs=1e-3)
        np.testing.assert_allclose(
            correlation.place(np.array(shift) % correlation.size),
            one.centre + CELL * np.array(shift),
        )


def test_no_yaw_at_which_walls_can_agree_is_left_out() -> None:
    """The bound by directions of walls is above the length that agrees at the true yaw."""
    world = rooms(np.random.default_rng(2))
    for yaw in (0.1, 0.8, 2.5):
        one, other = (
            _Side.of("map", seen(world, pose, (0.1, 0.9))) for pose in ((0, 0, 0.0), (1, 2, yaw))
        )
        found = match_maps(
            seen(world, (0, 0, 0.0), (0.1, 0.9)), seen(world, (1, 2, yaw), (0.1, 0.9))
        )
        (bound,) = map_matching._most_agreeing(one, other, np.array([found.pose[2] % math.tau]))
        assert bound >= 0.95 * found.agreeing


def corridor(length: float, notches: list[float]) -> np.ndarray:
    """Draw a corridor 2 m wide, open at its ends, with doors at places along it [m]."""
    world = np.zeros((round(4.0 / FINE), round(length / FINE)), bool)
    world[:20] = world[60:] = True
    for at in notches:
        world[60:70, round(at / FINE) : round((at + 1.0) / FINE)] = False
    return world


def test_along_a_bare_corridor_no_pose_is_certain() -> None:
    world = corridor(24.0, [])
    found = match_maps(seen(world, (0, 0, 0.3), (0.0, 0.7)), seen(world, (1, 1, 1.0), (0.3, 1.0)))
    assert found.agreeing > 15.0
    assert not found.is_certain


@pytest.mark.parametrize("step", [3.0, 6.0])
def test_where_doors_repeat_another_pose_fits_as_well(step: float) -> None:
    world = corridor(60.0, np.arange(2.0, 58.0, step).tolist())
    found = match_maps(seen(world, (0, 0, 0.3), (0.0, 0.6)), seen(world, (1, 1, 1.0), (0.4, 1.0)))
    assert "another pose fits" in found.doubt
    assert found.rival > 0.6 * found.score


def test_a_square_room_fits_in_four_ways() -> None:
    world = np.zeros((200, 200), bool)
    world[[0, 1, -2, -1]] = world[:, [0, 1, -2, -1]] = True
    found = match_maps(seen(world, (0, 0, 0.3)), seen(world, (1, 1, 1.0)))
    assert "another pose fits" in found.doubt
    # With a box in a corner it fits in one way.
    world[10:40, 10:60] = True
    assert match_maps(seen(world, (0, 0, 0.3)), seen(world, (1, 1, 1.0))).rival < found.rival


def shelves(number: int) -> np.ndarray:
    """Draw equal shelves side by side, in a hall without walls."""
    world = np.zeros((round(12.0 / FINE), round((3.0 * number + 2.0) / FINE)), bool)
    for index in range(number):
        begin = round((2.0 + 3.0 * index) / FINE)
        world[40:200, begin : begin + 20] = True
    return world


def test_shelves_that_look_the_same_are_refused() -> None:
    """Whether the robots have seen the same shelves, or neighbours."""
    world = shelves(8)
    for part in ((0.0, 0.6), (0.2, 0.8), (0.4, 1.0)):
        found = match_maps(seen(world, (0, 0, 0.3), (0.0, 0.6)), seen(world, (1, 1, 1.0), part))
        assert not found.is_certain


@pytest.mark.parametrize("seed", range(4))
def test_other_buildings_and_other_parts_are_never_merged(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, other = rooms(rng), rooms(rng)
    assert not match_maps(seen(one, (0, 0, 0.3)), seen(other, (1, 1, 1.0))).is_certain
    left, right = seen(one, (0, 0, 0.3), (0.0, 0.45)), seen(one, (1, 1, 1.0), (0.55, 1.0))
    assert not match_maps(left, right).is_certain


def test_both_sides_of_a_wall_are_no_agreement() -> None:
    """Two rooms with a wall in common, each seen from inside: nothing of them is the same."""
    world = np.zeros((160, 300), bool)
    world[[0, 1, -2, -1]] = world[:, [0, 1, -2, -1]] = True
    world[:, 140:143] = True
    one, other = seen(world, (0, 0, 0.0), (0.0, 0.475)), seen(world, (0, 0, 0.0), (0.475, 1.0))
    sides = [_Side.of("map", each) for each in (one, other)]
    shift = sides[1].centre + sides[1].corner[:2] - sides[0].corner[:2]
    same = map_matching._evaluate(*sides, map_matching._Candidate(shift, 0.0))
    assert same.agreeing < 2.0


def test_maps_without_walls_have_no_pose() -> None:
    world = rooms(np.random.default_rng(0))
    blank = OccupancyGrid(np.full((40, 50), 0.5), 0.1)
    free = OccupancyGrid(np.full((40, 50), 0.02), 0.1)
    for each in (blank, free):
        for found in (match_maps(each, seen(world, (0, 0, 0.0))), match_maps(each, each)):
            assert found.doubt == "a map has no walls"
            assert np.isinf(found.covariance).any()


def test_a_map_that_is_too_wide_is_refused() -> None:
    wide = np.full((30, 3100), 0.02)
    wide[0] = 0.9
    with pytest.raises(
        ValueError, match=r"one is 310 m wide where it is known; accepted: at most 300 m"
    ):
        match_maps(OccupancyGrid(wide, 0.1), OccupancyGrid(wide, 0.1))


def test_a_large_map_is_coarsened(monkeypatch: pytest.MonkeyPatch) -> None:
    world = rooms(np.random.default_rng(3))
    one, other = seen(world, (0, 0, 0.3), (0.0, 0.8)), seen(world, (1, 1, 1.0), (0.2, 1.0))
    expected = match_maps(one, other)
    monkeypatch.setattr(map_matching, "MOST_CELLS", 12_000)
    found = match_maps(one, other)
    assert _Side.of("map", one).cell > one.resolution
    np.testing.assert_allclose(found.pose, expected.pose, atol=0.1)
