"""Read volumes from files: meshes, point clouds, OctoMaps and arrays, none of which is trusted."""

import dataclasses
import math
import os
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from jaxplore import _checks, _kinds
from jaxplore._files import open_limited
from jaxplore._limits import MOST_VOXELS
from jaxplore._text import error_reason, printable_path
from jaxplore.maps.datum import ORIGIN, Datum
from jaxplore.maps.files.mesh_process import (
    AXES,
    KINDS,
    Geometry,
    check_header,
    place,
    read_geometry,
)
from jaxplore.maps.files.npz import MALFORMED_NPZ, read_array, read_arrays
from jaxplore.maps.files.octomap_file import OctoMap
from jaxplore.maps.voxel_grid import VoxelGrid

FILE_LIMIT = 500_000_000
"""Largest file of a volume that is read [bytes]."""
MEMORY = 4e9
"""Memory that reading a file may take where nothing else is said [bytes]."""
SUFFIXES = (*(f".{kind}" for kind in KINDS), ".bt", ".ot", ".npy", ".npz")
"""Endings of the files that `read_volume` reads."""
_MOST_SURFACE = 50_000_000
"""Greatest surface of a mesh [faces of voxels]: each takes some ten tests."""
_CLOUDS = ("ply", "pcd", "las", "laz")
"""Kinds of files that may hold points without faces."""

Points = NDArray[np.float64]
Triple = tuple[float, float, float]
Refuse = Callable[[str, str], ValueError]
TOLERANCE = 1e-4
"""Distance below a face of a voxel at which a surface counts as on the face [voxels]."""
_AT_ONCE = 1 << 13
"""Pairs of a triangle and a block that are divided at a time."""
_EIGHTHS = np.array(list(np.ndindex(2, 2, 2)), np.int32)

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]


@dataclasses.dataclass(frozen=True, eq=False)
class VolumeFile:
    """What the file of a volume holds, before its voxels are made: their numbers along z, y and x,
    their side [m], the corner (x, y, z) in the coordinates of the file [m], a function that makes
    the solid ones (D, H, W), and the file for messages."""

    shape: tuple[int, int, int]
    resolution: float
    origin: Triple
    make: Callable[[], NDArray[np.bool_]]
    name: str

    @property
    def datum(self) -> Datum:
        """Datum of the volume: (0, 0), or its corner in whole metres if that is far away."""
        return Datum.near(*self.origin[:2], name=f"{self.name}: origin")

    def grid(self, datum: Datum = ORIGIN) -> VoxelGrid:
        """Make the true world, relative to a datum; refuse a volume that is far from it."""
        origin = datum.to_local(np.array(self.origin))
        return VoxelGrid.solid(self.make(), self.resolution, origin.tolist())


@_kinds.check_arguments
def read_volume(
    path: str | PathLike[str],
    *,
    resolution: float = 0.1,
    scale: float | None = None,
    up: str | None = None,
    is_open: bool = False,
    min_points: int = 1,
    datum: Datum = ORIGIN,
) -> VoxelGrid:
    """Read the true world of a volume from a file.

    - `.stl`, `.obj`, `.ply`, `.glb`, `.gltf`, `.dae`: a mesh. Voxels that its triangles touch are
      solid (`pip install '.[volumes]'`).
    - `.ply` without faces, `.pcd`, `.las`, `.laz`: a point cloud; a voxel with some points in it is
      solid (likewise).
    - `.bt`, `.ot`: an OctoMap; its occupied voxels are solid, and unknown ones, too.
    - `.npy`: an array (D, H, W) of booleans, along z, y and x, true where it is solid; `.npz`: the
      same as `solid`, with `resolution` and `origin` beside it if there are.

    The volume is the box around what the file has. Beyond it nothing is free. Unit and up axis of a
    mesh or a point cloud are what is given, else what the file says, else a guess from its extents.
    A guess is warned of. A mesh or a cloud with another axis up is turned: with y up, (x, y, z) of
    the file becomes (x, -z, y).

    Args:
        path: path of the file.
        resolution: side of a voxel [m]. An OctoMap and an `.npz` with a resolution have their own.
        scale: metres in a unit of the file, 0.001 for millimetres; of meshes and point clouds.
        up: axis of the file that is up, x, y or z; of meshes and point clouds.
        is_open: whether a mesh may be open.
        min_points: points that make a voxel solid.
        datum: point to which the volume is relative; see `volume_datum`.

    Raises:
        ValueError: a file that is missing, too large, malformed or of another kind; a mesh that is
            empty, open or has too many faces; a volume with too many voxels, or far from the datum.
    """
    opened = open_volume(
        path,
        resolution=resolution,
        scale=scale,
        up=up,
        is_open=is_open,
        min_points=min_points,
    )
    return opened.grid(datum)


def volume_datum(
    path: str | PathLike[str],
    *,
    resolution: float = 0.1,
    scale: float | None = None,
    up: str | None = None,
    is_open: bool = False,
) -> Datum:
    """Return the datum for a volume: (0, 0), or its corner in whole metres if that is far away.

    The file is read for it. Arguments and errors are those of `read_volume`.

    Args:
        path: path of the file.
        resolution: side of a voxel [m].
        scale: metres in a unit of the file.
        up: axis of the file that is up.
        is_open: whether a mesh may be open.

    Raises:
        ValueError: as of `read_volume`, and a corner beyond 1e9 m.
    """
    opened = open_volume(path, resolution=resolution, scale=scale, up=up, is_open=is_open)
    return opened.datum


@_kinds.check_arguments
def open_volume(
    path: str | PathLike[str],
    *,
    resolution: float = 0.1,
    scale: float | None = None,
    up: str | None = None,
    is_open: bool = False,
    min_points: int = 1,
    memory: float = MEMORY,
) -> VolumeFile:
    """Read the file of a volume as `read_volume` does, and make no voxels yet.

    It raises as `read_volume`, and for a file that needs more than `memory` [bytes].
    """
    _kinds.flag("is_open", is_open)
    file = Path(path)
    side = _checks.number("resolution", resolution, above=0.0)
    factor = None if scale is None else _checks.number("scale", scale, above=0.0)
    if up is not None and up not in AXES:
        raise ValueError(f"up is {up!r}; accepted: {', '.join(AXES)}, or None for a guess")
    least = _checks.positive_int("min_points", min_points)
    kind, name = file.suffix.lower()[1:], printable_path(file)
    if f".{kind}" not in SUFFIXES:
        raise ValueError(f"path is {name!r}, which is no volume; accepted: {', '.join(SUFFIXES)}")

    def refuse(why: str, accepted: str) -> ValueError:
        return ValueError(f"volume {name} {why}; accepted: {accepted}")

    with open_limited(file, "a volume", FILE_LIMIT, f"volume {name} cannot be read: it") as opened:
        if kind in ("npy", "npz"):
            return _array_volume(opened, kind, side, name, refuse)
        if kind in ("bt", "ot"):
            return _octomap_volume(opened, memory, name, refuse)
        try:
            check_header(opened, kind)
            geometry = read_geometry(opened, kind, memory)
        except ValueError as error:
            raise refuse(f"cannot be read: {error}", f"a whole .{kind} file") from None
    return _geometry_volume(geometry, kind, side, factor, up, is_open, least, name, refuse)


def _geometry_volume(
    geometry: Geometry,
    kind: str,
    side: float,
    scale: float | None,
    up: str | None,
    is_open: bool,
    min_points: int,
    name: str,
    refuse: Refuse,
) -> VolumeFile:
    corners, faces = geometry.corners, geometry.faces
    is_cloud = not len(faces)
    if is_cloud and kind not in _CLOUDS:
        raise refuse("has no faces", "a mesh of triangles")
    if is_cloud:
        geometry = geometry._replace(corners=corners[np.isfinite(corners).all(axis=1)])
    elif not np.isfinite(corners).all():
        raise refuse("has corners that are not finite", "finite numbers")
    elif geometry.num_open and not is_open:
        raise refuse(
            f"is open: {geometry.num_open} edges belong to one face",
            "a closed mesh, or file.is_open=true",
        )
    if not len(geometry.corners):
        raise refuse("has no points", "a point cloud")
    points = place(geometry, scale, up, name)
    low, shape = _box(points, side, refuse)
    # In voxels, relative to the corner: far from the origin too, only small numbers are rounded.
    points -= low
    points /= side
    if is_cloud:
        return VolumeFile(shape, side, low, lambda: _count(points, shape) >= min_points, name)
    surface = len(faces) + _area(points, faces)
    if not surface <= _MOST_SURFACE:
        raise refuse(
            f"has a surface of {surface:.3g} voxels of {side:g} m",
            f"at most {_MOST_SURFACE:.3g}: a greater resolution",
        )
    return VolumeFile(shape, side, low, lambda: find_touched_voxels(points, faces, shape), name)


def _area(corners: Points, faces: NDArray[np.int32]) -> float:
    total = 0.0
    for begin in range(0, len(faces), 1 << 16):
        first, second, third = np.moveaxis(corners[faces[begin : begin + (1 << 16)]], 1, 0)
        total += 0.5 * float(np.linalg.norm(np.cross(second - first, third - first), axis=1).sum())
    return total


def _box(points: Points, side: float, refuse: Refuse) -> tuple[Triple, tuple[int, int, int]]:
    """Return the corner (x, y, z) of the box around points [m], and its voxels (D, H, W)."""
    first, last = points.min(axis=0), points.max(axis=0)
    low = np.floor(first / side + TOLERANCE) * side
    # A point on the last face belongs to the last voxel.
    sizes = np.maximum(1.0, np.ceil((last - low) / side - TOLERANCE))
    if not sizes.prod() <= MOST_VOXELS:
        x, y, z = sizes * side
        raise refuse(
            f"is {x:g} m x {y:g} m x {z:g} m, which are {sizes.prod():.3g} voxels of {side:g} m",
            f"at most {MOST_VOXELS:.3g}: a greater resolution, or file.scale=0.001 for millimetres",
        )
    width, height, depth = (int(each) for each in sizes)
    x, y, z = low.tolist()
    return (x, y, z), (depth, height, width)


def _count(points: Points, shape: tuple[int, int, int]) -> NDArray[np.int32]:
    """Return the number of points in each voxel (D, H, W)."""
    number = np.zeros(shape, np.int32)
    top = np.array(shape) - 1
    for begin in range(0, len(points), 1 << 20):
        part = np.floor(points[begin : begin + (1 << 20), ::-1] + TOLERANCE).astype(np.int64)
        np.add.at(number, tuple(np.clip(part, 0, top).T), 1)
    return number


def _octomap_volume(file: BinaryIO, memory: float, name: str, refuse: Refuse) -> VolumeFile:
    try:
        octomap = OctoMap(file.read(), memory)
    except ValueError as error:
        raise refuse(f"is malformed: {error_reason(error)}", "a whole OctoMap") from None
    _check_voxels(octomap.shape, refuse)
    return VolumeFile(octomap.shape, octomap.resolution, octomap.origin, octomap.solid, name)


def _array_volume(file: BinaryIO, kind: str, side: float, name: str, refuse: Refuse) -> VolumeFile:
    def check(what: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        if what == "solid":
            if dtype != np.bool_ or len(shape) != 3 or 0 in shape:
                raise ValueError(f"solid has shape {shape} and type {dtype}, not (D, H, W) of bool")
            _check_voxels(shape, refuse)
        elif dtype.kind not in "fiu" or dtype.itemsize > 8 or math.prod(shape) not in (1, 3):
            raise ValueError(f"{what} has shape {shape} and type {dtype}")

    origin = (0.0, 0.0, 0.0)
    try:
        if kind == "npy":
            solid = read_array(file, "solid", check, os.fstat(file.fileno()).st_size)
        else:
            arrays = read_arrays(file.read(), check, ("solid", "resolution", "origin"))
            if "solid" not in arrays:
                raise ValueError("it has no solid")
            solid = arrays["solid"]
            side = _checks.number("resolution", arrays.get("resolution", side), above=0.0)
            corner = np.asarray(arrays.get("origin", origin), np.float64)
            if corner.shape != (3,) or not np.isfinite(corner).all():
                raise ValueError(f"origin is {corner.tolist()}, not three finite numbers")
            x, y, z = corner.tolist()
            origin = (x, y, z)
    except MALFORMED_NPZ as error:
        raise refuse(
            f"is malformed: {error_reason(error)}", "a whole file of its kind with booleans"
        ) from None
    depth, height, width = solid.shape
    return VolumeFile((depth, height, width), side, origin, lambda: solid, name)


def _check_voxels(shape: tuple[int, ...], refuse: Refuse) -> None:
    if math.prod(shape) > MOST_VOXELS:
        raise refuse(
            f"has {' x '.join(map(str, shape))} voxels", f"at most {MOST_VOXELS:.3g} voxels"
        )


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
