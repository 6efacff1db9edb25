"""Voxels that triangles touch, against clipping each triangle at the faces of each voxel."""

import tracemalloc

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxplore.maps.files.volume_file import TOLERANCE, find_touched_voxels

SHAPE = (3, 4, 5)
SLACK = 3 * TOLERANCE
"""By which a voxel is shrunk for what must be marked, and grown for what may be [voxels]."""


def clipped(polygon: list[np.ndarray], low: np.ndarray, high: np.ndarray) -> list[np.ndarray]:
    """Return the part of a polygon in a box, after Sutherland and Hodgman."""
    for axis in range(3):
        for sign, bound in ((1.0, low[axis]), (-1.0, -high[axis])):
            inside = [sign * point[axis] - bound for point in polygon]
            kept = []
            for k, (point, depth) in enumerate(zip(polygon, inside, strict=True)):
                before, above = polygon[k - 1], inside[k - 1]
                if (depth >= 0.0) != (above >= 0.0):
                    kept.append(before + (point - before) * above / (above - depth))
                if depth >= 0.0:
                    kept.append(point)
            polygon = kept
    return polygon


def touches(corners: np.ndarray, faces: np.ndarray, slack: float) -> np.ndarray:
    """Return the voxels (D, H, W), each grown by some slack, in which a triangle has a point."""
    found = np.zeros(SHAPE, bool)
    for k, j, i in np.ndindex(*SHAPE):
        low = np.array([i, j, k], float)
        found[k, j, i] = any(
            clipped(list(corners[face]), low - slack, low + 1.0 + slack) for face in faces
        )
    return found


def of_numbers(numbers: st.SearchStrategy[float]) -> st.SearchStrategy[np.ndarray]:
    point = st.tuples(*(numbers.map(lambda each, n=n: each * n) for n in SHAPE[::-1]))
    return st.lists(point, min_size=3, max_size=5).map(np.array)


# Whole and half numbers of voxels as well: surfaces on faces and edges, and triangles without area.
CORNERS = st.one_of(
    of_numbers(st.floats(0.0, 1.0)),
    of_numbers(st.sampled_from([0.0, 0.25, 0.5, 0.75, 1.0])),
)


@settings(max_examples=60)
@given(CORNERS)
def test_what_a_triangle_touches_is_marked_and_nothing_else(corners: np.ndarray) -> None:
    faces = np.array([[k, k + 1, k + 2] for k in range(len(corners) - 2)])
    found = find_touched_voxels(corners, faces, SHAPE)
    moved = np.minimum(corners, np.array(SHAPE[::-1]) - 2 * SLACK)
    assert not (found & ~touches(corners, faces, SLACK)).any()
    assert not (touches(moved, faces, -2 * SLACK) & ~found).any()


def test_a_surface_between_two_voxels_belongs_to_the_upper_one_and_to_the_last_at_the_end() -> None:
    def layers(height: float) -> list[int]:
        corners = np.array([[0.0, 0, height], [5.0, 0, height], [5.0, 4, height], [0.0, 4, height]])
        found = find_touched_voxels(corners, np.array([[0, 1, 2], [0, 2, 3]]), SHAPE)
        assert found.all(axis=(1, 2)).tolist() == found.any(axis=(1, 2)).tolist()
        return np.flatnonzero(found.any(axis=(1, 2))).tolist()

    # In single precision 0.3 m and 0.7 m in voxels of 0.1 m are not whole numbers.
    heights = [0.0, 0.5, 1.0, float(np.float32(0.2)) / 0.1, float(np.float32(0.7)) / 0.1 - 5.0, 3.0]
    assert [layers(each) for each in heights] == [[0], [0], [1], [2], [2], [2]]


def test_a_hall_of_twelve_triangles_takes_little_more_than_its_grid() -> None:
    low, high = np.zeros(3), np.array([600.0, 200.0, 30.0])
    corners = np.array(np.meshgrid(*zip(low, high, strict=True), indexing="ij")).reshape(3, 8).T
    sides = [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]]
    faces = np.array([each for a, b, c, d in sides for each in ([a, b, c], [a, c, d])])
    tracemalloc.start()
    found = find_touched_voxels(corners, faces, (30, 200, 600))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    wanted = np.ones((30, 200, 600), bool)
    wanted[1:-1, 1:-1, 1:-1] = False
    np.testing.assert_array_equal(found, wanted)
    assert peak - found.nbytes < 60e6


def test_many_small_triangles_leave_no_hole() -> None:
    """A sphere: what is near its surface by the distance of its centre is marked."""
    u, v = np.meshgrid(np.linspace(0, np.pi, 40), np.linspace(0, 2 * np.pi, 80), indexing="ij")
    ball = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], axis=-1)
    corners = (10.0 + 9.5 * ball).reshape(-1, 3)
    k = np.arange(39 * 80).reshape(39, 80)[:, :-1].ravel()
    faces = np.concatenate([np.stack([k, k + 1, k + 81], 1), np.stack([k, k + 81, k + 80], 1)])
    found = find_touched_voxels(corners, faces, (20, 20, 20))
    centres = np.indices(found.shape) + 0.5
    off = np.abs(np.linalg.norm(centres - 10.0, axis=0) - 9.5)
    # The triangles are up to 0.03 inside of the sphere, and a voxel reaches 0.866 from its centre.
    assert not found[off > 0.9].any()
    assert found[off < 0.45].all()
