"""The datum of maps far from the origin, and what is refused without one."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import OccupancyGrid
from jaxplore.geometry import line_path
from jaxplore.maps import Datum, World, map_datum, path_datum, read_path, relative_world
from jaxplore.maps.frame import GridFrame

UTM = (500_000.0, 4_649_776.0)
far = st.floats(-1e8, 1e8)
near = st.integers(-(2**20), 2**20).map(lambda number: number / 1024.0)
"""Coordinates up to a kilometre, whose sum with a far one is exact."""


@given(far, far, st.lists(st.tuples(near, near, near), min_size=1, max_size=5))
def test_what_is_moved_to_a_datum_and_back_stays(x, y, points) -> None:
    datum, given_ = Datum.near(x, y), np.array(points)
    there = given_ + np.array([datum.x, datum.y, 0.0])
    if datum:
        # In whole metres the sum is exact, so only the rounding to micrometres is left.
        np.testing.assert_allclose(datum.to_local(there), np.round(given_, 6), rtol=0, atol=6e-7)
        np.testing.assert_allclose(datum.to_map(datum.to_local(there)), there, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(datum.to_map(given_), there)
    np.testing.assert_array_equal(datum.to_local(there)[:, 2], given_[:, 2])
    assert abs(datum.to_local([x, y])).max() <= 1024.0


@given(st.integers(-(10**9), 10**9), st.integers(0, 10**6))
def test_decimal_fractions_are_the_same_numbers_far_away(metres, millionths) -> None:
    datum = Datum(float(metres), 0.0)
    local = datum.to_local([float(f"{metres}.{millionths:06d}"), 0.0])[0] if metres else None
    if metres and abs(metres) < 10**8:
        assert local == math.copysign(round(millionths / 1e6, 6), metres)


@given(st.floats(-1024.0, 1024.0), st.floats(-1024.0, 1024.0))
def test_ordinary_maps_stay_as_they_are(x, y) -> None:
    datum, points = Datum.near(x, y), np.array([[x, y]], np.float32)
    assert not datum
    assert datum.to_local(points) is points
    assert datum.to_map(points) is points


@given(st.floats(1e-3, 10.0), st.floats(0.0, 1e9))
def test_an_origin_that_single_precision_does_not_resolve_is_refused(resolution, x) -> None:
    gap = float(np.spacing(np.float32(x)))
    if gap > resolution / 50.0:
        with pytest.raises(ValueError, match=r"^origin has a coordinate of .*; accepted: less"):
            GridFrame(resolution, (0.0, -x, 0.0))
    else:
        GridFrame(resolution, (0.0, -x, 0.0))


def test_the_map_of_a_city_needs_a_datum_and_keeps_its_origin(tmp_path) -> None:
    origin, values = (*UTM, 0.3), np.zeros((4, 5), np.float32)
    message = "origin has a coordinate of 4649776 m, where single precision resolves 0.5 m"
    with pytest.raises(ValueError, match=f"{message}; accepted: less than 16384 m, .*maps.Datum"):
        OccupancyGrid(values, 0.05, origin)
    datum, file = Datum.near(*UTM), tmp_path / "map.yaml"
    OccupancyGrid(values, 0.05, (0.0, 0.0, 0.3)).to_ros(file, datum=datum)
    with pytest.raises(ValueError, match=message):
        OccupancyGrid.from_ros(file)
    assert map_datum(file) == datum == Datum(*UTM)
    grid = OccupancyGrid.from_ros(file, datum=datum)
    np.testing.assert_array_equal(grid.frame.origin, np.float32([0.0, 0.0, 0.3]))
    assert f"origin: [{UTM[0]}, {UTM[1]}, 0.3" in file.read_text()


def test_a_path_far_away_needs_a_datum_and_has_the_same_shape(tmp_path) -> None:
    points = np.array([[0.0, 0.0], [3.3, 0.7], [5.1, 4.2], [9.9, 4.4]])
    files = [tmp_path / name for name in ("here.csv", "there.csv")]
    for file, offset in zip(files, ((0.0, 0.0), UTM), strict=True):
        file.write_text("\n".join(f"{x:.6f}, {y:.6f}" for x, y in points + offset))
    with pytest.raises(ValueError, match=r"there.csv: position has a coordinate of 46497[0-9.]+ m"):
        read_path(files[1])
    here, there = read_path(files[0]), read_path(files[1], datum=path_datum(files[1]))
    np.testing.assert_array_equal(here.points, there.points)
    np.testing.assert_array_equal(here.tangents, there.tangents)
    assert path_datum(files[0]) == Datum()
    # Paths of ten kilometres need none.
    line_path((0.0, 0.0), (10_000.0, 0.0))


def test_what_is_beyond_a_datum_is_refused(tmp_path) -> None:
    file = tmp_path / "path.csv"
    file.write_text("2e9, 0\n2e9, 5\n")
    accepted = r"accepted: coordinates up to 1e\+09 m"
    with pytest.raises(ValueError, match=rf"path.csv, waypoint 1 is \[2000000000, 0\]; {accepted}"):
        path_datum(file)


@pytest.mark.parametrize("offset", [UTM, (-3e6, 2.5e5), (999_999_000.0, 0.0)])
def test_a_world_far_away_is_that_near_the_origin(offset) -> None:
    entries = {
        "size": [6.1, 5.3],
        "resolution": 0.1,
        "start": [1.3, 1.2, 0.4],
        "goal": [5.2, 4.4, -2.0],
        "walls": [[0, 0, 6.1, 0]],
        "rectangles": [[2.2, 2.2, 2.9, 3.1]],
        "hidden": {"discs": [[4.1, 1.3, 0.2]]},
        "gone": {"rectangles": [[0.5, 4.1, 0.9, 4.7]]},
        "zones": [[3.0, 0.0, 6.1, 5.3]],
        "forbidden": [[1.0, 3.0, 2.0, 5.0]],
        "hills": [[3.3, 3.3, 0.4, 1.2]],
        "targets": [[5.3, 0.8]],
        "objects": [{"position": [5.5, 3.1], "label": "dog"}],
        "movers": [{"path": [[1.1, 4.4], [1.9, 4.6]], "speed": 0.3, "radius": 0.2}],
    }
    world = World.from_dict(entries)
    # The world is written as a file of such a map is: in decimal numbers.
    there = relative_world(world, Datum(-offset[0], -offset[1]))
    assert there.start == (*np.round(np.add(offset, (1.3, 1.2)), 6), 0.4)
    assert relative_world(there, Datum.near(*there.origin)) == world
    assert relative_world(world, Datum()) is world
    np.testing.assert_array_equal(there._cells.solid(there.known), world._cells.solid(world.known))
    assert {field.name for field in dataclasses.fields(World)} >= set(entries) - {
        "walls",
        "rectangles",
    }
