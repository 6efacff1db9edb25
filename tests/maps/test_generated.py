import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from jaxplore.maps.generators.generated import KINDS, generate_map
from jaxplore.maps.generators.office import ROBOT_RADIUS, START_CLEARANCE, office, start_pose
from jaxplore.maps.occupancy_grid import OccupancyGrid
from jaxplore.simulation.exploration.reachability import reachable_cells

DIFFICULTIES = (0.0, 0.5, 1.0)
SEEDS = range(4)
EIGHT_NEIGHBOURS = np.ones((3, 3), int)


@functools.cache
def default_map(kind, seed, difficulty):
    return generate_map(kind, seed, difficulty=difficulty)


def free_cells(grid):
    return np.asarray(grid.probability) == 0


def clearance(free, resolution):
    """Return each cell centre's distance to the nearest face of an occupied cell, at most [m]."""
    return (ndimage.distance_transform_edt(free) - 0.5) * resolution


def check(grid, size, resolution):
    """Assert what holds for every map."""
    free = free_cells(grid)
    assert grid.shape == (round(size[1] / resolution), round(size[0] / resolution))
    assert grid.resolution == resolution
    assert np.asarray(grid.frame.origin).tolist() == [0.0, 0.0, 0.0]
    assert set(np.unique(np.asarray(grid.probability))) == {0.0, 1.0}
    assert not free[[0, -1]].any()
    assert not free[:, [0, -1]].any()
    assert ndimage.label(free)[1] == 1

    # A cell is a square: its corner may be half a diagonal nearer than its centre.
    surely = clearance(free, resolution) >= ROBOT_RADIUS + (math.sqrt(0.5) - 0.5) * resolution
    assert ndimage.label(surely)[1] == 1
    perhaps = clearance(free, resolution) >= ROBOT_RADIUS - 1e-6
    assert ndimage.label(perhaps, EIGHT_NEIGHBOURS)[1] == 1
    # And it gets near everything that there is to see.
    assert (ndimage.distance_transform_edt(~surely) * resolution)[free].max() < 1.5

    x, y, yaw = start_pose(grid)
    row, column = int(y / resolution), int(x / resolution)
    assert yaw == 0.0
    assert clearance(free, resolution)[row, column] >= START_CLEARANCE
    reached = reachable_cells(grid, np.array([x, y, yaw]), ROBOT_RADIUS)
    np.testing.assert_array_equal(reached, perhaps)


@pytest.mark.parametrize("difficulty", DIFFICULTIES)
@pytest.mark.parametrize("kind", KINDS)
def test_every_place_is_reachable(kind, difficulty):
    for seed in SEEDS:
        grid = default_map(kind, seed, difficulty)
        check(grid, np.multiply(grid.shape[::-1], 0.1), 0.1)
        if difficulty == 0.5:
            assert 150.0 < free_cells(grid).sum() * 0.01 < 350.0


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=5)
@given(
    seed=st.integers(0, 2**64),
    difficulty=st.floats(0.0, 1.0),
    width=st.floats(8.0, 24.0),
    height=st.floats(7.0, 20.0),
    resolution=st.floats(0.08, 0.2),
)
def test_sizes_and_resolutions(kind, seed, difficulty, width, height, resolution):
    grid = generate_map(
        kind, seed, difficulty=difficulty, size=(width, height), resolution=resolution
    )
    check(grid, (width, height), resolution)


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_gives_one_map(kind):
    maps = [free_cells(default_map(kind, seed, 0.5)) for seed in SEEDS]
    np.testing.assert_array_equal(free_cells(generate_map(kind)), maps[0])
    np.testing.assert_array_equal(free_cells(generate_map(kind, 3)), maps[3])
    for index, one in enumerate(maps):
        assert not any(np.array_equal(one, other) for other in maps[index + 1 :])


@pytest.mark.parametrize("kind", KINDS)
def test_a_harder_map_has_less_room(kind):
    def room(difficulty):
        return np.mean([clearance(free, 0.1)[free].mean() for free in free_maps(kind, difficulty)])

    easy, middle, hard = (room(difficulty) for difficulty in DIFFICULTIES)
    assert easy > middle > hard


@pytest.mark.parametrize("kind", ["rooms", "office", "cave", "warehouse", "hall", "open"])
def test_a_harder_map_has_more_in_the_way(kind):
    easy, middle, hard = (
        np.mean([free.mean() for free in free_maps(kind, difficulty)])
        for difficulty in DIFFICULTIES
    )
    assert easy > middle > hard


def free_maps(kind, difficulty):
    return [free_cells(default_map(kind, seed, difficulty)) for seed in SEEDS]


def islands(free):
    """Return how many pieces of walls one can go round; each makes a loop."""
    return ndimage.label(~free, EIGHT_NEIGHBOURS)[1] - 1


def test_a_hard_maze_has_one_way_and_an_easy_one_no_dead_ends():
    for seed in SEEDS:
        easy, middle, hard = (
            free_cells(default_map("maze", seed, difficulty)) for difficulty in DIFFICULTIES
        )
        assert islands(hard) == 0
        assert islands(easy) >= 8
        assert islands(middle) >= 3
        assert dead_ends(easy, 7, 6) == 0
        assert dead_ends(hard, 11, 9) >= 8


def dead_ends(free, columns, rows):
    """Return the number of squares of a maze that are open to one side."""
    height, width = free.shape
    y = 1 + (np.arange(rows) + 0.5) * (height - 2) / rows
    x = 1 + (np.arange(columns) + 0.5) * (width - 2) / columns
    step = (height - 2) / rows, (width - 2) / columns
    y, x = np.meshgrid(y, x, indexing="ij")

    def is_open(down, right):
        share = np.linspace(0.0, 1.0, 60)[:, None, None]
        rows = np.clip(y + down * step[0] * share, 0, height - 1).astype(int)
        columns = np.clip(x + right * step[1] * share, 0, width - 1).astype(int)
        return free[rows, columns].all(axis=0)

    ways = sum(is_open(*side).astype(int) for side in ((0, 1), (1, 0), (0, -1), (-1, 0)))
    return int((ways == 1).sum())


def test_an_office_without_difficulty_is_the_office():
    here = generate_map("office", 5, difficulty=0.0, size=(15.0, 11.0), resolution=0.15)
    there = office(5, width=15.0, height=11.0, resolution=0.15)
    np.testing.assert_array_equal(here.probability, there.probability)
    crates = free_cells(default_map("office", 0, 0.0)) & ~free_cells(default_map("office", 0, 1.0))
    assert ndimage.label(crates, EIGHT_NEIGHBOURS)[1] > 8


def test_a_start_is_not_in_a_lane_too_narrow_for_it():
    free = np.zeros((40, 60), bool)
    free[2:8, 2:58] = True  # the longest rows, 0.6 m together
    free[12:38, 20:50] = True
    free[8:12, 30:36] = True
    world = OccupancyGrid((~free).astype(np.float32), 0.1)
    x, y, _ = start_pose(world)
    assert (x, y) == pytest.approx((2.55, 2.45))


def test_rooms_have_doors_and_several_sizes():
    for free in free_maps("rooms", 0.5):
        # What is broader than a door falls apart into rooms.
        places, count = ndimage.label(clearance(free, 0.1) > 0.65)
        sizes = np.bincount(places.ravel())[1:]
        assert count >= 8
        assert sizes.max() > 3 * np.median(sizes)


def test_a_cave_is_the_same_at_another_resolution():
    coarse = free_cells(generate_map("cave", 2, resolution=0.2))
    fine = free_cells(default_map("cave", 2, 0.5))[::2, ::2]
    assert (coarse == fine).mean() > 0.93


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ({"size": (7.9, 9.0)}, "size[0] is 7.9"),
        ({"size": (9.0, 6.9)}, "size[1] is 6.9"),
        ({"size": (math.inf, 9.0)}, "size[0] is inf"),
    ],
)
def test_refusals(arguments, named):
    with pytest.raises(ValueError, match="accepted") as caught:
        generate_map(**{"kind": "hall", **arguments})
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("size", [(9.0,), (9.0, 9.0, 9.0), 9.0])
def test_a_size_is_a_pair(size):
    # TypeError where the run-time type checks of the test session come first.
    with pytest.raises((ValueError, TypeError)):
        generate_map("hall", size=size)
