"""Valid files of volumes: a room as a mesh, a point cloud, an OctoMap and an array."""

import warnings
from pathlib import Path

import numpy as np

FILES = (
    *("stl", "ascii.stl", "obj", "ply", "points.ply", "glb", "gltf", "dae", "pcd", "las", "laz"),
    *("bt", "ot", "npy", "npz"),
)
"""Endings of the files of the room."""
SIZE, SIDE = np.array([4.0, 3.0, 2.4]), 0.2


def arguments(ending: str) -> list[str]:
    """Return the command that reads the file with an ending."""
    return ["run", f"room.{ending}", "--resolution", str(SIDE), "--memory-limit", "2"]


def write_volumes(base: Path) -> None:
    """Write the files; needs trimesh, laspy, pypcd4 and pyoctomap."""
    import laspy
    import pyoctomap
    import trimesh
    from pypcd4 import PointCloud

    solid = np.ones((SIZE[::-1] / SIDE).round().astype(int), bool)
    solid[1:-1, 1:-1, 1:-1] = False
    points = (np.argwhere(solid)[:, ::-1] + 0.5) * SIDE
    room = trimesh.creation.box(extents=SIZE)
    with warnings.catch_warnings(action="ignore"):
        for ending in ("stl", "obj", "ply", "glb", "dae"):
            room.export(base / f"room.{ending}")
        room.export(base / "room.ascii.stl", file_type="stl_ascii")
        written = trimesh.exchange.gltf.export_gltf(room.scene(), embed_buffers=True)
    (base / "room.gltf").write_bytes(written["model.gltf"])
    trimesh.PointCloud(points).export(base / "room.points.ply")
    PointCloud.from_xyz_points(points.astype(np.float32)).save(base / "room.pcd")
    for ending in ("las", "laz"):
        las = laspy.create(file_version="1.2", point_format=0)
        las.header.scales = [0.001] * 3
        las.x, las.y, las.z = points.T
        las.write(base / f"room.{ending}")
    tree = pyoctomap.OcTree(SIDE)
    for point in (np.argwhere(~solid)[:, ::-1] + 0.5) * SIDE:
        tree.updateNode(point, False)
    for point in points:
        tree.updateNode(point, True)
    tree.writeBinary(str(base / "room.bt"))
    tree.write(str(base / "room.ot"))
    np.save(base / "room.npy", solid)
    np.savez(base / "room.npz", solid=solid, resolution=SIDE, origin=np.zeros(3))
