"""Errors of trajectories and maps: against motions that are known, and counts by plain loops."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxplore as jx
from jaxplore.report import (
    Alignment,
    absolute_error,
    align,
    aligned_coverage,
    map_agreement,
    relative_error,
)

seeds = st.integers(0, 2**32 - 1)
angles = st.floats(-7.0, 7.0)


def moved_poses(motion: Alignment, poses: np.ndarray) -> np.ndarray:
    return np.column_stack([motion.apply(poses[:, :2]), poses[:, 2] + motion.yaw])


def drive(seed: int, number: int = 60) -> np.ndarray:
    rng = np.random.default_rng(seed)
    yaw = np.cumsum(0.2 * rng.standard_normal(number))
    steps = 0.2 * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    return np.column_stack([np.cumsum(steps, axis=0), yaw])


def grid(cells: np.ndarray, resolution: float = 0.1, origin=(0.0, 0.0, 0.0)) -> jx.OccupancyGrid:
    return jx.OccupancyGrid(np.where(cells, 0.9, 0.1), resolution, origin)


@given(seeds, angles, st.floats(-1e3, 1e3), st.floats(-1e3, 1e3))
def test_a_rigid_motion_is_undone(seed: int, yaw: float, x: float, y: float) -> None:
    true = drive(seed)
    motion = Alignment(yaw, np.array([x, y]))
    estimated = moved_poses(motion.inverse(), true)
    found = align(true, estimated)
    assert math.remainder(found.yaw - yaw, math.tau) == pytest.approx(0.0, abs=1e-10)
    np.testing.assert_allclose(found.apply(estimated[:, :2]), true[:, :2], atol=1e-9)
    # Turns by whole circles are no error.
    estimated[:, 2] += math.tau * np.random.default_rng(seed).integers(-3, 4, len(true))
    error = absolute_error(true, estimated)
    assert max(error) < 1e-9
    drift = relative_error(true, estimated, 2.0)
    assert drift is not None
    assert max(drift[:2]) < 1e-9


@given(seeds, angles)
def test_no_other_motion_is_closer(seed: int, yaw: float) -> None:
    rng = np.random.default_rng(seed)
    true, estimated = rng.normal(size=(2, 12, 2))
    best = align(true, estimated)

    def squares(motion: Alignment) -> float:
        return float(((motion.apply(estimated) - true) ** 2).sum())

    # With any rotation the best translation is between the means.
    other = Alignment(yaw, np.zeros(2))
    other = other._replace(translation=true.mean(axis=0) - other.apply(estimated.mean(axis=0)))
    assert squares(best) <= squares(other) + 1e-9
    assert squares(best) <= squares(best._replace(translation=best.translation + 0.01))


@given(seeds, angles, st.floats(-50.0, 50.0))
def test_errors_do_not_depend_on_the_frame_of_the_estimate(seed: int, yaw: float, x: float) -> None:
    rng = np.random.default_rng(seed)
    true = drive(seed)
    estimated = true + 0.1 * rng.standard_normal(true.shape)
    elsewhere = moved_poses(Alignment(yaw, np.array([x, -x])), estimated)
    np.testing.assert_allclose(
        absolute_error(true, elsewhere), absolute_error(true, estimated), atol=1e-9
    )
    np.testing.assert_allclose(
        relative_error(true, elsewhere, 1.0), relative_error(true, estimated, 1.0), atol=1e-9
    )


def test_absolute_errors_by_hand() -> None:
    # Errors that neither shift nor turn the whole: the best alignment is none.
    true = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    away = np.array([[0.4, 0, 0.3], [-0.4, 0, -0.3], [0, 0.2, 0.3], [0, -0.2, -0.3]])
    error = absolute_error(true, true + away)
    assert error.rms == pytest.approx(math.sqrt((0.4**2 + 0.2**2) / 2))
    assert (error.median, error.greatest) == pytest.approx((0.3, 0.4))
    assert error.rms_yaw == pytest.approx(0.3)


def test_one_wrong_turn_is_an_error_of_the_pieces_that_hold_it() -> None:
    true = np.column_stack([np.arange(11.0), np.zeros(11), np.zeros(11)])
    bent = true.copy()
    # At x = 5 the estimate turns by 90 degrees.
    bent[5:] = np.column_stack([np.full(6, 5.0), np.arange(6.0), np.full(6, math.pi / 2)])
    drift = relative_error(true, bent, 2.0)
    assert drift is not None
    # Pieces begin at 0 to 8. Those at 3 and 4 end with the turn; that at 4 ends at (5, 1) instead
    # of (6, 0). Those from 5 on hold no error.
    assert drift.number == 9
    assert drift.yaw == pytest.approx(math.pi / 2 * math.sqrt(2 / 9))
    assert drift.translation == pytest.approx(math.sqrt(2.0 / 9))
    assert relative_error(true, bent, 10.5) is None
    whole = relative_error(true, bent, 10.0)
    assert whole is not None
    assert whole.number == 1


@pytest.mark.parametrize(
    ("true", "estimated", "message"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3)), r"^true has shape \(0, 3\); accepted: finite"),
        (np.zeros((3, 3)), np.zeros((4, 3)), r"^estimated has shape \(4, 3\); accepted: that of"),
        (np.zeros((3, 4)), np.zeros((3, 4)), r"^true has shape \(3, 4\)"),
        (np.full((3, 3), np.nan), np.zeros((3, 3)), r"^true has a value nan; accepted"),
        (np.array([["a"]]), np.zeros((1, 3)), r"^true is an array of shape \(1, 1\); accepted"),
    ],
)
def test_wrong_trajectories_are_refused(true, estimated, message: str) -> None:
    for measure in (align, absolute_error, lambda p, q: relative_error(p, q, 1.0)):
        with pytest.raises(ValueError, match=message):
            measure(true, estimated)


def near(cell: tuple[int, int], others: set[tuple[int, int]]) -> bool:
    row, column = cell
    return any(
        (row + down, column + right) in others for down in (-1, 0, 1) for right in (-1, 0, 1)
    )


def counted(
    reference: np.ndarray, belief: set[tuple[int, int]], reach: float
) -> tuple[float, float]:
    """Count cell by cell."""
    walls = {(int(row), int(column)) for row, column in np.argwhere(reference)}
    found = {cell for cell in walls if near(cell, belief)}
    right = {cell for cell in belief if near(cell, walls)}
    matched = (len(found) + len(right)) / 2
    unmatched = len(walls) + len(belief) - len(found) - len(right)
    doubled = [
        cell
        for cell in belief - right
        if any(math.dist(cell, other) <= reach + 1e-9 for other in found)
    ]
    iou = matched / (matched + unmatched) if walls or belief else 1.0
    return iou, len(doubled) / len(belief) if belief else 0.0


@given(
    seeds,
    st.sampled_from([0.0, 0.02, 0.1, 0.4]),
    st.integers(-6, 6),
    st.integers(-6, 6),
    st.integers(0, 3),
    st.sampled_from([0.3, 0.5, 100.0]),
)
def test_moved_maps_agree_as_counted_by_loops(
    seed: int, density: float, down: int, right: int, quarters: int, within: float
) -> None:
    rng = np.random.default_rng(seed)
    reference, belief = rng.random((9, 12)) < density, rng.random((11, 7)) < density
    # By quarter turns around the origin and whole cells: cells get onto cells.
    motion = Alignment(quarters * math.pi / 2, 0.1 * np.array([right, down]))
    cells = set()
    for row, column in np.argwhere(belief):
        x, y = column + 0.5, row + 0.5
        for _ in range(quarters):
            x, y = -y, x
        cells.add((math.floor(y + down), math.floor(x + right)))
    found = map_agreement(grid(reference), grid(belief), motion, doubled_within=within)
    expected = counted(reference, cells, within / 0.1)
    assert (found.iou, found.double_walls) == pytest.approx(expected)
    assert (found.num_reference, found.num_belief) == (reference.sum(), belief.sum())


@given(seeds, st.sampled_from([0.02, 0.1, 0.4]))
def test_agreement_is_symmetric(seed: int, density: float) -> None:
    one, other = np.random.default_rng(seed).random((2, 9, 12)) < density
    there, back = map_agreement(grid(one), grid(other)), map_agreement(grid(other), grid(one))
    assert there.iou == back.iou
    assert map_agreement(grid(one), grid(one)).iou == 1.0
    assert map_agreement(grid(one), grid(one)).double_walls == 0.0


@given(seeds, angles, st.floats(-20.0, 20.0))
def test_the_frames_of_the_maps_do_not_matter(seed: int, yaw: float, x: float) -> None:
    one, other = np.random.default_rng(seed).random((2, 9, 12)) < 0.1
    # Origins are stored in single precision.
    place = np.float32([x, -x, yaw]).astype(float)
    motion = Alignment(float(place[2]), place[:2])
    expected = map_agreement(grid(one), grid(other))
    # The belief in a frame of its own, and the alignment that brings it back.
    placed = grid(other, origin=place.tolist())
    assert map_agreement(grid(one), placed, motion.inverse()) == expected
    assert map_agreement(grid(one, origin=place.tolist()), placed) == expected


def test_a_wall_that_is_drawn_twice() -> None:
    reference, belief = np.zeros((2, 30, 20), bool)
    reference[10, :] = True
    belief[10, :10] = belief[14, :10] = True
    # Four cells behind the wall, beside its mapped half. The other half is not in the belief, so
    # what is near it alone is a wall in the wrong place, and no second one.
    assert map_agreement(grid(reference), grid(belief)).double_walls == pytest.approx(0.5)
    assert map_agreement(grid(reference), grid(belief), doubled_within=0.3).double_walls == 0.0
    belief[10, :10] = False
    assert map_agreement(grid(reference), grid(belief)) == (0.0, 0.0, 20, 10)


def test_coverage_counts_reachable_cells_that_are_known_to_be_free() -> None:
    reachable = np.zeros((8, 8), bool)
    reachable[2:6, 2:6] = True
    known = np.full((8, 8), 0.5)
    known[2:6, 2:4] = 0.1  # the left half
    known[0, 0] = 0.1  # not reachable
    known[4, 4] = 0.9
    world = jx.OccupancyGrid(np.zeros((8, 8)), 0.1)
    belief = jx.OccupancyGrid(known, 0.1)
    assert aligned_coverage(world, reachable, belief) == pytest.approx(0.5)
    # In truth the belief lies two cells to the right, and covers the right half.
    right = Alignment(0.0, np.array([0.2, 0.0]))
    assert aligned_coverage(world, reachable, belief, right) == pytest.approx(0.5)
    assert aligned_coverage(world, reachable, belief, right.inverse()) == pytest.approx(0.0)
    away = Alignment(1.0, np.array([1e300, 0.0]))
    assert aligned_coverage(world, reachable, belief, away) == 0.0
    # Padding changes nothing.
    same = aligned_coverage(world.pad((9, 16)), np.pad(reachable, ((0, 1), (0, 8))), belief)
    assert same == pytest.approx(0.5)
    assert map_agreement(world.pad((9, 16)), belief.pad((9, 16))).num_reference == 0


def test_wrong_maps_are_refused() -> None:
    one = grid(np.ones((4, 4), bool))
    with pytest.raises(ValueError, match=r"^belief has cells of 0.2 m; accepted: 0.1 m"):
        map_agreement(one, grid(np.ones((4, 4), bool), 0.2))
    with pytest.raises(ValueError, match=r"^alignment is .*nan.*; accepted: finite numbers"):
        map_agreement(one, one, Alignment(math.nan, np.zeros(2)))
    with pytest.raises(ValueError, match=r"^doubled_within is 0.0; accepted"):
        map_agreement(one, one, doubled_within=0.0)
    with pytest.raises(ValueError, match=r"^reachable has no cell; accepted"):
        aligned_coverage(one, np.zeros((4, 4), bool), one)
    with pytest.raises(ValueError, match=r"^reachable is an array of shape \(2, 2\) of bool"):
        aligned_coverage(one, np.zeros((2, 2), bool), one)
