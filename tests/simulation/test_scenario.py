import math
from collections import deque

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import DifferentialDrive, Lidar, OccupancyGrid, Perception, Scenario
from jaxplore.simulation.collision import clearance_reach, disc_clearance
from jaxplore.simulation.reachability import open_spot, reachable_cells

ROBOT = DifferentialDrive(radius=0.2)
LIDAR = Lidar(16, 1.0)


@given(st.integers(0, 2**32 - 1))
def test_reachable_cells_are_those_of_a_flood_fill(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = (rng.random((18, 22)) < 0.04).astype(np.float32)
    world[7:11, 7:11] = 0.0
    solid = [
        (r, c) for r in range(-1, 19) for c in range(-1, 23)
        if not (0 <= r < 18 and 0 <= c < 22) or world[r, c] > 0
    ]  # fmt: skip

    def has_room(row: int, column: int) -> bool:
        nearest = min(math.hypot(row - r, column - c) for r, c in solid)
        return (nearest - 0.5) * 0.1 >= 0.15 - 1e-6

    start, seen = (8, 8), set()
    if not has_room(*start):
        return
    queue = deque([start])
    while queue:
        cell = queue.popleft()
        if cell in seen or not (0 <= cell[0] < 18 and 0 <= cell[1] < 22) or not has_room(*cell):
            continue
        seen.add(cell)
        queue.extend((cell[0] + i, cell[1] + j) for i in (-1, 0, 1) for j in (-1, 0, 1))
    # The cells around the start count as beginnings, too: keep to worlds where that is the same.
    around = {(r, c) for r in (7, 8, 9) for c in (7, 8, 9) if has_room(r, c)}
    if not around <= seen:
        return
    found = reachable_cells(OccupancyGrid(world, 0.1), np.array([0.85, 0.85]), 0.15)
    assert set(map(tuple, np.argwhere(found))) == seen


@given(st.integers(0, 2**32 - 1))
def test_clearance_of_a_disc_is_the_distance_to_square_cells(seed: int) -> None:
    rng = np.random.default_rng(seed)
    solid = rng.random((20, 20)) < 0.02
    centre = rng.uniform(-1, 21, 2)
    expected = math.inf
    for row in range(-12, 32):
        for column in range(-12, 32):
            inside = 0 <= row < 20 and 0 <= column < 20
            if inside and not solid[row, column]:
                continue
            dy = max(row - centre[0], centre[0] - row - 1, 0)
            dx = max(column - centre[1], centre[1] - column - 1, 0)
            expected = min(expected, math.hypot(dx, dy))
    found = CLEARANCE(jnp.asarray(solid), jnp.asarray(centre, jnp.float32))
    assert float(found) == pytest.approx(min(expected, 7.0) * 0.1 - 0.2, abs=1e-4)


CLEARANCE = jax.jit(lambda solid, grid: disc_clearance(solid, grid, jnp.asarray(0.2), 0.1, 7))


def test_reach_covers_radius_and_margin() -> None:
    assert clearance_reach(0.2, 0.1, 0.5) >= 7


def test_open_spot_has_the_most_room() -> None:
    world = np.ones((20, 30), np.float32)
    world[5:16, 10:25] = 0.0
    x, y = open_spot(OccupancyGrid(world, 0.1, (5.0, 0.0, 0.0)), 0.2)
    assert 5.0 + 1.5 < x < 5.0 + 2.0
    assert y == pytest.approx(1.05)
    with pytest.raises(ValueError, match="no place for a robot of radius 3 m"):
        open_spot(OccupancyGrid(world, 0.1), 3.0)


WORLD = np.zeros((30, 30), np.float32)
WORLD[10, :] = 1.0
WORLD[20, :] = 0.5


@pytest.mark.parametrize(
    ("start", "reason"),
    [
        ((9.0, 1.0, 0.0), "off the map; accepted: free space within x 0 to 3, y 0 to 3"),
        ((-0.1, 1.0, 0.0), "off the map"),
        ((1.5, 1.05, 0.0), r"in a wall; accepted: free space, for example \("),
        ((1.5, 2.05, 0.0), "in unknown space"),
        ((1.5, 0.85, 0.0), "where a robot of radius 0.2 m touches something"),
        ((0.05, 0.5, 0.0), "touches something"),
        ((math.nan, 0.5, 0.0), "start is .*accepted: 3 finite numbers"),
        ((0.5, 0.5), "start is .*accepted: 3 finite numbers"),
    ],
)
def test_bad_starts_are_named(start, reason: str) -> None:
    with pytest.raises(ValueError, match=reason) as error:
        Scenario(OccupancyGrid(WORLD, 0.1), ROBOT, LIDAR, start)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("control_rate", 0.0),
        ("sensing_rate", 60.0),
        ("field_rate", -1.0),
        ("target_coverage", 0.0),
        ("target_coverage", 1.1),
    ],
)
def test_bad_settings_are_named(argument: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{argument} is .*accepted"):
        Scenario(OccupancyGrid(WORLD, 0.1), ROBOT, LIDAR, (1.5, 0.5, 0.0), **{argument: value})


def test_off_the_map_hint_follows_a_turned_map() -> None:
    grid = OccupancyGrid(np.zeros((10, 20)), 1.0, (0.0, 0.0, math.pi / 2))
    with pytest.raises(ValueError, match=r"x -10 to .*, y .* to 20"):
        reachable_cells(grid, np.array([5.0, 5.0]), 0.2)


def test_a_perception_must_fit_the_scenario() -> None:
    grid = OccupancyGrid(WORLD, 0.1)
    for perception in (Perception(LIDAR, 0.2, 0.2), Perception(Lidar(16, 2.0), 0.1, 0.2)):
        with pytest.raises(ValueError, match=r"perception is for .*; accepted: .* 1 m and 0.1 m"):
            Scenario(grid, ROBOT, LIDAR, (1.5, 0.5, 0.0), perception=perception)
