"""Areas that a robot must not enter: which cells they close, and what follows from that."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxplore import DifferentialDrive, ExplorationScenario, Lidar, OccupancyGrid, Perception
from jaxplore.parts import KeepOut, Targets

SHAPE, SIDE = (20, 30), 0.2
LIDAR, ROBOT = Lidar(36, 2.0), DifferentialDrive(max_speed=1.0, radius=0.15)
START = (0.9, 2.0, 0.0)
BOX = [(2.0, 1.0), (3.0, 1.0), (3.0, 3.0), (2.0, 3.0)]
"""In the middle of the hall."""
NUMBERS = {"num_directions": 4, "max_clearance": 0.5}
close = eqx.filter_jit(KeepOut.init)


def hall(probability=0.01) -> OccupancyGrid:
    """Return a hall of 6 m by 4 m."""
    cells = np.full(SHAPE, probability, np.float32)
    cells[[0, -1]], cells[:, [0, -1]] = 0.99, 0.99
    return OccupancyGrid(cells, SIDE)


corner = st.tuples(st.floats(0.5, 5.5), st.floats(0.5, 3.5))


@given(st.lists(corner, min_size=3, max_size=3), st.floats(-3.0, 3.0), st.floats(-5.0, 5.0))
def test_every_cell_that_an_area_touches_is_closed_and_none_far_from_it(corners, yaw, shift):
    """Against points that are spread over a triangle, on a map with any pose."""
    a, b, c = np.array(corners)
    if abs(np.linalg.det(np.stack([b - a, c - a]))) < 0.05:
        return
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    origin = np.array([shift, 0.5 * shift])
    grid = OccupancyGrid(np.full(SHAPE, 0.5, np.float32), SIDE, (*origin, yaw))
    rng = np.random.default_rng(0)
    weights = rng.dirichlet(np.ones(3) * 0.5, 4000)
    inside = weights @ np.stack([a, b, c])
    area = np.stack([a, b, c]) @ turn.T + origin
    closed = np.asarray(close(KeepOut([area.astype(np.float32)]), grid))
    rows, columns = (inside[:, ::-1] / SIDE).astype(int).T
    assert closed[rows, columns].all()
    centres = SIDE * (np.argwhere(closed)[:, ::-1] + 0.5)
    away = np.hypot(*(centres[:, None] - inside).transpose(2, 0, 1)).min(axis=1)
    # Points are dense at the corners and the edges, and 0.15 m apart within at most.
    assert (away <= SIDE * math.sqrt(0.5) + 0.15).all()


@pytest.mark.long
def test_a_mask_closes_the_cells_that_it_occupies() -> None:
    marks = np.full((8, 10), 0.01, np.float32)
    marks[2:4, 5:9] = 1.0
    marks[6, 1] = 0.5  # unknown in the mask: open
    mask = OccupancyGrid(marks, 0.5, (1.0, -1.0, 0.0))
    closed = np.asarray(close(KeepOut(mask=mask), hall()))
    y, x = SIDE * (np.stack(np.mgrid[: SHAPE[0], : SHAPE[1]]) + 0.5)
    row, column = np.floor((y + 1.0) / 0.5).astype(int), np.floor((x - 1.0) / 0.5).astype(int)
    on_mask = (row >= 0) & (row < 8) & (column >= 0) & (column < 10)
    expected = on_mask & (marks[np.clip(row, 0, 7), np.clip(column, 0, 9)] > 0.9)
    np.testing.assert_array_equal(closed, expected)
    assert 0 < expected.sum() < expected.size
    both = np.asarray(close(KeepOut([BOX], mask), hall()))
    np.testing.assert_array_equal(both, closed | np.asarray(close(KeepOut([BOX]), hall())))


@pytest.fixture(scope="module")
def perceptions() -> tuple[Perception, Perception]:
    """Return a perception with the box, and one without."""
    return tuple(
        Perception(LIDAR, SIDE, ROBOT.radius, parts=parts, **NUMBERS)
        for parts in ([KeepOut([BOX])], [])
    )


@pytest.mark.long
def test_paths_keep_from_closed_cells_as_from_walls(perceptions) -> None:
    pose = jnp.asarray(START)
    limited, free = (eqx.filter_jit(each.init)(hall(), pose) for each in perceptions)
    closed = np.asarray(limited.parts["keep_out"])
    assert (np.asarray(limited.clearance.values)[closed] == 0.0).all()
    solid = eqx.filter_jit(perceptions[1].init)(hall().with_solid(jnp.asarray(closed)), pose)
    np.testing.assert_array_equal(limited.clearance.values, solid.clearance.values)
    assert (np.asarray(free.clearance.values)[closed] > 0.0).any()
    # A map from elsewhere, such as that of a fleet, keeps them closed.
    again = eqx.filter_jit(perceptions[0].with_map)(limited, hall())
    np.testing.assert_array_equal(again.clearance.values, limited.clearance.values)


@pytest.mark.long
def test_a_scan_into_an_area_leaves_it_closed(perceptions) -> None:
    pose = jnp.asarray((1.5, 2.0, 0.0))
    belief = eqx.filter_jit(perceptions[0].init)(hall(0.5), pose)
    scan = eqx.filter_jit(LIDAR.scan)(hall(), pose, key=jax.random.key(0))
    after = eqx.filter_jit(perceptions[0].observe)(belief, scan, pose)
    seen = np.asarray(after.grid.is_free & belief.parts["keep_out"])
    assert seen.sum() > 5
    assert (np.asarray(after.clearance.values)[seen] == 0.0).all()


@pytest.mark.long
def test_the_unknown_of_an_area_has_no_information_and_hides_none(perceptions) -> None:
    """On a map of which the box and what is to the right of it are unknown."""
    cells = np.array(hall().probability)
    cells[1:-1, 10:-1] = 0.5
    grid, pose = OccupancyGrid(cells, SIDE), jnp.asarray((1.5, 2.0, 0.0))
    limited, free = (eqx.filter_jit(each.init)(grid, pose) for each in perceptions)
    left = slice(4, 16), slice(5, 9)  # nodes of one cell, up to one metre before the box
    stride = perceptions[0].field_sensor.stride
    nodes = tuple(slice(each.start // stride, each.stop // stride) for each in left)
    ahead = [np.asarray(each.information.total)[nodes] for each in (limited, free)]
    assert ahead[0].max() < 0.5 * ahead[1].max()
    # From beside the box, 1 m before its far side, the unknown behind it counts.
    beyond = np.asarray(limited.information.total)[8 // stride, 12 // stride]
    cells[np.asarray(limited.parts["keep_out"]) & (cells == 0.5)] = 0.001
    as_free = eqx.filter_jit(perceptions[1].init)(OccupancyGrid(cells, SIDE), pose)
    same = np.asarray(as_free.information.total)[8 // stride, 12 // stride]
    assert beyond == pytest.approx(same, rel=0.02)
    assert beyond > 1.0


def scenario(**more) -> ExplorationScenario:
    perception = Perception(LIDAR, SIDE, ROBOT.radius, parts=[KeepOut([BOX])], **NUMBERS)
    given = {"start": START, "perception": perception, **more}
    return ExplorationScenario(hall(), ROBOT, LIDAR, **given)


def test_what_is_in_an_area_does_not_count_as_reachable() -> None:
    closed = np.asarray(close(KeepOut([BOX]), hall()))
    made = scenario()
    assert not (np.asarray(made.reachable) & closed).any()
    assert np.asarray(made.reachable)[:, 20:].any()  # there is a way around
    np.testing.assert_array_equal(made.map_arrays.crop().traversable, ~closed)
    # The true map is as it was: a lidar sees through.
    np.testing.assert_array_equal(made.world.probability, hall().probability)


def test_an_area_over_the_start_or_around_all_targets_is_named() -> None:
    with pytest.raises(ValueError, match=r"start is \(2.5, 2\), in a keep-out area; accepted: out"):
        scenario(start=(2.5, 2.0, 0.0))
    with pytest.raises(ValueError, match="targets are 2, all in keep-out areas; accepted: one out"):
        scenario(truths=[Targets([(2.4, 2.0), (2.6, 2.0)])])
    assert scenario(truths=[Targets([(2.4, 2.0), (4.6, 2.0)])]).ends_by_parts
    area = [KeepOut([BOX])]
    to_box = Perception(LIDAR, SIDE, ROBOT.radius, parts=area, goal=(2.5, 2.0), **NUMBERS)
    with pytest.raises(ValueError, match=r"goal is .*which a robot of radius 0.15 m cannot reach"):
        scenario(goal=(2.5, 2.0), perception=to_box)


def test_areas_that_are_none_are_named() -> None:
    with pytest.raises(ValueError, match="areas is empty without a mask; accepted: polygons, or"):
        KeepOut()
    with pytest.raises(ValueError, match=r"areas\[0\] is .*; accepted: 3 corners or more"):
        KeepOut([[(0.0, 0.0), (1.0, 0.0)]])
    with pytest.raises(ValueError, match="number of areas is 10001; accepted: "):
        KeepOut([BOX] * 10_001)


def test_bad_settings_of_areas_get_one_line(fails, tmp_path) -> None:
    line = fails("run", "office", "--set", "keep_out.areas=[[[1,1],[2,2]]]")
    assert "areas[0] is" in line
    line = fails("run", "office", "--set", "keep_out={}")
    assert "areas is empty without a mask" in line
    line = fails("run", "office", "--set", f"keep_out.mask={tmp_path / 'none.yaml'}")
    assert "none.yaml" in line
    line = fails("run", "office", "--set", "keep_out.areas=[[[0,0],[99,0],[99,99],[0,99]]]")
    assert "in a keep-out area; accepted: outside of all" in line
