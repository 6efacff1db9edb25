"""People who walk to and fro on a map."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore.maps.generators.office import office
from jaxplore.maps.generators.people import CORNERS, walking_people
from jaxplore.maps.occupancy_grid import OccupancyGrid

OFFICE = office(3, width=12.0, height=9.0)


def steps_along(path) -> np.ndarray:
    """Return points along a closed way, at most 2 cm apart."""
    corners = np.array([*path, path[0]])
    parts = []
    for start, end in itertools.pairwise(corners):
        number = 1 + int(np.hypot(*(end - start)) / 0.02)
        parts.append(start + np.linspace(0.0, 1.0, number + 1)[:, None] * (end - start))
    return np.concatenate(parts)


@settings(max_examples=15)
@given(seed=st.integers(0, 1000), radius=st.sampled_from([0.2, 0.3]))
def test_nobody_walks_through_a_wall(seed: int, radius: float) -> None:
    people = walking_people(OFFICE, 3, speed=1.2, radius=radius, seed=seed)
    solid = np.argwhere(~np.asarray(OFFICE.is_free))
    low = np.stack([solid[:, 1], solid[:, 0]], 1) * OFFICE.resolution
    for each in people:
        assert each.speed == 1.2
        assert each.radius == radius
        assert len(each.path) == CORNERS
        for point in steps_along(each.path)[::5]:
            away = np.maximum(np.maximum(low - point, point - low - OFFICE.resolution), 0.0)
            # Straight parts are checked cell by cell, to half a diagonal.
            assert np.hypot(*away.T).min() > radius - 0.75 * OFFICE.resolution
    assert people == walking_people(OFFICE, 3, speed=1.2, radius=radius, seed=seed)


def test_most_have_a_way_to_go() -> None:
    people = walking_people(OFFICE, 12, seed=1)
    lengths = [np.hypot(*np.diff(np.array(each.path), axis=0).T).sum() for each in people]
    assert np.median(lengths) > 4.0
    assert walking_people(OFFICE, 0) == ()


def test_a_map_without_room_is_named() -> None:
    narrow = OccupancyGrid(np.where(np.arange(9)[:, None] == 4, 0.0, 1.0) * np.ones((9, 9)), 0.1)
    with pytest.raises(ValueError, match=r"radius is 0.3; accepted: people who fit"):
        walking_people(narrow, 2)
