"""Where a patch lies in an old map: against a search that tries each pose by itself."""

import math

import numpy as np
import pytest

from jaxplore.localisation import correlation, stretch_loops
from jaxplore.localisation.stretch_loops import CELL, TURN_SPACING, Patch, find_patch

# A lane with a niche, a box and a crossing lane: nothing repeats along it.
LANE = [
    *((x, 1.0) for x in np.arange(-8.0, 3.0, 0.1)),
    *((x, 1.0) for x in np.arange(5.0, 9.0, 0.1)),
    *((x, -1.0) for x in np.arange(-8.0, -4.0, 0.1)),
    *((x, -1.0) for x in np.arange(-2.5, 9.0, 0.1)),
    *((3.0, y) for y in np.arange(1.0, 5.0, 0.1)),
    *((5.0, y) for y in np.arange(1.0, 5.0, 0.1)),
    *((x, -2.0) for x in np.arange(-4.0, -2.5, 0.1)),
]
WALLS = np.array(LANE)
FREE = np.array([(x, y) for x in np.arange(-8.0, 9.0, 0.5) for y in (-0.5, 0.0, 0.5)])


def turned(points: np.ndarray, yaw: float) -> np.ndarray:
    cos, sin = math.cos(yaw), math.sin(yaw)
    return points @ np.array([[cos, sin], [-sin, cos]])


def local(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    return turned(points - pose[:2], -pose[2])


def cells_of(points: np.ndarray) -> set[tuple[int, int]]:
    return {(int(x), int(y)) for x, y in np.floor(points / CELL)}


def test_the_scores_are_those_of_every_pose_by_itself() -> None:
    """With sets of cells in place of grids, and sums in place of Fourier transforms."""
    guess = np.array([0.1, -0.2, 0.05])
    patch = Patch(local(WALLS[::3], np.array([0.55, 0.1, 0.09])), local(FREE, guess))
    place = Patch(WALLS, FREE + 0.03)
    found = find_patch(patch, place, guess, 1.5, 0.04)
    walls = cells_of(place.occupied - guess[:2])
    beside = {(i + a, j + b) for i, j in walls for a in (-1, 0, 1) for b in (-1, 0, 1)}
    free = cells_of(place.free - guess[:2]) - beside
    reach = correlation.WIDEST_BLUR
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / correlation.BLUR) ** 2)
    # The filter ends at four standard deviations.
    weights[np.abs(np.arange(-reach, reach + 1)) > int(4.0 * correlation.BLUR + 0.5)] = 0.0

    def value(cell: tuple[int, int]) -> float:
        near = sum(
            weights[a + reach] * weights[b + reach]
            for a in range(-reach, reach + 1)
            for b in range(-reach, reach + 1)
            if (cell[0] + a, cell[1] + b) in walls
        )
        return min(near, 1.0) - (cell in free)

    scores = {}
    for turn in range(-2, 3):
        yaw = guess[2] + TURN_SPACING * turn
        own = cells_of(turned(patch.occupied, yaw))
        around = {(i + a, j + b) for i, j in own for a in (-1, 0, 1) for b in (-1, 0, 1)}
        own_free = cells_of(turned(patch.free, yaw)) - around
        for right in range(-6, 7):
            for up in range(-6, 7):
                moved = [(i + right, j + up) for i, j in own]
                passed = sum((i + right, j + up) in walls for i, j in own_free)
                scores[turn, right, up] = (sum(map(value, moved)) - passed) / len(own)
    best = max(scores, key=lambda key: scores[key])
    np.testing.assert_allclose(
        found.pose, guess + np.array([CELL, CELL, TURN_SPACING]) * np.array([*best[1:], best[0]])
    )
    assert found.score == pytest.approx(scores[best], abs=1e-4)
    rival = max(
        score
        for (_, right, up), score in scores.items()
        if CELL * math.hypot(right - best[1], up - best[2]) > stretch_loops.APART
    )
    assert found.rival == pytest.approx(max(rival, 0.0), abs=1e-4)
    assert found.is_inside == (abs(best[0]) < 2 and max(abs(best[1]), abs(best[2])) < 6)


@pytest.mark.parametrize("off", [(7.0, -4.0, 0.3), (-9.0, 9.0, -0.2), (0.0, 0.0, 0.0)])
def test_a_patch_is_found_metres_from_the_guess(off: tuple[float, float, float]) -> None:
    pose = np.array([1.0, 0.2, 2.0])
    patch = Patch(local(WALLS, pose), local(FREE, pose))
    found = find_patch(patch, Patch(WALLS, FREE), pose + np.array(off), 10.0, 0.36)
    np.testing.assert_allclose(found.pose[:2], pose[:2], atol=0.75 * CELL)
    assert found.pose[2] == pytest.approx(pose[2], abs=TURN_SPACING)
    assert found.score > 0.9
    assert found.rival < 0.8 * found.score
    assert found.is_inside


def test_a_place_that_is_there_twice_has_a_rival() -> None:
    again = np.array([0.0, 8.0])
    place = Patch(*(np.concatenate([each, each + again]) for each in (WALLS[:-55], FREE)))
    found = find_patch(Patch(WALLS[:-55], FREE), place, np.array([0.0, 3.0, 0.0]), 7.0, 0.1)
    assert found.rival == pytest.approx(found.score, abs=0.01)


def test_walls_in_free_space_count_against_a_place() -> None:
    """The old scans have seen free space all around; then they have not been there."""
    hall = Patch(WALLS + np.array([0.0, 40.0]), np.mgrid[-10:10:0.25, -10:10:0.25].reshape(2, -1).T)
    found = find_patch(Patch(WALLS, FREE), hall, np.zeros(3), 1.0, 0.02)
    assert found.score < -0.9
    unknown = find_patch(Patch(WALLS, FREE), Patch(hall.occupied, FREE[:0]), np.zeros(3), 1.0, 0.02)
    assert unknown.score == pytest.approx(0.0, abs=1e-5)


def test_a_patch_has_the_ends_of_beams_and_what_they_passed() -> None:
    poses = np.array([[1.0, 2.0, 0.5 * math.pi], [0.0, 0.0, 0.0]])
    ranges = np.array([[2.0, 5.0], [0.4, 3.0]])
    is_return = np.array([[True, False], [True, False]])
    patch = Patch.of(ranges, is_return, np.array([0.0, 0.5]), poses)
    np.testing.assert_allclose(patch.occupied, [[1.0, 4.0], [0.4, 0.0]], atol=1e-12)
    expected = [[1.0, 2.0 + away] for away in (0.25, 0.75, 1.25)]
    np.testing.assert_allclose(patch.free, expected, atol=1e-12)
    nothing = Patch.of(ranges, np.zeros((2, 2), bool), np.array([0.0, 0.5]), poses)
    assert len(nothing.occupied) == len(nothing.free) == 0
    assert find_patch(nothing, patch, np.zeros(3), 1.0, 0.1).score == 0.0
