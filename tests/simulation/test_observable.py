"""What of a volume can be seen, against lines that are followed one by one in NumPy."""

import math

import numpy as np
import pytest

from jaxplore.information.voxel_table import band
from jaxplore.simulation.volume.observable import (
    ELEVATIONS,
    SECTORS,
    find_fitting_places,
    observable,
    room_around,
)

VIEW = (-math.radians(30.0), math.radians(30.0))


def seen_one_by_one(solid: np.ndarray, places: np.ndarray, reach: float) -> np.ndarray:
    """Follow the line of each direction from each place until it is blocked or ends."""
    ways, _ = band(SECTORS, ELEVATIONS, *VIEW)
    seen = np.zeros_like(solid)
    for way in ways[::-1].T:
        axis = int(np.abs(way).argmax())
        slope = way / abs(way[axis])
        length = math.sqrt((slope**2).sum())
        # The shifts are counted from the first plane that a line can start from, as all lines of a
        # direction are shifted together.
        begin = 0 if way[axis] > 0 else solid.shape[axis] - 1
        for place in np.argwhere(places):
            offset = abs(place[axis] - begin)
            first = np.round(offset * slope)
            first[axis] = offset * np.sign(slope[axis])
            left, voxel = reach, place
            for n in range(offset, solid.shape[axis]):
                if left < 0.0 or solid[tuple(voxel)]:
                    break
                seen[tuple(voxel)] = True
                now, then = np.round(n * slope), np.round((n + 1) * slope)
                step = (then - now).astype(int)
                step[axis] = int(np.sign(slope[axis]))
                after = voxel + step
                if (after < 0).any() or (after >= solid.shape).any():
                    break
                ahead, across = voxel.copy(), after.copy()
                ahead[axis], across[axis] = after[axis], voxel[axis]
                if solid[tuple(ahead)] and solid[tuple(across)]:
                    break
                left, voxel = left - length, after
    return seen


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_it_is_what_single_lines_see(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = rng.random((9, 12, 14)) < 0.25
    places = ~solid & (rng.random(solid.shape) < 0.01)
    reach = 7.5
    found = observable(solid, places, [(reach, *VIEW)])
    np.testing.assert_array_equal(found, seen_one_by_one(solid, places, reach))
    assert places.any()
    assert not (found & solid).any()


def test_a_closed_cavity_is_not_seen_and_an_open_one_is() -> None:
    solid = np.zeros((12, 20, 24), bool)
    solid[2:10, 6:14, 10:18] = True
    solid[4:8, 8:12, 12:16] = False
    places = np.zeros_like(solid)
    places[6, 10, 3] = places[6, 3, 20] = places[6, 17, 14] = places[6, 10, 22] = True
    cavity = np.zeros_like(solid)
    cavity[4:8, 8:12, 12:16] = True
    views = [(30.0, *VIEW)]
    assert not observable(solid, places, views)[cavity].any()
    solid[5:8, 9:12, 10:12] = False
    found = observable(solid, places, views)
    assert found[5:8, 9:12, 12:14].mean() > 0.4
    assert 0.1 < found[cavity].mean() < 0.9


def test_two_sensors_see_what_either_sees() -> None:
    solid = np.zeros((16, 16, 16), bool)
    places = np.zeros_like(solid)
    places[8, 8, 8] = True
    wide, far = (4.0, -1.2, 1.2), (12.0, -0.1, 0.1)
    both = observable(solid, places, [wide, far])
    each = observable(solid, places, [wide]) | observable(solid, places, [far])
    np.testing.assert_array_equal(both, each)
    distance = np.linalg.norm(np.argwhere(both) - 8.0, axis=1)
    assert distance.max() <= 12.0 + 1.0


def test_a_ball_fits_where_it_touches_nothing() -> None:
    solid = np.zeros((11, 11, 30), bool)
    solid[[0, -1]] = solid[:, [0, -1]] = solid[:, :, [0, -1]] = True
    solid[:, :, 15] = True
    solid[4:7, 4:7, 15] = False
    room = room_around(solid)
    assert room[5, 5, 7] == pytest.approx(4.5)
    start = np.array([5.5, 5.5, 5.5])
    # A ball of 1.4 voxels fits through the hole of three, one of 2 does not.
    small, large = (find_fitting_places(solid, start, radius) for radius in (1.4, 2.0))
    assert small[5, 5, 22]
    assert large[5, 5, 7]
    assert not large[:, :, 15:].any()
    # A start that fits no centre is the only place.
    alone = find_fitting_places(np.ones((5, 5, 5), bool), np.array([2.5, 2.5, 2.5]), 1.0)
    assert alone.sum() == 1
