"""Boxes of a volume that a robot must not enter."""

import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import jaxplore as jx
from jaxplore.parts import IdlenessMap, KeepOutBoxes

ORIGIN, SIDE, SHAPE = np.array([1.0, -2.0, 0.5]), 0.2, (6, 8, 10)
GRID = jx.VoxelGrid(np.zeros(SHAPE), SIDE, ORIGIN)
closed_by = jax.jit(lambda boxes: _with(boxes).init(GRID))
away_from = jax.jit(lambda boxes, place: _with(boxes).distance(place))


def _with(boxes) -> KeepOutBoxes:
    return KeepOutBoxes(boxes)


@given(st.integers(0, 2**31))
def test_a_voxel_is_closed_if_a_box_reaches_into_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ends = ORIGIN + rng.uniform(-0.3, 1.0, (2, 2, 3)) * SIDE * np.array(SHAPE[::-1])
    boxes = np.concatenate([ends.min(axis=1), ends.max(axis=1) + 1e-2], axis=1).astype(np.float32)
    wanted = np.zeros(SHAPE, bool)
    for voxel in np.ndindex(SHAPE):
        low = ORIGIN + SIDE * np.array(voxel[::-1])
        for box in boxes.astype(np.float64):
            # By more than rounding.
            into = np.minimum(box[3:], low + SIDE) - np.maximum(box[:3], low)
            wanted[voxel] |= bool((into > 2e-5).all())
    np.testing.assert_array_equal(closed_by(boxes), wanted)
    place = (ORIGIN + rng.uniform(0.0, 2.0, 3)).astype(np.float32)
    # Of the points of each box, the nearest one is the place itself, moved into its ranges.
    nearest = [np.clip(place, box[:3], box[3:]).astype(np.float64) for box in boxes]
    distance = min(np.linalg.norm(place.astype(np.float64) - each) for each in nearest)
    assert float(away_from(boxes, place)) == pytest.approx(distance, abs=1e-5)


def test_boxes_and_parts_of_another_space_are_refused() -> None:
    with pytest.raises(ValueError, match=r"boxes\[0\] is .*; accepted: x_min, y_min, z_min"):
        KeepOutBoxes([[0.0, 0.0, 0.0, 1.0, 0.0, 1.0]])
    with pytest.raises(ValueError, match=r"accepted: .*6"):
        KeepOutBoxes([[0.0, 0.0, 1.0, 1.0]])
    boxes = KeepOutBoxes([[0.0, 0.0, 0.0, 1.0, 1.0, 1.0]])
    with pytest.raises(ValueError, match=r"parts\[0\] is a KeepOutBoxes, of a volume; accepted"):
        jx.Perception(jx.Lidar(8, 4.0), 0.1, 0.25, parts=[boxes])
    with pytest.raises(ValueError, match=r"parts\[0\] is a IdlenessMap, of the plane; accepted"):
        jx.VolumePerception([jx.DepthCamera(4, 3)], 0.2, 0.3, parts=[IdlenessMap()])
