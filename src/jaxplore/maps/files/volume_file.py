"""Read volumes from files: meshes, point clouds, OctoMaps and arrays, none of which is trusted."""

import io
import math
import re
import warnings
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jaxplore import _checks, _kinds
from jaxplore._files import MALFORMED, read_bytes
from jaxplore._limits import MOST_VOXELS
from jaxplore._optional import import_optional
from jaxplore._text import error_reason, printable_path
from jaxplore.maps.files.npz import MALFORMED_NPZ, read_arrays
from jaxplore.maps.files.octomap_file import read_octomap
from jaxplore.maps.voxel_grid import VoxelGrid

FILE_LIMIT = 500_000_000
"""Largest file of a volume that is read [bytes]."""
_MOST_FACES = 5_000_000
"""Greatest number of triangles of a mesh."""
_VAST = 500.0
"""Extent from which on a mesh may be in millimetres [m]."""

Points = NDArray[np.float64]
Solid = NDArray[np.bool_]


def read_volume(
    path: str | PathLike[str],
    *,
    resolution: float = 0.1,
    scale: float = 1.0,
    is_open: bool = False,
    min_points: int = 1,
) -> VoxelGrid:
    """Read the true world of a volume from a file.

    - `.stl`, `.obj`, `.ply`: a mesh, whose surface is solid (`pip install '.[volumes]'`).
    - `.ply` without faces, `.pcd`: a point cloud; a voxel with some points in it is solid.
    - `.bt`: an OctoMap; its occupied voxels are solid, and unknown ones, too.
    - `.npy`: an array (D, H, W) of booleans, along z, y and x, true where it is solid; `.npz`: the
      same as `solid`, with `resolution` and `origin` beside it if there are.

    The volume is the box around what the file has. Beyond it nothing is free.

    Args:
        path: path of the file.
        resolution: side of a voxel [m]. An OctoMap and an `.npz` with a resolution have their own.
        scale: metres in a unit of the file, 0.001 for millimetres; of meshes and point clouds.
        is_open: whether a mesh may be open.
        min_points: points that make a voxel solid.

    Raises:
        ValueError: a file that is missing, too large, malformed or of another kind; a mesh that is
            empty, open or has too many faces; a volume with too many voxels.
    """
    _kinds.instance("path", path, str, PathLike)
    _kinds.flag("is_open", is_open)
    file = Path(path)
    side = _checks.number("resolution", resolution, above=0.0)
    factor = _checks.number("scale", scale, above=0.0)
    least = _checks.positive_int("min_points", min_points)
    kind = file.suffix.lower()
    name = printable_path(file)
    if kind not in SUFFIXES:
        raise ValueError(f"path is {name!r}, which is no volume; accepted: {', '.join(SUFFIXES)}")
    data = read_bytes(file, "a volume", FILE_LIMIT, f"volume {name} cannot be read: it")

    def refuse(why: str, accepted: str) -> ValueError:
        return ValueError(f"volume {name} {why}; accepted: {accepted}")

    try:
        if kind in (".npy", ".npz"):
            return _from_arrays(data, kind, side)
        if kind == ".bt":
            solid, own, origin = read_octomap(data, MOST_VOXELS)
            return VoxelGrid.solid(solid, own, origin)
    except MALFORMED_NPZ as error:
        raise refuse(f"is malformed: {error_reason(error)}", "a whole file of its kind") from None
    if kind == ".pcd":
        return _from_points(_pcd_points(data, refuse), side, factor, least, refuse)
    mesh = _mesh(data, kind, refuse)
    if len(getattr(mesh, "faces", ())) == 0:
        points = np.asarray(getattr(mesh, "vertices", np.zeros((0, 3))), np.float64)
        if kind != ".ply":
            raise refuse("has no faces", "a mesh of triangles")
        return _from_points(points, side, factor, least, refuse)
    edges = np.sort(np.asarray(mesh.edges), axis=1)
    _, counts = np.unique(edges, axis=0, return_counts=True)
    # Where bodies touch, an edge belongs to four faces: that is no hole.
    number = np.count_nonzero(counts % 2)
    if number and not is_open:
        raise refuse(
            f"is open: {number} edges belong to one face",
            "a closed mesh, or file.is_open=true",
        )
    return _from_mesh(mesh, side, factor, name, refuse)


Refuse = Callable[[str, str], ValueError]


def _mesh(data: bytes, kind: str, refuse: Refuse) -> Any:
    """Return what trimesh reads: one mesh or one point cloud."""
    trimesh = import_optional("trimesh", "volumes")
    try:
        # What an OBJ names beside itself, such as materials, is not looked for.
        found = trimesh.load(
            io.BytesIO(data), file_type=kind[1:], process=True, skip_materials=True, resolver=None
        )
        if isinstance(found, trimesh.Scene):
            found = found.to_mesh()
        size = len(getattr(found, "faces", ()))
    except MALFORMED as error:
        raise refuse(f"cannot be read: {error_reason(error)}", f"a {kind} file") from None
    if size > _MOST_FACES:
        raise refuse(f"has {size} faces", f"at most {_MOST_FACES}")
    return found


def _from_mesh(mesh: Any, side: float, factor: float, name: str, refuse: Refuse) -> VoxelGrid:
    """Return the voxels that the surface of a mesh touches."""
    corners = np.asarray(mesh.vertices, np.float64) * factor
    if not np.isfinite(corners).all():
        raise refuse("has corners that are not finite", "finite numbers")
    origin, shape = _box(corners, side, refuse)
    extent = np.ptp(corners, axis=0)
    if factor == 1.0 and extent.max() > _VAST:
        x, y, z = extent
        warnings.warn(
            f"volume {name} is {x:g} m x {y:g} m x {z:g} m; if its unit is the millimetre, "
            "file.scale=0.001",
            UserWarning,
            stacklevel=3,
        )
    if float(mesh.area) * factor**2 / side**2 > MOST_VOXELS:
        raise refuse(f"has more than {MOST_VOXELS} voxels of surface", "a greater resolution")
    subdivide = import_optional("trimesh.remesh", "volumes").subdivide_to_size
    # Triangles with sides below half a voxel leave no voxel between their corners out.
    points, _ = subdivide(
        corners,
        np.asarray(mesh.faces),
        max_edge=0.5 * side,
        max_iter=40,
    )
    return VoxelGrid.solid(_counted(points, origin, shape, side) > 0, side, origin)


def _from_points(
    points: Points, side: float, factor: float, least: int, refuse: Refuse
) -> VoxelGrid:
    """Return the voxels with points in them."""
    points = points[np.isfinite(points).all(axis=1)] * factor
    if not len(points):
        raise refuse("has no points", "a point cloud")
    origin, shape = _box(points, side, refuse)
    return VoxelGrid.solid(_counted(points, origin, shape, side) >= least, side, origin)


def _box(
    points: Points, side: float, refuse: Refuse
) -> tuple[tuple[float, float, float], tuple[int, int, int]]:
    """Return the corner (x, y, z) of the box around points [m], and its voxels (D, H, W)."""
    low = np.floor(points.min(axis=0) / side + 1e-6) * side
    # A point on the last face belongs to the last voxel.
    sizes = np.maximum(1.0, np.ceil((points.max(axis=0) - low) / side - 1e-6))
    if sizes.prod() > MOST_VOXELS:
        x, y, z = sizes * side
        raise refuse(
            f"is {x:g} m x {y:g} m x {z:g} m, which are {sizes.prod():.3g} voxels of {side:g} m",
            f"at most {MOST_VOXELS:.3g}: a greater resolution, or file.scale=0.001 for millimetres",
        )
    width, height, depth = (int(each) for each in sizes)
    return (float(low[0]), float(low[1]), float(low[2])), (depth, height, width)


def _counted(
    points: Points, origin: tuple[float, float, float], shape: tuple[int, int, int], side: float
) -> NDArray[np.int64]:
    """Return the number of points in each voxel (D, H, W)."""
    voxels = np.floor((points - origin) / side + 1e-6).astype(np.int64)[:, ::-1]
    voxels = np.clip(voxels, 0, np.array(shape) - 1)
    flat = np.ravel_multi_index(tuple(voxels.T), shape)
    return np.bincount(flat, minlength=math.prod(shape)).reshape(shape)


def _pcd_points(data: bytes, refuse: Refuse) -> Points:
    """Return the points (N, 3) of a PCD file."""
    cloud = import_optional("pypcd4", "volumes").PointCloud
    # A header may promise more points than there is memory for.
    header = re.search(rb"^POINTS\s+(\d{1,12})\s*$", data[:10_000], re.MULTILINE)
    if header is None or int(header[1]) > len(data):
        raise refuse("has no header with a number of points that fits", "a PCD file")
    try:
        return np.asarray(cloud.from_fileobj(io.BytesIO(data)).numpy(("x", "y", "z")), np.float64)
    except (*MALFORMED, OSError, EOFError) as error:
        raise refuse(f"cannot be read: {error_reason(error)}", "a PCD file with x, y, z") from None


def _from_arrays(data: bytes, kind: str, side: float) -> VoxelGrid:
    def check(name: str, shape: tuple[int, ...], dtype: np.dtype[np.generic]) -> None:
        if math.prod(shape) > MOST_VOXELS:
            raise ValueError(f"{name} has shape {shape}, more than {MOST_VOXELS} voxels")

    if kind == ".npz":
        arrays = read_arrays(data, check)
        if "solid" not in arrays:
            raise ValueError(f"it has {', '.join(arrays) or 'nothing'} and no solid")
        side = float(arrays.get("resolution", np.asarray(side)))
        origin = np.asarray(arrays.get("origin", np.zeros(3)), np.float64)
        return VoxelGrid.solid(arrays["solid"], side, origin.tolist())
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    read = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read(file)
    check("the array", shape, dtype)
    return VoxelGrid.solid(np.load(io.BytesIO(data), allow_pickle=False), side)


SUFFIXES = (".stl", ".obj", ".ply", ".pcd", ".bt", ".npy", ".npz")
"""Endings of the files that `read_volume` reads."""
