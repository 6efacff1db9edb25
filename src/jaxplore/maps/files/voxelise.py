"""Voxels that triangles touch, by exact tests of separating axes."""

import numpy as np
from numpy.typing import NDArray

TOLERANCE = 1e-4
"""Distance below a face of a voxel at which a surface counts as on the face [voxels]."""
_AT_ONCE = 1 << 13
"""Pairs of a triangle and a block that are divided at a time."""
_EIGHTHS = np.array(list(np.ndindex(2, 2, 2)), np.int32)

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]


def find_touched_voxels(
    corners: Floats, faces: NDArray[np.integer], shape: tuple[int, int, int]
) -> NDArray[np.bool_]:
    """Return the voxels (D, H, W) that the triangles of a mesh touch.

    A triangle and a cube intersect unless one of 13 axes separates them: those of the cube, the
    normal of the triangle, and the products of their edges (Akenine-Moeller, "Fast 3D triangle-box
    overlap testing", 2001). Cubes of 2^k voxels are tested from the greatest to the least, and only
    those that a triangle touches are divided: the time is proportional to the surface, and the
    memory beyond the mask is bounded. A surface between two voxels belongs to the upper one, and on
    the last face to the last one.

    Corners (N, 3) are (x, y, z) from the lower corner of the grid, all in it [voxels]. Faces (M, 3)
    are their indices. The shape is along z, y and x.
    """
    solid = np.zeros(shape, bool)
    top = np.array(shape[::-1], np.int32) - 1
    for begin in range(0, len(faces), _AT_ONCE):
        triangles = np.minimum(corners[faces[begin : begin + _AT_ONCE]] + TOLERANCE, top + 1)
        low = np.clip(np.floor(triangles.min(axis=1)).astype(np.int32), 0, top)
        high = np.clip(np.floor(triangles.max(axis=1)).astype(np.int32), 0, top)
        # At the level of its extent, a triangle is in at most two cubes along each axis.
        levels = np.ceil(np.log2(np.maximum((high - low).max(axis=1), 1))).astype(np.int32)
        for level in np.unique(levels).tolist():
            which = np.flatnonzero(levels == level)
            _divide(solid, triangles[which], low[which], high[which], level)
    return solid


def _divide(
    solid: NDArray[np.bool_], triangles: Floats, low: Integers, high: Integers, level: int
) -> None:
    """Mark the voxels that triangles touch, beginning with cubes of `2^level` voxels."""
    stack = [(level, np.arange(len(triangles), dtype=np.int32), low >> level)]
    while stack:
        level, which, corner = stack.pop()
        if len(which) > _AT_ONCE:
            for begin in range(0, len(which), _AT_ONCE):
                part = slice(begin, begin + _AT_ONCE)
                stack.append((level, which[part], corner[part]))
            continue
        cubes = (corner[:, None] + _EIGHTHS).reshape(-1, 3)
        which = np.repeat(which, len(_EIGHTHS))
        near = ((cubes >= low[which] >> level) & (cubes <= high[which] >> level)).all(axis=1)
        if level == 0:
            near[near] = ~solid[tuple(cubes[near].T[::-1])]
        which, cubes = which[near], cubes[near]
        for separates in (_normal_separates, _edges_separate):
            touches = ~separates(triangles[which], cubes, 2.0**level)
            which, cubes = which[touches], cubes[touches]
        if level == 0:
            solid[tuple(cubes.T[::-1])] = True
        elif len(which):
            stack.append((level - 1, which, cubes << 1))


def _normal_separates(triangles: Floats, cubes: Integers, size: float) -> NDArray[np.bool_]:
    """Return whether the plane of each triangle is beside its cube."""
    first = triangles[:, 0]
    normal = np.cross(triangles[:, 1] - first, triangles[:, 2] - first)
    gap = np.abs(np.einsum("ni,ni->n", normal, first - (cubes + 0.5) * size))
    return np.asarray(gap > _reach(np.abs(normal).sum(axis=1), size))


def _edges_separate(triangles: Floats, cubes: Integers, size: float) -> NDArray[np.bool_]:
    """Return whether a product of an edge of each triangle and one of its cube separates them."""
    local = triangles - ((cubes + 0.5) * size)[:, None]
    edges = np.roll(local, -1, axis=1) - local
    separate = np.zeros(len(local), bool)
    for i, j in ((1, 2), (2, 0), (0, 1)):
        along = edges[:, :, None, j] * local[:, None, :, i]
        along -= edges[:, :, None, i] * local[:, None, :, j]
        reach = _reach(np.abs(edges[..., i]) + np.abs(edges[..., j]), size)
        separate |= ((along.min(axis=2) > reach) | (along.max(axis=2) < -reach)).any(axis=1)
    return separate


def _reach(extent: Floats, size: float) -> Floats:
    """Return half the projection of a cube; rounding keeps what only touches."""
    return extent * (0.5 * size * (1.0 + 1e-9))
